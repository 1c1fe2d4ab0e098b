# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a calibration: of what was left out, of all readings, and what it does not support."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..sensor import curves, line
from ..sensor.curves import CurveModel
from ..sensor.inversion import Inversion
from ..sensor.model import SensorModel
from ..signal.carrier import same_carrier
from .data import CarrierData, ContactCurve
from .fit import CurveFitter
from .wrong_entries import contradictions

# Blocks of neighbouring forces that are left out in turn: four of the six lie inside.
_BLOCKS = 6
# Fewest samples that a curve is fitted to when others are left out.
_LEAST_LEFT = 5


def validate_forms(data: Sequence[CarrierData]) -> dict[str, Any]:
    """Cross-validate each form of the curves: rms errors in deg, samples, and the best.

    One ``press`` is left out at a time, or a block of neighbouring ``forces``, those at the ends of
    a location only for ``auto-beyond``.
    """
    several = any(len(set(c.press)) > 1 for d in data for c in d.curves)
    folds = {
        form: [fold for d in data for fold in _fold_errors(d, form, several)]
        for form in curves.FORMS
    }
    everywhere = {form: [error for error, _ in found] for form, found in folds.items()}
    inside = {form: [error for error, rim in found if not rim] for form, found in folds.items()}
    return {
        "left_out": "press" if several else "forces",
        "best": {"auto": best_form(inside), "auto-beyond": best_form(everywhere)},
        "forms": {
            form: {
                "inside_deg": _root_mean(inside[form]),
                "everywhere_deg": _root_mean(everywhere[form]),
                "samples": sum(map(len, everywhere[form])),
            }
            for form in curves.FORMS
            if inside[form]
        },
    }


def _root_mean(squares: Sequence[np.ndarray]) -> float:
    return round(float(np.sqrt(np.mean(np.concatenate(squares)))), 4)


def best_form(squares: Mapping[str, Sequence[np.ndarray]]) -> str:
    """The simplest form as good as the best within the standard error of squares per fold.

    L. Breiman et al., *Classification and Regression Trees*, 1984, section 3.4.3.
    """
    means = {form: np.array([np.mean(s) for s in folds]) for form, folds in squares.items()}
    if not all(mean.size for mean in means.values()):
        return curves.FORMS[0]
    best = min(means, key=lambda form: means[form].mean())
    for form in curves.FORMS:
        worse = means[form] - means[best]
        error = np.std(worse, ddof=1) / np.sqrt(worse.size) if worse.size > 1 else 0.0
        if worse.mean() <= error:
            return form
    return best


def _fold_errors(data: CarrierData, form: str, by_press: bool) -> list[tuple[np.ndarray, bool]]:
    """Squared errors of each fold, and whether the fold is extrapolated."""
    knots = curves.force_knots(form, np.concatenate([c.force_n for c in data.curves]))
    samples = [(c.force_n, c.added_deg) for c in data.curves]
    fitter = CurveFitter(form, knots, samples)
    folds = []
    for curve in data.curves:
        basis = fitter.basis(curve.force_n)
        for out, rim in [] if curve.copied else _folds(curve, by_press):
            if not np.any(out) or np.count_nonzero(~out) < _LEAST_LEFT:
                continue
            coefficients, _ = fitter.coefficients(basis[~out], curve.added_deg[~out])
            folds.append(((curve.added_deg[out] - basis[out] @ coefficients) ** 2, rim))
    return folds


def _folds(curve: ContactCurve, by_press: bool) -> list[tuple[np.ndarray, bool]]:
    if by_press:
        return [(curve.press == press, False) for press in dict.fromkeys(curve.press)]
    block = np.minimum(np.arange(curve.force_n.size) * _BLOCKS // curve.force_n.size, _BLOCKS - 1)
    return [(block == b, b in (0, _BLOCKS - 1)) for b in range(_BLOCKS)]


_FORCES, _LOCATIONS = 5, 9
_QUIET_DEG = 1e-3  # phases without noise of their own
_ENOUGH_LOCATIONS = 5
_LARGEST_STEP_MM = 15.0
# Presses of 1 to 8 N are .1 to .82 kg. A gentle sensor is pressed as lightly, so that this is no
# suspicion.
_LITTLE_FORCE_N = 0.9


@dataclass(frozen=True)
class Verdict:
    """Errors that a calibration leaves without noise, with contradictions of its locations.

    Standard deviations are median and largest where readings are not flagged; ``flagged`` is a
    share of the span, ``flags`` are theirs, the most frequent one first, ``unusable`` says why no
    force is read.
    """

    frequency_hz: float
    force_std_n: tuple[float, float]
    location_std_mm: tuple[float, float]
    flagged: float
    flags: tuple[str, ...] = ()
    unusable: str = ""


def verdict(model: CurveModel) -> list[Verdict]:
    """The errors of each carrier of a calibrated model."""
    return [_of_carrier(model, frequency_hz) for frequency_hz in model.frequencies_hz]


def _of_carrier(model: CurveModel, frequency_hz: float) -> Verdict:
    found, used, flagged = _over_span(model, frequency_hz, _QUIET_DEG)
    unusable = ""
    # Of a force that is anywhere in the span.
    guess_n = float(np.ptp(model.force_span_n)) / np.sqrt(12)
    counts = Counter(flag for words in found.flags for flag in words)
    flags = tuple(flag for flag, _ in counts.most_common())
    if flagged == 1:
        unusable = " ".join(["every reading is flagged", *flags[:1]])
    elif not np.nanmedian(found.force_std_n) < guess_n:
        unusable = f"force is known no better than by a guess within the span ({guess_n:.2g} N)"
    force_std, location_std = (
        (float(np.median(std[used])), float(std[used].max()))
        for std in (found.force_std_n, found.location_std_mm)
    )
    return Verdict(frequency_hz, force_std, location_std, flagged, flags, unusable)


def errors_over_span(
    model: SensorModel, frequency_hz: float, std_deg: np.ndarray | float
) -> tuple[float, float, float]:
    """Median deviations in N and mm over the span at noise (2,), and the share that is flagged."""
    quiet, used, flagged = _over_span(model, frequency_hz, _QUIET_DEG)
    found = _over_span(model, frequency_hz, std_deg)[0]
    # A wide posterior may be summarised otherwise with more noise, which never makes it narrower.
    force = np.fmax(quiet.force_std_n, found.force_std_n)[used]
    location = np.fmax(quiet.location_std_mm, found.location_std_mm)[used]
    return float(np.median(force)), float(np.median(location)), flagged


def _over_span(
    model: SensorModel, frequency_hz: float, std_deg: np.ndarray | float
) -> tuple[Inversion, np.ndarray, float]:
    """Readings over the span, those that count (n,) bool, and the share that is flagged."""
    force, location = (
        axis.ravel()
        for axis in np.meshgrid(
            np.linspace(*model.force_span_n, _FORCES),
            np.linspace(*model.location_span_mm, _LOCATIONS),
        )
    )
    std = np.hypot(std_deg, contradiction_deg(model, frequency_hz, location))
    phases = model.phases_deg(force, location, frequency_hz)
    found = model.invert(phases, std, frequency_hz=frequency_hz)
    known = np.isfinite(found.force_std_n) & np.isfinite(found.location_std_mm)
    clear = known & np.array([not flags for flags in found.flags])
    return found, clear if clear.any() else known, float(1 - clear.mean())


def contradiction_deg(
    model: SensorModel, frequency_hz: float, location_mm: np.ndarray
) -> np.ndarray:
    """Deviation (n, 2) by which calibrated locations contradict each other, unseen by a model."""
    rows = _rows_at(model, "locations", frequency_hz)
    found = np.zeros((len(location_mm), 2))
    contradicting = contradictions(rows)
    for port in (1, 2) if contradicting else ():
        own = sorted(
            (row["location_mm"], row["rms_deg"] if row in contradicting else 0.0)
            for row in rows
            if row["port"] == port
        )
        places, std = zip(*own, strict=True)
        found[:, port - 1] = np.interp(location_mm, places, std)
    return found


def _rows_at(model: SensorModel, key: str, frequency_hz: float) -> list[dict[str, Any]]:
    """Rows of a model's cross-validation at one carrier."""
    rows = model.cross_validation.get(key, []) if isinstance(model, CurveModel) else []
    return [row for row in rows if same_carrier(row["frequency_mhz"] * 1e6, frequency_hz)]


def calibration_warnings(model: CurveModel) -> list[str]:
    """What a calibrated model does not support, a sentence each."""
    return [
        f"{carrier.frequency_hz / 1e6:g} MHz: {text}"
        for index, carrier in enumerate(model.carriers)
        for text in _warnings(model, index)
    ]


def _warnings(model: CurveModel, index: int) -> Iterator[str]:
    carrier = model.carriers[index]
    places, spans = carrier.location_mm, carrier.force_span_n
    slope = line.round_trip_deg_per_mm(carrier.frequency_hz, model.permittivity)
    if len(places) < _ENOUGH_LOCATIONS:
        yield (
            f"{len(places)} locations: a kink of the line between them is not seen; press at five "
            "or more"
        )
    hardest = float(spans[:, 1].max())
    if hardest < _LITTLE_FORCE_N:
        yield f"forces reach {hardest:g} N only: were they entered in kg (1 kg is 9.81 N)?"
    first = int(np.argmin(spans[:, 0]))
    if spans[first, 0] < model.onset_force_n:
        yield (
            f"{spans[first, 0]:g} N shorted the line at {places[first]:g} mm, but "
            f"{model.onset_force_n:.3g} N are the least that did elsewhere: was each force as "
            "stated?"
        )
    if not _rows_at(model, "wrong", carrier.frequency_hz):  # which are suspicions
        for row in contradictions(_rows_at(model, "locations", carrier.frequency_hz)):
            yield (
                f"location {row['location_mm']:g} mm does not fit the others: port {row['port']} "
                f"is {row['rms_deg']:.1f} deg, {row['rms_deg'] / slope:.1f} mm of line, from what "
                f"they say ({row['expected_deg']:.1f} deg expected); was the ruler right there and "
                "beside it?"
            )
    middle_n = np.mean(model.force_span_n)
    steps = np.diff(model.short_deg(np.full(len(places), middle_n), places, index), axis=0)
    worst = np.abs(steps / slope - np.outer(np.diff(places), [-1, 1])).max()
    if worst > _LARGEST_STEP_MM:
        yield (
            f"phases of different locations do not fit a line: steps are up to {worst * slope:.0f} "
            f"deg ({worst:.0f} mm) off; force and location read together are not to be trusted"
        )
