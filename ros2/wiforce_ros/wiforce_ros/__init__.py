# SPDX-License-Identifier: GPL-3.0-or-later
"""Publishes the readings of ``gr-wiforce live`` under ROS 2."""
