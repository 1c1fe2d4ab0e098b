# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours and markers of all plots and windows.

The page of ``--web`` repeats them in ``assets/picture.js`` and ``assets/page.css``.
"""

# Any two differ for people who cannot tell red from green: M. Okabe and K. Ito, "Color Universal
# Design", 2008, but for the sixth: theirs is too near to the second.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e6c200", "#202428")
# Of Matplotlib; so many series differ without any colour.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
INK, PAPER, GRID = "#202428", "#ffffff", "#e3e7eb"
# Both are at least 4.5:1 on white, as WCAG 2.1 AA asks for text.
FAINT, WARNING = "#646b73", "#a35500"
# What was applied, behind what was read.
TRUTH = "#cecece"
BEAM, GROUND = "#cdd4db", "#9aa3ac"


def series_style(number: int) -> dict[str, str]:
    """Colour and marker of a series for Matplotlib; the first 49 have different pairs."""
    cycle, index = divmod(number, len(SERIES))
    return {"color": SERIES[index], "marker": MARKERS[(index + cycle) % len(MARKERS)]}
