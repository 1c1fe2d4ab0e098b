# SPDX-License-Identifier: GPL-3.0-or-later
"""What is on the air: channel, tags, front end; the reader takes nothing from here."""
