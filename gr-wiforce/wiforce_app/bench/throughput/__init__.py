# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``bench speed`` is made of: the recording, the chains, and their runs."""
