# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate`` and ``score``: readings against truth, the paper and force gauges.

`experiment` simulates and reads a scene, `runs` does so for all scenes, `causes` names what limits
the paper's results, `report` writes the page, and `published` reads the paper's wireless trials.
"""
