# SPDX-License-Identifier: GPL-3.0-or-later
"""A reference that may not be that of the untouched sensor, and what verifies it.

A tare that was forced may have been measured while the sensor was pressed, and a tag that was
silent may have been moved or pressed meanwhile. Readings are then flagged until the phases show an
untouched sensor.
"""

from __future__ import annotations

from collections.abc import Callable

from ..signal.carrier import wrapped

# Groups of evidence that a release needs: a single one may be a press that changes inside it.
_RELEASE_GROUPS = 3
# Squared standard deviations within which a state counts as a known one (chi-square of two phases:
# 0.25 % of groups exceed it).
_KNOWN = 12.0

_Pair = tuple[float, float]


class UnverifiedReference:
    """Watches for a release that shows where the phases of the untouched sensor are.

    Two events verify the reference. Either the phases return to those that were untouched before,
    and are counted from there again. Or a press that only the new reference explains is followed
    by a release: its phases are a touch of the model against the new reference, but neither a
    touch nor untouched against the former one.

    Parameters
    ----------
    reason : str
        For reports.
    distance : callable
        From a change of both phases, in degrees, and their spreads to the squared standard
        deviations by which it misses the touches of the model.
    untouched_deg : (float, float) or None
        Phases of the untouched sensor as known before, in the present frame; None when unknown.
    groups : int
        Groups in a row at these phases that verify the reference.
    before_deg : (float, float) or None
        Other phases at which nothing has changed: those right before a tag went silent.

    Examples
    --------
    A tare was forced during a press of 40 and 10 deg, which is then released:

    >>> reference = UnverifiedReference("forced", lambda change, spreads: 99.0, (-40.0, -10.0))
    >>> spreads = (1.5, 1.5)
    >>> [reference.verified_by((0.0, 0.0), (0.0, 0.0), spreads, touch=0) for _ in range(5)]
    [False, False, False, False, False]
    >>> [reference.verified_by((-40.0, -10.0), (-40.0, -10.0), spreads, touch=1) for _ in range(3)]
    [False, False, True]
    >>> reference.released_to_former
    True
    """

    def __init__(
        self,
        reason: str,
        distance: Callable[[_Pair, _Pair], float],
        untouched_deg: _Pair | None,
        groups: int = _RELEASE_GROUPS,
        before_deg: _Pair | None = None,
    ) -> None:
        self.reason = reason
        self.released_to_former = False
        self._distance = distance
        self.untouched_deg, self._before_deg = untouched_deg, before_deg
        self._wanted, self._at_former = groups, 0
        self._pressed = self._released = 0

    def verified_by(
        self, phases_deg: _Pair, change_deg: _Pair, spreads_deg: _Pair, touch: int
    ) -> bool:
        """Take a group; whether it verifies the reference.

        Parameters
        ----------
        phases_deg : (float, float)
            arg R of both ends.
        change_deg : (float, float)
            The same without the drift that the tare subtracts.
        spreads_deg : (float, float)
            Their standard deviations with everything systematic.
        touch : int
            Decision of the group against the present reference.

        Returns
        -------
        bool
        """
        former = self.untouched_deg
        if former is not None:
            own = distance_squared(_difference(phases_deg, former), spreads_deg)
            here = distance_squared(change_deg, spreads_deg)
            self._at_former = self._at_former + 1 if own < _KNOWN and own <= here else 0
            if self._at_former >= self._wanted:
                self.released_to_former = True
                return True
        if self._before_deg is not None:
            unchanged = _difference(phases_deg, self._before_deg)
            if distance_squared(unchanged, spreads_deg) < _KNOWN:
                return True
        return self._release_follows_press(phases_deg, change_deg, spreads_deg, touch)

    def _release_follows_press(
        self, phases_deg: _Pair, change_deg: _Pair, spreads_deg: _Pair, touch: int
    ) -> bool:
        if touch:
            self._released = 0
            explained = self._distance(change_deg, spreads_deg) < _KNOWN
            if explained and self.untouched_deg is not None:
                former = _difference(phases_deg, self.untouched_deg)
                explained = (
                    distance_squared(former, spreads_deg) > _KNOWN
                    and self._distance(former, spreads_deg) > _KNOWN
                )
            self._pressed += explained
            return False
        untouched = distance_squared(change_deg, spreads_deg) < _KNOWN
        self._released = self._released + 1 if untouched else 0
        return self._pressed >= _RELEASE_GROUPS and self._released >= _RELEASE_GROUPS


def distance_squared(change_deg: _Pair, spreads_deg: _Pair) -> float:
    """Squared standard deviations of a change of both phases from zero.

    Parameters
    ----------
    change_deg, spreads_deg : (float, float)
        In degrees.

    Returns
    -------
    float

    Examples
    --------
    >>> distance_squared((3.0, 4.0), (1.0, 2.0))
    13.0
    """
    return (change_deg[0] / spreads_deg[0]) ** 2 + (change_deg[1] / spreads_deg[1]) ** 2


def _difference(phases_deg: _Pair, others_deg: _Pair) -> _Pair:
    first, second = (
        wrapped(phase - other) for phase, other in zip(phases_deg, others_deg, strict=True)
    )
    return first, second
