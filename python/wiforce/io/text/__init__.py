# SPDX-License-Identifier: GPL-3.0-or-later
"""Text files: YAML by declared keys, and CSV, read with limits and written whole."""
