# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimators that a scene can ask for, and what follows from the choice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .groups import Array, Groups
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


def estimator_named(name: str) -> Estimator:
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

    Raises
    ------
    InputError
        For another word.
    """

    def __init__(self, ratios: str) -> None:
        if ratios not in ("change", "step", "square"):
            raise InputError("ratios", "must be 'change', 'step' or 'square'", ratios)
        self._ratios = ratios
        self._last: Array | None = None

    def process(self, groups: Groups) -> Groups:
        """A batch with its ``ratios`` unfolded."""
        if self._ratios == "change" or not len(groups):
            return groups
        assert groups.ratios is not None and groups.phase_std_deg is not None
        assert groups.new_reference is not None
        there = np.isfinite(groups.phase_std_deg) & (np.abs(groups.ratios) > 0)
        unfolded = np.empty_like(groups.ratios)
        for row, anew in enumerate(groups.new_reference.tolist()):
            if anew or self._last is None:  # the group counts as untouched
                self._last = np.ones(groups.ratios.shape[1], complex)
            follow = self._add_step if self._ratios == "step" else self._take_root
            unfolded[row] = follow(groups.ratios[row], there[row], self._last)
        std = groups.phase_std_deg / (2 if self._ratios == "square" else 1)
        return groups.having(ratios=unfolded, phase_std_deg=std)

    def _add_step(self, ratios: Array, there: Array, last: Array) -> Array:
        steps = np.where(there, ratios, 1.0)
        self._last = last * steps / np.abs(steps)
        return np.where(there, self._last, 0.0)

    def _take_root(self, ratios: Array, there: Array, last: Array) -> Array:
        roots = np.sqrt(np.asarray(ratios, complex))
        roots = np.where((roots * last.conj()).real < 0, -roots, roots)
        self._last = np.where(there, roots, last)
        return roots
