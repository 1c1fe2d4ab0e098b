# SPDX-License-Identifier: GPL-3.0-or-later
"""Many captures, read in parallel: which there are, one of them, and the record of all."""
