# SPDX-License-Identifier: GPL-3.0-or-later
"""The spreading law of a skin from presses at known points."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .file import SpreadingKeys
from .skin import Skin

Array = NDArray[np.float64]

# Points of a table per distance of the strips, and how far beyond the presses it may reach.
_PER_SPACING = 3
# A law of least complexity: second differences of the shares have this standard deviation. Those
# of a plate on a foundation, at a third of a spacing, are 0.01 to 0.05.
_BEND = 0.05
# A strip shows no share below this error: its own calibration errs by 1 % of the force.
_LEAST_STD, _LEAST_LOCATION_MM = 0.003, 0.05
_LEAST_SHARES = 6
_FOLDS = 10


@dataclass(frozen=True)
class SurfaceTaps:
    """Presses at known points, and what S strips showed of them.

    Attributes
    ----------
    force_n, x_mm, y_mm : ndarray, shape (n,)
        Of each press.
    strip_force_n, strip_force_std_n : ndarray, shape (n, S)
        Force that each strip showed; NaN where it was untouched or not received.
    strip_x_mm, strip_x_std_mm : ndarray, shape (n, S)
        Location along x that it showed.
    untouched : ndarray of bool, shape (n, S)

    Examples
    --------
    >>> one = np.ones((3, 4))
    >>> len(SurfaceTaps(np.ones(3), np.ones(3), np.ones(3), one, one, one, one, one < 0))
    3
    """

    force_n: Array
    x_mm: Array
    y_mm: Array
    strip_force_n: Array
    strip_force_std_n: Array
    strip_x_mm: Array
    strip_x_std_mm: Array
    untouched: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.force_n)


@dataclass(frozen=True)
class SpreadingFit:
    """A calibrated spreading law, and how well it explains the taps.

    Attributes
    ----------
    law : SpreadingKeys
    shares, untouched : int
        Strips that showed a share, and that showed none, over all taps.
    rms : float
        Residual of the shares.

    Examples
    --------
    >>> SpreadingFit(SpreadingKeys(share=0.5, width_mm=10.0), 20, 12, 0.01).law.law
    'gaussian'
    """

    law: SpreadingKeys
    shares: int
    untouched: int
    rms: float


def fit_spreading(skin: Skin, taps: SurfaceTaps, law: str = "table") -> SpreadingFit:
    """Fit a spreading law.

    Parameters
    ----------
    skin : Skin
        Positions of the strips; its law is not used.
    taps : SurfaceTaps
    law : str
        ``table`` or ``gaussian``.

    Returns
    -------
    SpreadingFit
        The standard deviations of the law are those of taps that are left out of the fit in turn,
        less the noise of the strips' own readings.

    Raises
    ------
    InputError
        When the taps do not determine the law.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> from gnuradio.wiforce.scene.surface import skin_of
    >>> skin = skin_of(load_scene("surface_four_strips"))
    >>> y = np.arange(0.0, 37.0, 3.0)
    >>> force, x = np.full(13, 6.0), np.full(13, 40.0)
    >>> borne = force[:, None] * skin.shares(y)
    >>> shown = np.where(borne > 0.9, borne, np.nan)
    >>> there = np.where(borne > 0.9, 40.0, np.nan)
    >>> taps = SurfaceTaps(
    ...     force, x, y, shown, 0.05 + 0 * shown, there, 0.1 + 0 * there, borne <= 0.9)
    >>> found = fit_spreading(skin, taps).law.spreading()
    >>> found.share([0.0, 12.0]).round(2).tolist()
    [0.55, 0.24]
    """
    distance = np.abs(taps.y_mm[:, None] - skin.y_mm)
    share = taps.strip_force_n / taps.force_n[:, None]
    noise = taps.strip_force_std_n / taps.force_n[:, None]
    shown = np.isfinite(share) & np.isfinite(noise)
    count = int(shown.sum())
    if count < _LEAST_SHARES or len(np.unique(distance[shown].round(1))) < 3:
        rule = (
            f"must press strips {_LEAST_SHARES} times or more, at three distances across or more: "
            "on strips and between them"
        )
        raise InputError("taps", rule, count)
    data = _Data(distance, share, noise, shown, taps.untouched, taps.force_n, skin.onset_force_n)
    make, start = _FAMILIES[law](skin.spacing_mm, data)
    std, parameters = 0.02, start
    for _ in range(3):
        parameters = _fit(make, parameters, data, std, np.ones(len(taps), bool))
        std = _left_out_std(make, parameters, data, std)
    off = np.where(shown, taps.strip_x_mm - taps.x_mm[:, None], 0.0)
    own = np.where(shown, taps.strip_x_std_mm, 0.0) ** 2
    location = float(np.sqrt(max((off**2 - own)[shown].mean(), _LEAST_LOCATION_MM**2)))
    residual = (share - make(parameters, std).spreading().share(distance))[shown]
    found = replace(
        make(parameters, std), share_std=round(std, 4), location_std_mm=round(location, 3)
    )
    rms = float(np.sqrt(np.mean(residual**2)))
    return SpreadingFit(found, count, int(taps.untouched.sum()), rms)


@dataclass(frozen=True)
class _Data:
    """Distances, shares and their noise, shape (n, S)."""

    distance_mm: Array
    share: Array
    noise: Array
    shown: NDArray[np.bool_]
    untouched: NDArray[np.bool_]
    force_n: Array
    onset_n: Array


_Make = Callable[[Array, float], SpreadingKeys]


def _table(spacing_mm: float, data: _Data) -> tuple[_Make, Array]:
    step = spacing_mm / _PER_SPACING
    known = data.shown | data.untouched
    reach = min(data.distance_mm[known].max(), 3 * spacing_mm) + step
    distance = step * np.arange(int(np.ceil(reach / step)) + 1)
    largest = float(np.nanmax(np.where(data.shown, data.share, np.nan)))
    start = largest * np.exp(-0.5 * (distance / (0.8 * spacing_mm)) ** 2)
    points = tuple(distance.round(4).tolist())

    def make(parameters: Array, std: float) -> SpreadingKeys:
        shares = tuple(np.clip(parameters, 0, 1).round(5).tolist())
        return SpreadingKeys(law="table", distance_mm=points, shares=shares, share_std=std)

    return make, np.minimum(start, 0.99)


def _gaussian(spacing_mm: float, data: _Data) -> tuple[_Make, Array]:
    def make(parameters: Array, std: float) -> SpreadingKeys:
        share, width = parameters.tolist()
        return SpreadingKeys(share=round(share, 5), width_mm=round(width, 4), share_std=std)

    return make, np.array([0.5, 0.8 * spacing_mm])


_FAMILIES = {"table": _table, "gaussian": _gaussian}
LAWS = tuple(_FAMILIES)


def _residuals(make: _Make, parameters: Array, data: _Data, std: float) -> Array:
    """Of all shares in standard deviations; 0 for untouched strips that the law explains."""
    expected = make(parameters, std).spreading().share(data.distance_mm)
    spread = np.hypot(np.where(data.shown, data.noise, 0.0), std)
    above = np.maximum(expected - data.onset_n / data.force_n[:, None], 0.0)
    residual = np.where(data.untouched, above / std, 0.0)
    found: Array = np.where(data.shown, (np.nan_to_num(data.share) - expected) / spread, residual)
    return found


def _fit(make: _Make, start: Array, data: _Data, std: float, used: NDArray[np.bool_]) -> Array:
    from scipy.optimize import least_squares

    bends = make(start, std).law == "table"

    def residuals(parameters: Array) -> Array:
        own = _residuals(make, parameters, data, std)[used].ravel()
        if not bends:
            return own
        mirrored = np.concatenate([parameters[1:2], parameters])
        return np.concatenate([own, np.diff(mirrored, 2) / _BEND, parameters[-1:] / std])

    high = np.ones(len(start)) if bends else np.array([1.0, 1000.0])
    low = np.zeros(len(start)) if bends else np.array([0.01, 0.1])
    inside = np.clip(start, low + 1e-6, high - 1e-6)
    # Steps above the rounding of the parameters.
    found = least_squares(residuals, inside, bounds=(low, high), diff_step=1e-3)
    solution: Array = found.x
    return solution


def _left_out_std(make: _Make, parameters: Array, data: _Data, std: float) -> float:
    """Error of shares whose taps are not fitted, without the noise of the strips."""
    taps = np.arange(len(data.force_n))
    folds = min(_FOLDS, len(taps))
    squares: list[float] = []
    for fold in range(folds):
        used = taps % folds != fold
        if not data.shown[used].any() or not data.shown[~used].any():
            continue
        law = make(_fit(make, parameters, data, std, used), std).spreading()
        off = data.share - law.share(data.distance_mm)
        squares += (off**2 - data.noise**2)[~used][data.shown[~used]].tolist()
    return float(np.sqrt(max(np.mean(squares) if squares else 0.0, _LEAST_STD**2)))
