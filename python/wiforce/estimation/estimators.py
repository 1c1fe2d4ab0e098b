# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimators that a scene can ask for, and what follows from the choice."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from .paper import PaperSeparator, SidebandSeparator
from .separation import EndSeparator


@dataclass(frozen=True)
class Estimator:
    """How the ends' phases are estimated.

    Attributes
    ----------
    separator : type
        Tones to the ends' vectors.
    rectangular : bool
        Tones by a plain Fourier sum over the group instead of the scene's weights.
    against : str
        What vectors are compared with: ``untouched`` or ``previous`` (group).
    ratios : str
        What the ratios R then are: the ``change`` against the untouched sensor, a ``step`` from
        group to group, or a ``square`` of the change.
    """

    separator: type
    rectangular: bool = False
    against: str = "untouched"
    ratios: str = "change"


ESTIMATORS = {
    "harmonic": Estimator(EndSeparator),
    "sideband": Estimator(SidebandSeparator, ratios="square"),
    "paper": Estimator(PaperSeparator, rectangular=True, against="previous", ratios="step"),
}


def estimator_named(name):
    """The estimator of that name.

    Raises
    ------
    InputError
        When there is none.
    """
    if name not in ESTIMATORS:
        raise InputError("estimator", f"must be one of {', '.join(ESTIMATORS)}", name)
    return ESTIMATORS[name]


class RatioUnfolder:
    """Turns the ratios of any estimator into changes against the untouched sensor.

    Steps are added up, and half the angle of a square is taken on the side where the group before
    was. A step says nothing of the magnitude, which becomes 1.

    Parameters
    ----------
    ratios : str
        ``change``, ``step`` or ``square``.
    ends : int
    """

    def __init__(self, ratios, ends):
        if ratios not in ("change", "step", "square"):
            raise InputError("ratios", "must be 'change', 'step' or 'square'", ratios)
        self._ratios, self._ends = ratios, ends
        self.tare()

    def tare(self):
        """Begins anew: the next group counts as untouched."""
        self._last = np.ones(self._ends, complex)

    def process(self, state, ratios):
        """GroupState and R (2S,) of one group, unfolded."""
        if self._ratios == "change":
            return state, ratios
        there = np.isfinite(state.std_deg) & (np.abs(ratios) > 0)
        if self._ratios == "step":
            steps = np.where(there, ratios, 1.0)
            self._last = self._last * steps / np.abs(steps)
            return state, np.where(there, self._last, 0.0)
        roots = np.sqrt(np.asarray(ratios, complex))
        roots = np.where((roots * self._last.conj()).real < 0, -roots, roots)
        self._last = np.where(there, roots, self._last)
        return replace(state, std_deg=state.std_deg / 2), roots
