# SPDX-License-Identifier: GPL-3.0-or-later
"""Real rooms and real components at sample level, and the product's score in them.

``python3 tests/rooms/score.py --list`` names the rooms. Like
``tests/models/second_simulator.py``, on which this folder builds, nothing here shares a
line with the product.
"""
