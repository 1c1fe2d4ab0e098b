# SPDX-License-Identifier: GPL-3.0-or-later
"""From the ratios R of both ends to readings: what may have happened, and what it says of a press.

A filter (``lib/kernel/press``, see docs/press.md) keeps a few weighted explanations of what
a sensor has shown: untouched, pressed, touched in a way that the model does not contain, or
changing inside a group. A reading is the mean over the likeliest one and all other presses whose
untouched line is known, so that one that the data do not exclude widens its standard deviation.
"""
