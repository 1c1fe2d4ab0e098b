# SPDX-License-Identifier: GPL-3.0-or-later
"""Expected errors of a press on a surface, at points on its strips and between them."""

from typing import Any

import numpy as np

from ..surface.estimator import SurfaceEstimator
from .expected import MEDIAN, phase_std_deg
from .plan import Plan

# With this share a press between two strips that are shorted by 0.9 N is seen from 3.6 N on.
_LEAST_SHARE = 0.25


def expect_surface(plan: Plan) -> list[dict[str, Any]]:
    """Median errors on strips and halfway between, at mid-x and half the calibrated force.

    A row per point, whose ``strip`` is empty between strips.
    """
    skin = plan.skin
    if skin is None:
        return []
    noise = phase_std_deg(plan)[list(skin.indices)]
    own = skin.y_mm
    y = np.sort(np.concatenate([own, (own[1:] + own[:-1]) / 2]))
    force = float(max(1.0, round(skin.top_force_n / 2)))
    x = float(np.mean(skin.x_span_mm))
    loads = force * skin.shares(y)
    touched = loads >= skin.onset_force_n
    phases = np.stack(
        [
            strip.model.phases_deg(loads[:, i], strip.location_of(x), skin.frequency_hz)
            for i, strip in enumerate(skin.strips)
        ],
        axis=1,
    )
    std = np.broadcast_to(noise, phases.shape)
    found = SurfaceEstimator(skin).read(phases, std, np.ones(touched.shape, bool), touched)
    with np.errstate(invalid="ignore"):
        errors = MEDIAN * np.sqrt(np.einsum("gaa->ga", found.covariance[:, 0]))
    names = {strip.y_mm: strip.sensor for strip in skin.strips}
    keys = ("force_error_n", "x_error_mm", "y_error_mm")
    return [
        {"x_mm": x, "y_mm": at, "force_n": force, "strip": names.get(at, "")}
        | dict(zip(keys, error, strict=True))
        for at, error in zip(y.tolist(), errors.tolist(), strict=True)
    ]


def surface_warnings(plan: Plan) -> list[str]:
    """What a user of a surface should know before a measurement."""
    surface = plan.require_scene().surface
    if surface is None:
        return []
    if plan.skin is None:
        return ["surface: without a spreading law it is not read; `calibrate --surface` makes one"]
    skin = plan.skin
    between = skin.shares((skin.y_mm[1:] + skin.y_mm[:-1]) / 2).max(axis=-1).min()
    if between < _LEAST_SHARE:
        onset = float(skin.onset_force_n.max() / max(between, 1e-3))
        return [
            f"surface: between strips the largest share is {between:.2f}; presses below "
            f"{onset:.1f} N are not seen there; lay the strips closer, or use a stiffer skin"
        ]
    return []
