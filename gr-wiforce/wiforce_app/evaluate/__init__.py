# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate`` and ``score``: readings against truth, the paper and force gauges.

`experiment` simulates and reads a scene, also by the paper's method, `runs` does so for all scenes
and writes the page, `causes` names what limits the paper's results, and `published` reads the
paper's wireless trials.
"""
