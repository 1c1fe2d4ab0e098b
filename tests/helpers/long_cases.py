# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of a parametrized test, of which some run with --long only."""

import pytest


def cases(*always, long=()):
    """Values for ``pytest.mark.parametrize``; a tuple holds the values of several arguments.

    Examples
    --------
    >>> len(cases("SBX", long=("WBX", "CBX")))
    3
    """
    return [*always, *(_long(case) for case in long)]


def _long(case):
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.long)
