# SPDX-License-Identifier: GPL-3.0-or-later
"""What untouched strips say of the force on the one strip that is touched."""

import numpy as np
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.surface.estimator import SurfaceEstimator

PRESSES, NOISE_DEG = 400, 4.0


def test_force_on_one_strip_is_no_better_known_than_stated():
    """Beside strips below their onset the force was stated five standard deviations off."""
    skin = plan("surface_four_strips").skin
    rng, count = np.random.default_rng(6), len(skin.strips)
    force = rng.uniform(1.2, 8, PRESSES)
    x, y = rng.uniform(25, 55, PRESSES), rng.uniform(*skin.y_span_mm, PRESSES)
    error = skin.spreading.share_std * rng.standard_normal((PRESSES, count))
    borne = (skin.shares(y) + error) * force[:, None]
    touched = borne > skin.untouched_below_n
    phases = np.zeros((PRESSES, count, 2))
    for i, strip in enumerate(skin.strips):
        begin, end = strip.x_of(0.0), strip.x_of(1.0)
        own = (x - begin) / (end - begin) + skin.spreading.offset_mm(i)
        pressed = np.maximum(borne[:, i], 0.05)
        phases[:, i] = strip.model.phases_deg(pressed, own, skin.frequency_hz)
    phases += NOISE_DEG * rng.standard_normal(phases.shape)
    std, usable = np.full(phases.shape, NOISE_DEG), np.ones(touched.shape, bool)
    found = SurfaceEstimator(skin).read(phases, std, usable, touched)
    one = (touched.sum(axis=1) == 1) & ~found.inconsistent[:, 0]
    away = (found.mean[one, 0, 0] - force[one]) / np.sqrt(found.covariance[one, 0, 0, 0])
    assert one.sum() > PRESSES / 5
    assert np.abs(away).max() < 4
    assert (np.abs(away) < 2).mean() > 0.95
