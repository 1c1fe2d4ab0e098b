# SPDX-License-Identifier: GPL-3.0-or-later
"""How a rubber skin loads the strips beneath it, by a model that shares nothing with the product.

A beam across the strips, free at both ends, on foam; each strip is a narrow stiff spring. Solved by
finite differences. Unlike the law of any reader, its shares depend on which strip it is (the outer
ones lie near an edge), part of the force goes into the foam, and each strip lies a little off.
"""

import numpy as np

STRIPS_MM = np.array([0.0, 12.0, 24.0, 36.0])
_EDGE_MM = 9.0  # the skin ends so far beyond the outer strips
_STEP_MM = 0.5
_WIDTH_MM = 7.0  # of a strip
_BENDING = 4.0e4  # N mm^2 per mm along the strips
_STIFF, _FOAM = 9.0, 0.35  # N/mm^2 under a strip and between strips
# Where each strip really lies along x, against where it should.
ALONG_MM = np.array([0.2, -0.15, 0.1, -0.25])


def _solve():
    y = np.arange(STRIPS_MM[0] - _EDGE_MM, STRIPS_MM[-1] + _EDGE_MM + _STEP_MM / 2, _STEP_MM)
    n = len(y)
    under = np.abs(y[:, None] - STRIPS_MM) <= _WIDTH_MM / 2
    stiffness = np.where(under.any(axis=1), _STIFF, _FOAM)
    bend = np.zeros((n - 2, n))
    for i in range(n - 2):
        bend[i, i : i + 3] = 1.0, -2.0, 1.0
    # Energy of bending and of the springs: free edges follow from it.
    matrix = _BENDING * bend.T @ bend / _STEP_MM**3 + np.diag(stiffness * _STEP_MM)
    deflection = np.linalg.inv(matrix)  # column: a unit force at each node
    return y, np.maximum((under * stiffness[:, None] * _STEP_MM).T @ deflection, 0.0)


_Y, _LOADS = _solve()


def strip_loads(force_n, y_mm):
    """Force on each strip, shape (n, 4), of presses at y."""
    share = np.stack([np.interp(y_mm, _Y, load) for load in _LOADS], axis=-1)
    return np.asarray(force_n)[..., None] * share
