# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate`` and ``score``: readings against truth, the paper and force gauges.

`evaluate` simulates and reads scenes, also by the paper's method and with what may limit the
paper's results, and writes the page; `published` reads the paper's figures and wireless trials.
"""
