# SPDX-License-Identifier: GPL-3.0-or-later
"""Force gauges: their records (`file`), and readings scored against these (`comparison`)."""
