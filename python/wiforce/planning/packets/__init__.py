# SPDX-License-Identifier: GPL-3.0-or-later
"""Snapshots at the times of packets: plan, clocks and advice for them."""
