# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings: CSV, JSON lines, Parquet and MCAP."""
