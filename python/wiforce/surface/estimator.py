# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses on a surface, group by group: one, or two that are far enough apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from .posterior import SurfaceEvidence, SurfacePosterior, SurfacePress
from .skin import Skin
from .strip_profile import StripProfile, strip_profile

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Strips contradict each other when their residual is larger than that of so many presses, as for
# the phases of one strip (sensor/inversion.py).
_CONSISTENT = 0.9973
# A press may load a strip that another one is read from by this part of the force that shorts it:
# it then makes no contact of its own there.
_CROSS = 0.6
# Standard deviations of y within which a press may lie.
_LIKELY = 2.0


@dataclass(frozen=True)
class SurfaceFound:
    """Presses of G groups, up to P at a time.

    Attributes
    ----------
    touch : ndarray of int, shape (G, P)
        1, 0, or -1 where it is not known.
    mean : ndarray, shape (G, P, 3)
        Force in N, x and y in mm; NaN where not touched.
    covariance : ndarray, shape (G, P, 3, 3)
    inconsistent : ndarray of bool, shape (G, P)
        Whether no press explains what the strips show.
    outside : ndarray of bool, shape (G, P)
        Whether the press lies beyond what the strips cover, or may by two standard deviations of y.
    main : ndarray of int, shape (G, P)
        The strip that bears most of the press.
    """

    touch: NDArray[np.intp]
    mean: Array
    covariance: Array
    inconsistent: Flags
    outside: Flags
    main: NDArray[np.intp]


class SurfaceEstimator:
    """Reads the presses on a skin.

    A second press is looked for where one press does not explain the strips. The strips are then
    divided into those below and those above some y, and each part is read by itself. This is
    accepted where no press makes a contact of its own on a strip of the other one; what it adds to
    the force there is an error of that strip.

    Parameters
    ----------
    presses : int
        1 or 2.
    """

    def __init__(self, skin: Skin, presses: int = 1) -> None:
        self.skin, self._presses = skin, presses
        self._posterior = SurfacePosterior(skin)
        # Where each of the presses was in the last group; None where it was not.
        self._last: list[Array | None] = [None] * presses

    def read(
        self, phases_deg: Array, std_deg: Array, usable: Flags, touched: Flags
    ) -> SurfaceFound:
        """Presses of a batch.

        Parameters
        ----------
        phases_deg, std_deg : ndarray, shape (G, S, 2)
            Of the strips in the order of the skin.
        usable, touched : ndarray of bool, shape (G, S)
            Strips that are not usable are left out.
        """
        count, presses = len(usable), self._presses
        none_touched = np.where(usable.all(axis=1), 0, -1)
        touch = np.repeat(none_touched[:, None], presses, axis=1)
        mean = np.full((count, presses, 3), np.nan)
        covariance = np.full((count, presses, 3, 3), np.nan)
        inconsistent = np.zeros((count, presses), bool)
        rows = np.flatnonzero((usable & touched).any(axis=1))
        found = self._found(phases_deg, std_deg, usable, touched, rows) if rows.size else {}
        for row in range(count):
            if row not in found:
                self._last = [None] * presses
                continue
            parts, contradicts = found[row]
            places = self._places([part.mean[0] for part in parts])
            for place, part in zip(places, parts, strict=True):
                touch[row, place] = 1
                mean[row, place], covariance[row, place] = part.mean[0], part.covariance[0]
            inconsistent[row] = contradicts
        inconsistent &= touch == 1
        spans = np.array([self.skin.x_span_mm, self.skin.y_span_mm])
        # Beyond the surface the law is unknown, but presses there are read as if it applied.
        across_std = np.sqrt(covariance[..., 2, 2])
        margin = _LIKELY * np.stack([np.zeros_like(across_std), across_std], axis=-1)
        with np.errstate(invalid="ignore"):
            beyond = (mean[..., 1:] - margin < spans[:, 0]) | (mean[..., 1:] + margin > spans[:, 1])
        main = self.skin.shares(np.nan_to_num(mean[..., 2])).argmax(axis=-1)
        return SurfaceFound(touch, mean, covariance, inconsistent, beyond.any(axis=-1), main)

    def _found(
        self,
        phases: Array,
        std: Array,
        usable: Flags,
        touched: Flags,
        rows: NDArray[np.intp],
    ) -> dict[int, tuple[list[SurfacePress], bool]]:
        """The presses of each touched group, and whether they do not explain the strips."""
        evidence = self._evidence(phases[rows], std[rows], usable[rows], touched[rows])
        one = self._posterior(evidence)
        contradicts = one.misfit > chdtri(one.freedom, 1 - _CONSISTENT)
        # By the Birge ratio, as for the phases of one strip (lib/kernel/inversion).
        ratio = np.where(contradicts, one.misfit / one.freedom, 1.0)
        one = replace(one, covariance=one.covariance * ratio[:, None, None])
        found = {int(row): ([one[i : i + 1]], bool(contradicts[i])) for i, row in enumerate(rows)}
        if self._presses > 1:
            for i in np.flatnonzero(contradicts):
                two = self._divide(evidence[i : i + 1])
                if two is not None:
                    found[int(rows[i])] = two, False
        return found

    def _divide(self, evidence: SurfaceEvidence) -> list[SurfacePress] | None:
        """Two presses that explain one reading; None where there are none."""
        strips, touched = np.arange(len(self.skin.strips)), evidence.touched[0]
        best: tuple[float, list[SurfaceEvidence]] | None = None
        for first in range(1, len(strips)):
            sides = strips < first, strips >= first
            if not all((touched & side).any() for side in sides):
                continue
            alone = [evidence.of_touched(side, np.zeros(1)) for side in sides]
            others = [self._borne(self._posterior.roughly(part)) for part in alone[::-1]]
            if any(
                (other > _CROSS * self.skin.onset_force_n)[touched & side].any()
                for other, side in zip(others, sides, strict=True)
            ):
                continue
            parts = [
                evidence.of_touched(side, other) for side, other in zip(sides, others, strict=True)
            ]
            rough = [self._posterior.roughly(part) for part in parts]
            if any(part.misfit[0] > chdtri(part.freedom[0], 1 - _CONSISTENT) for part in rough):
                continue
            misfit = float(sum(part.misfit[0] for part in rough))
            if best is None or misfit < best[0]:
                best = misfit, parts
        return None if best is None else [self._posterior(part) for part in best[1]]

    def _borne(self, press: SurfacePress) -> Array:
        """Force of a press on each strip."""
        force, _, y = press.mean[0]
        borne: Array = force * self.skin.shares(y)
        return borne

    def _places(self, presses: list[Array]) -> list[int]:
        """Which of the rows each press goes on in: that of the nearest press of the last group."""
        last = self._last
        if self._presses == 1:
            places = [0]
        elif len(presses) == 1:
            distances = [_distance(presses[0], each) for each in last]
            places = [int(np.argmin(distances))]
        else:
            straight = _distance(presses[0], last[0]) + _distance(presses[1], last[1])
            crossed = _distance(presses[0], last[1]) + _distance(presses[1], last[0])
            swap = crossed < straight
            if crossed == straight:
                swap = presses[1][0] > presses[0][0]
            places = [1, 0] if swap else [0, 1]
        now: list[Array | None] = [None] * self._presses
        for place, press in zip(places, presses, strict=True):
            now[place] = press
        self._last = now
        return places

    def _evidence(
        self, phases: Array, std: Array, usable: Flags, touched: Flags
    ) -> SurfaceEvidence:
        """What the strips show, with their locations along x."""
        profiles = []
        for i, strip in enumerate(self.skin.strips):
            rows = np.flatnonzero(usable[:, i] & touched[:, i])
            own = strip_profile(strip.model, self.skin.frequency_hz, phases[rows, i], std[rows, i])
            own = StripProfile(
                own.force_n,
                own.log_weight,
                np.asarray(strip.x_of(own.location_mm - self.skin.spreading.offset_mm(i))),
                own.variance_mm2,
            )
            profiles.append(_spread_out(own, rows, len(phases)))
        names = StripProfile.__dataclass_fields__
        joined = (np.stack([getattr(p, name) for p in profiles], axis=1) for name in names)
        nothing = np.zeros(usable.shape)
        return SurfaceEvidence(StripProfile(*joined), usable & touched, usable & ~touched, nothing)


# Distance in mm of a press from one that was not there: farther than any surface is wide.
_ABSENT_MM = 1e5


def _distance(press: Array, last: Array | None) -> float:
    return _ABSENT_MM if last is None else float(np.hypot(*(press[1:] - last[1:])))


def _spread_out(profile: StripProfile, rows: NDArray[np.intp], count: int) -> StripProfile:
    """Profiles at their rows of all readings; the other rows have no meaning."""

    def at_rows(values: Array) -> Array:
        every = np.ones((count, values.shape[1]))
        every[rows] = values
        return every

    return StripProfile(*(at_rows(getattr(profile, name)) for name in profile.__dataclass_fields__))
