# SPDX-License-Identifier: GPL-3.0-or-later
"""What reader and simulator may share: sounding frames, the tag's switching, tone weights."""
