# SPDX-License-Identifier: GPL-3.0-or-later
"""Files: captures, readings, YAML and text, checked at the edge."""
