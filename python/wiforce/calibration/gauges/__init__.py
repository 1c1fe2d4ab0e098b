# SPDX-License-Identifier: GPL-3.0-or-later
"""Force gauges: forces as they send them (`units`), their records (`file`), and readings compared
with these (`comparison`, `errors`, `score`).
"""
