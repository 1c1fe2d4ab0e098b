# SPDX-License-Identifier: GPL-3.0-or-later
"""A live session: its flowgraph, supply with samples, outputs, requests, health and reports."""
