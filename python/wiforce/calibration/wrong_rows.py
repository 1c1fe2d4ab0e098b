# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a row of a table is wrong, or two of them were exchanged."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.optimize import nnls

from ..sensor.curves import Carrier, slope_over_force
from ..signal.carrier import wrap_deg
from .data import CarrierData, ContactCurve
from .fit import CurveFitter, ForceCurve
from .wrong_locations import ROUNDED_DEG, is_better


def find_wrong_rows(data: CarrierData, form: str, knots: np.ndarray | None) -> list[str]:
    """Rows of a location whose exchange explains the phases better, or without which they fit.

    Returns list of str: a sentence each.

    A phase follows force smoothly, with noise of its own and of the force, which the slope turns
    into phase. Of each location and port the pair is tried whose exchange fits the curve best, then
    the row that lies farthest beside the others. Sweeps may begin before the contact, which no
    curve of force follows.
    """
    without_n, touched_n = data.onset or (0.0, 0.0)
    contacts = [
        (place, port, contact)
        for port, row in enumerate(data.curves, 1)
        for place, contact in zip(data.location_mm, row, strict=True)
        if not contact.copied
    ]
    fitter = CurveFitter(form, knots, [(c.force_n, c.added_deg) for c in data.all_curves()])
    fits = [fitter.fit(contact.force_n, contact.added_deg) for _, _, contact in contacts]
    slopes = [
        slope_over_force(partial(fitter.value, fit), contact.force_n)
        for (_, _, contact), fit in zip(contacts, fits, strict=True)
    ]
    exchanges = [
        _best_exchange(contact, fitter, fit, without_n)
        for (_, _, contact), fit in zip(contacts, fits, strict=True)
    ]
    pairs, rows = sum(count for _, count in exchanges), sum(len(slope) for slope in slopes)
    found = []
    for k, ((place, port, contact), (pair, _)) in enumerate(zip(contacts, exchanges, strict=True)):
        # Where rows of both ports are wrong, only other locations tell the noise.
        others = [n for n, each in enumerate(contacts) if each[0] != place]
        noise = _noise([fits[n] for n in others], [slopes[n] for n in others])
        freedom = sum(fits[n].freedom for n in others)
        ratio = partial(_row_log_ratio, fits[k], slopes[k], noise, freedom)
        where = f"at location {place:g} mm, port {port},"
        if pair is not None:
            exchanged = contact.added_deg.copy()
            exchanged[list(pair)] = exchanged[list(pair)[::-1]]
            after = fitter.fit(contact.force_n, exchanged)
            if is_better(ratio(after.residual, after.freedom), pairs):
                low, high = contact.force_n[list(pair)]
                found.append(
                    f"the phases of {low:g} and {high:g} N {where} would fit the others exchanged: "
                    "were rows exchanged?"
                )
                continue
        row = _farthest_row(contact, fitter, fits[k], touched_n)
        if row is None:
            continue
        force, phase = np.delete(contact.force_n, row), np.delete(contact.added_deg, row)
        after = fitter.fit(force, phase)
        if is_better(ratio(np.insert(after.residual, row, 0.0), after.freedom), rows):
            beside = contact.added_deg[row] - float(
                fitter.value(after, contact.force_n[row : row + 1])[0]
            )
            found.append(
                f"the phase of {contact.force_n[row]:g} N {where} is {beside:+.1f} deg beside the "
                "curve of the others: was it measured, or typed, wrong?"
            )
    return found


def _row_log_ratio(
    given: ForceCurve,
    slope: np.ndarray,
    noise: np.ndarray,
    noise_freedom: float,
    residual: np.ndarray,
    freedom: float,
) -> float:
    """How much likelier residuals (n,) of so many degrees of freedom are than those given.

    ``slope`` (n,): of the curve; ``noise``: of :func:`_noise`, and its degrees of freedom.
    """
    # A curve that does not follow its data leaves more than noise.
    left = max(float(np.sum(residual**2)) / freedom, ROUNDED_DEG**2)
    variance = np.maximum(noise[0] + noise[1] * slope**2, left)
    square = max(float(np.sum((given.residual**2 - residual**2) / variance)), 0.0)
    # Noise that few rows tell is Student's.
    return (noise_freedom + 1) / 2 * float(np.log1p(square / noise_freedom))


def find_untouched_scatter(data: CarrierData, carrier: Carrier) -> list[str]:
    """Ports whose untouched phases scatter more than those of presses do.

    Returns list of str: a sentence each. Every reading is a change against their mean.
    """
    found = []
    rows = sum(map(len, data.untouched_rows_deg))  # each may be the wrong one
    for port, phases in enumerate(data.untouched_rows_deg):
        if len(phases) < 2 or data.untouched_deg is None:
            continue
        beside = wrap_deg(phases - data.untouched_deg[port])
        noise = max(carrier.noise_deg[port], ROUNDED_DEG)
        excess = float(np.sum(beside**2)) / (len(phases) - 1) / noise**2
        ratio = (len(phases) - 1) / 2 * (excess - 1 - np.log(max(excess, 1.0)))
        if excess > 1 and is_better(ratio, rows):
            found.append(
                f"untouched phases of port {port + 1} differ by {np.ptp(beside):.1f} deg, where "
                f"those of presses scatter by {noise:.2g} deg: is each right, and were cables "
                "fixed?"
            )
    return found


def _farthest_row(
    contact: ContactCurve, fitter: CurveFitter, fit: ForceCurve, without_n: float
) -> int | None:
    """The row of a press that lies farthest beside a curve of the others; None where none may."""
    basis = fitter.basis(contact.force_n)
    rest = 1.0 - np.einsum("ij,jk,ik->i", basis, fit.unit_covariance, basis)
    gain = np.where(contact.force_n > without_n, fit.residual**2 / np.maximum(rest, 1e-9), 0.0)
    row = int(np.argmax(gain))
    return row if gain[row] > 0 else None


def _noise(fits: Sequence[ForceCurve], slopes: Sequence[np.ndarray]) -> np.ndarray:
    """Variance of phases (deg^2) and of forces (N^2) about fitted curves of known slopes."""
    parts = [
        fit.freedom / len(slope) * np.column_stack([np.ones(len(slope)), slope**2])
        for fit, slope in zip(fits, slopes, strict=True)
    ]
    squares = np.concatenate([fit.residual**2 for fit in fits])
    return np.asarray(nnls(np.concatenate(parts), squares)[0])


def _best_exchange(
    contact: ContactCurve, fitter: CurveFitter, fit: ForceCurve, without_n: float
) -> tuple[tuple[int, int] | None, int]:
    """The two rows of a press, by their index, whose exchange reduces the squares about a curve
    most, None where none does; and how many could be exchanged.

    ``without_n``: largest force that did not short the line.
    """
    pressed = contact.force_n > without_n
    pair, most, count = None, 0.0, 0
    for press in np.unique(contact.press[pressed]):
        rows = np.flatnonzero(pressed & (contact.press == press))
        added, residual = contact.added_deg[rows], fit.residual[rows]
        basis = fitter.basis(contact.force_n[rows])
        weighed = basis @ fit.unit_covariance
        # What a fit leaves of a row, exactly where the coefficients are free.
        rest = 1.0 - np.sum(weighed * basis, axis=1)
        # A row at a time: all pairs of a press with 30 000 rows would not fit in memory.
        for first in range(len(rows) - 1):
            later = slice(first + 1, None)
            step = added[later] - added[first]
            size = rest[first] + rest[later] + 2 * (basis[later] @ weighed[first])
            gain = step * (2 * (residual[later] - residual[first]) - step * size)
            best = int(np.argmax(gain))
            if gain[best] > most:
                pair, most = (int(rows[first]), int(rows[first + 1 + best])), float(gain[best])
        count += len(rows) * (len(rows) - 1) // 2
    return pair, count
