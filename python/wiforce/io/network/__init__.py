# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings, requests and samples between processes: ZMQ, Foxglove, LSL."""
