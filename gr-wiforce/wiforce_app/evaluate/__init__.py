# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate`` and ``score``: readings against truth, the paper and force gauges.

`experiment` simulates and reads a scene, also by the paper's method and with what may limit the
paper's results, `evaluate` does so for all scenes and writes the page, and `published` reads the
paper's figures and wireless trials.
"""
