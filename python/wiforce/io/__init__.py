# SPDX-License-Identifier: GPL-3.0-or-later
"""Files: recordings, readings, CSV and YAML; checked when read, written whole or row by row."""
