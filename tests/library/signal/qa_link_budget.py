# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses of paths against published tables and formulas that can be computed by hand."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.link import (
    VACUUM_PERMITTIVITY_F_M,
    free_space_loss_db,
    layers_loss_db,
    tissue_permittivity,
)

SENSORS = [{"name": "arm", "model": "line-900mhz-calibrated"}]
# Wavelength in air at 900 MHz.
WAVE_M = 299_792_458 / 900e6


def scene_with(link, **simulation):
    return load_scene({"sensors": SENSORS, "simulation": {"link": link, **simulation}})


def test_free_space_loses_6_db_per_doubling_of_distance():
    # (4 pi 1 m / 0.33310 m)^2 = 37.725^2
    assert free_space_loss_db(1.0, 900e6) == pytest.approx(31.53, abs=0.01)
    assert free_space_loss_db(2.0, 900e6) - free_space_loss_db(1.0, 900e6) == pytest.approx(
        6.02, 1e-3
    )


@pytest.mark.parametrize(
    ("tissue", "mhz", "permittivity", "conductivity"),
    [
        # IFAC, Dielectric Properties of Body Tissues, after Gabriel et al. 1996
        ("muscle", 900, 55.032, 0.943),
        ("muscle", 2450, 52.729, 1.739),
        ("fat", 900, 5.462, 0.051),
        ("fat", 2450, 5.280, 0.105),
        ("skin", 900, 41.405, 0.867),
        ("skin", 2450, 38.007, 1.464),
    ],
)
def test_tissues_have_published_permittivity(tissue, mhz, permittivity, conductivity):
    found = tissue_permittivity(tissue, mhz * 1e6)
    assert found.real == pytest.approx(permittivity, abs=0.001)
    sigma = -found.imag * 2 * np.pi * mhz * 1e6 * VACUUM_PERMITTIVITY_F_M
    assert sigma == pytest.approx(conductivity, abs=0.0006)


def test_layers_reflect_at_their_borders_and_absorb_inside():
    # A quarter wave of permittivity 4: T = 1/(1 + (3/4)^2); half a wave passes everything.
    quarter_m = WAVE_M / 4 / 2
    assert layers_loss_db([(4, quarter_m)], 900e6) == pytest.approx(10 * np.log10(1.5625), abs=1e-6)
    assert layers_loss_db([(4, 2 * quarter_m)], 900e6) == pytest.approx(0, abs=1e-6)
    # Two halves are one layer.
    halves = [(4, quarter_m / 2)] * 2
    assert layers_loss_db(halves, 900e6) == pytest.approx(10 * np.log10(1.5625), abs=1e-6)
    # Muscle at 900 MHz: a penetration depth (42.4 mm, IFAC) more costs 8.69 dB in thick layers.
    muscle = tissue_permittivity("muscle", 900e6)
    thick = [layers_loss_db([(muscle, depth)], 900e6) for depth in (0.3, 0.3424)]
    assert np.diff(thick) == pytest.approx(8.69, abs=0.02)


def test_levels_of_a_scene_follow_from_its_link():
    """By hand: 2 m and 2 m at 900 MHz, 10 dBm, noise figure 6 dB, 12.5 Msps, no other losses."""
    link = {"transmitter_m": 2, "receiver_m": 2, "tag_loss_db": 0}
    found = scene_with(link).simulation
    line = 20 * np.log10(0.25 * np.sinc(0.25) * np.sinc(1000 * 20.48e-6))  # -12.96 dB
    received = 10 - 2 * 37.551 + line
    noise = -173.975 + 6 + 10 * np.log10(12.5e6 * 62 / 256)
    assert found.snr_db == pytest.approx(received - noise, abs=0.01)
    assert found.static_clutter_db == pytest.approx(10 - 43.572 - received, abs=0.01)
    # Each gain counts where it acts: that of the tag twice, and not on the direct path.
    more = scene_with(link | {"tag_dbi": 2, "transmitter_dbi": 3, "direct_loss_db": 20}).simulation
    assert more.snr_db - found.snr_db == pytest.approx(7, abs=0.011)
    assert more.static_clutter_db - found.static_clutter_db == pytest.approx(-24, abs=0.011)
    stated = scene_with(link, snr_db=3.0).simulation
    assert (stated.snr_db, stated.static_clutter_db) == (3.0, found.static_clutter_db)


def layers(material, thickness_mm, count=1, **more):
    return {"layers": [{"material": material, "thickness_mm": thickness_mm} | more] * count}


@pytest.mark.parametrize(
    ("link", "message"),
    [
        ({"antennas_m": 2.8}, "antennas_m: must be 1.3 to 2.7 m, with the tag .*, got 2.8"),
        ({"antennas_m": 1.2}, "antennas_m: must be 1.3 to 2.7 m"),
        ({"receiver_m": 0.01}, "receiver_m: must be a number from 0.05"),
        (
            layers("fat", 400, 2),
            r"layers: must be thinner together \(800 mm\) than .* away \(700 mm\)",
        ),
        (layers("fat", 0), "thickness_mm: must be .* above 0"),
        (layers("other", 5), "permittivity: must be given for material"),
        (
            layers("fat", 5, conductivity_s_m=1),
            "conductivity_s_m: must be given for material 'other', and for no other",
        ),
    ],
)
def test_impossible_geometry_and_layers_are_refused(link, message):
    with pytest.raises(InputError, match=f"simulation.link.{message}|layers.0..{message}"):
        scene_with({"transmitter_m": 0.7, "receiver_m": 2.0} | link)


def test_rounded_distances_of_a_tag_in_line_are_a_triangle():
    """0.1 + 0.2 is more than 0.3."""
    scene_with({"transmitter_m": 0.1, "receiver_m": 0.2, "antennas_m": 0.3})
