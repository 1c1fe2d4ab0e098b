# SPDX-License-Identifier: GPL-3.0-or-later
"""The simulated channel and front end in plain NumPy: tag, levels, presses, filters, streaming."""

import numpy as np
import pytest
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.tag import SWITCHES, switch_states

TA = 256 / 12.5e6
T = 720 / 12.5e6
QUIET = {"static_clutter_db": None, "snr_db": 120, "duration_s": 10}


def scene(sensors=({},), **simulation):
    return load_scene(
        {
            "sensors": [
                {"name": f"s{i}", "model": "line-900mhz"} | sensor
                for i, sensor in enumerate(sensors)
            ],
            "environment": {
                "moving_clutter_hz": simulation.pop("moving_hz", 0),
                "reader_clock": simulation.pop("reader_clock", "shared"),
            },
            "simulation": QUIET | simulation,
        }
    )


def snapshots(channel, scene, count, first=0):
    """H[n, k] of a run of frames in units of the tag, written from the signal model."""
    frame = scene.waveform().frame()
    received = channel.process(np.tile(frame, count), first * len(frame))
    folded = received.reshape(count, -1)[:, 64:320].reshape(count, 4, 64).mean(axis=1)
    k = np.r_[-31:0, 1:32]
    reference = np.exp(1j * np.pi * k**2 / 64) * 64 / np.sqrt(62)
    return np.fft.fft(folded.astype(complex))[:, k] / reference / channel.scale


def harmonics(m, clock_hz=1000.0):
    """c1[m], c2[m] of the signal model."""
    hold = np.sinc(m * clock_hz * TA)
    c2 = 0.25 * np.sinc(m / 8) * np.cos(np.pi * m / 2) * hold if m % 2 == 0 else 0.0
    return 0.25 * np.sinc(m / 4) * hold, c2


def line(h, m, clock):
    """Harmonic m of the tag in each subcarrier, its clock's true phase taken out."""
    times = np.arange(len(h)) * T + 191.5 / 12.5e6
    return (h * np.exp(-2j * np.pi * m * clock.cycles(times))[:, None]).mean(axis=0)


@pytest.fixture(scope="module")
def untouched_run():
    """Scene, clock and H of 0.18 s: 180 whole periods of a clock that is off and drifts."""
    one = scene(clock_offset_ppm=40, clock_drift_ppm_per_s=0.5)
    channel = AirChannel(one)
    return one, channel.sensors["s0"].clock, snapshots(channel, one, 3125)


@pytest.mark.parametrize("m", [0, 1, -1, 2, -2, 3, 4, -4, 5, 6, -6, 7])
def test_channel_tag_spectrum_equals_analytic_harmonics(untouched_run, m):
    one, clock, h = untouched_run
    psi = np.deg2rad(one.load_model("line-900mhz").untouched_deg())

    def expected(m):
        c1, c2 = harmonics(m)
        return c1 * np.exp(1j * psi[0]) + c2 * np.exp(1j * psi[1])

    # A tone that turns within the symbol leaks a per cent into its neighbours: averaged out.
    path = line(h, 1, clock) / expected(1)
    seen = np.mean(line(h, m, clock) / path) / expected(m)
    assert abs(20 * np.log10(abs(seen))) < 0.1
    assert abs(np.angle(seen, deg=True)) < 0.5


def test_tag_both_switches_on_pass_through_untouched_line_only():
    press = {"start_s": 0.5, "rise_s": 0, "hold_s": 9, "force_n": 4.0, "location_mm": 33.0}
    one = scene(presses=[press], tags=[{"clock2_duty": "two_frequencies", "clock_phase_deg": 0}])
    tag = AirChannel(one).sensors["s0"]
    for start in (0, 12_500_000):
        state = tag.pressed.reflections(np.array([start / 12.5e6]))[0]
        both = tag.reflection(start, 10)[5] / tag._rotation  # at a cycle's start both are on
        if start:
            assert both == pytest.approx(state.sum(), abs=1e-5)
        else:
            # once through, in both directions: half the phase of the open end's echo
            assert abs(both) == pytest.approx(2, abs=1e-5)
            echo = np.angle(state[0] * state[1]) / 2
            assert (both / 2) ** 4 == pytest.approx(np.exp(2j * echo), abs=1e-4)


def test_channel_off_state_shows_while_both_switches_are_off():
    off = [0.3, -0.1]
    one = scene([{"off_reflection": off}])
    channel = AirChannel(one)
    tag = channel.sensors["s0"]
    r = tag.reflection(0, 12500)
    s1, s2 = switch_states(tag.clock, SWITCHES["pulses"], 0.0, 0, 12500, 12.5e6)
    psi = np.deg2rad(one.load_model("line-900mhz").untouched_deg())
    g1, g2 = np.exp(1j * psi)
    expected = s1 * g1 + s2 * g2 + (1 - s1 - s2) * complex(*off)
    turn = r[np.argmax(s1)] / expected[np.argmax(s1)]  # the air path's phase
    assert abs(abs(turn) - 1) < 1e-6
    np.testing.assert_allclose(r, expected * turn, atol=1e-6)


@pytest.mark.parametrize("snr_db", [-15, 10])
@pytest.mark.parametrize("waveform", ["repeated", "wifi"])
def test_channel_snr_is_tag_line_over_noise(snr_db, waveform):
    one = load_scene(
        {
            "sounding": {"waveform": waveform},
            "sensors": [{"name": "a", "model": "line-900mhz"}],
            "simulation": {"snr_db": snr_db, "static_clutter_db": None},
        }
    )
    channel = AirChannel(one)
    channel.sensors["a"].on = False
    received = channel.process(np.tile(one.waveform().frame(), 2000), 0).reshape(2000, -1)
    first, count, k_count = (64, 4, 62) if waveform == "repeated" else (192, 2, 52)
    folded = received[:, first : first + 64 * count].reshape(-1, count, 64).mean(axis=1)
    spectrum = np.fft.fft(folded.astype(complex))[:, 1:27]
    noise_h = np.mean(np.abs(spectrum) ** 2) * k_count / 64**2 / channel.scale**2
    c1 = 0.25 * np.sinc(0.25) * np.sinc(1000 * count * 64 / 12.5e6)
    assert 10 * np.log10(c1**2 / noise_h) == pytest.approx(snr_db, abs=0.1)


@pytest.mark.parametrize("level_db", [0, 60, 80])
def test_channel_static_clutter_has_stated_power(level_db):
    one = scene(static_clutter_db=level_db)
    channel = AirChannel(one)
    channel.sensors["s0"].on = False
    h = snapshots(channel, one, 50)
    power = np.mean(np.abs(h[1:]) ** 2)
    assert 10 * np.log10(power / harmonics(1)[0] ** 2) == pytest.approx(level_db, abs=0.02)
    assert np.ptp(20 * np.log10(np.abs(h[1]))) > 1  # frequency-selective


def test_channel_moving_clutter_has_stated_power_in_band():
    one = scene(moving_clutter_db=30, moving_hz=60)
    channel = AirChannel(one)
    channel.sensors["s0"].on = False
    frames = 13021  # 0.75 s
    h = snapshots(channel, one, frames)[:, ::10]
    power = np.mean(np.abs(h) ** 2)
    assert 10 * np.log10(power / harmonics(1)[0] ** 2) == pytest.approx(30, abs=1.0)
    window = np.kaiser(frames, 20)
    spectrum = np.mean(np.abs(np.fft.fft(h * window[:, None], axis=0)) ** 2, axis=1)
    doppler = np.abs(np.fft.fftfreq(frames, T))
    assert spectrum[doppler > 63].sum() < 1e-5 * spectrum.sum()
    assert spectrum[doppler > 5].sum() > 0.5 * spectrum.sum()
    assert np.abs(h.mean(axis=0)).max() < 0.7 * np.sqrt(power)  # it does move


def test_channel_tag_level_scales_its_path():
    both = scene([{"clock_hz": 1000}, {"clock_hz": 1400}], tags=[{"sensor": "s1", "level_db": -3}])
    channel = AirChannel(both)
    h = snapshots(channel, both, 3125)  # 180 and 252 whole periods
    strong = np.abs(line(h, 1, channel.sensors["s0"].clock)) / harmonics(1)[0]
    weak = np.abs(line(h, 1, channel.sensors["s1"].clock)) / harmonics(1, 1400.0)[0]
    assert 20 * np.log10(strong.mean()) == pytest.approx(0, abs=0.05)
    assert 20 * np.log10(weak.mean()) == pytest.approx(-3, abs=0.05)


def test_channel_free_receiver_rotates_by_carrier_offset():
    shared, free = (
        scene(static_clutter_db=60, reader_clock="free", carrier_offset_hz=hz)
        for hz in (0.0, 1234.5)
    )
    a, b = (
        AirChannel(one).process(np.tile(one.waveform().frame(), 60), 0) for one in (shared, free)
    )
    loud = np.abs(a) > 0.1
    rotated = b[loud] / a[loud] * np.exp(-2j * np.pi * 1234.5 * np.flatnonzero(loud) / 12.5e6)
    assert np.abs(rotated - 1).max() < 1e-4


def test_channel_phase_noise_has_stated_linewidth():
    one = scene(static_clutter_db=60, reader_clock="free", phase_noise_hz=20.0)
    channel = AirChannel(one)
    channel.sensors["s0"].on = False
    phase = np.unwrap(np.angle(snapshots(channel, one, 17361)[1:, 20]))
    for lag in (10, 100):
        steps = phase[lag:] - phase[:-lag]
        assert np.var(steps) == pytest.approx(2 * np.pi * 20.0 * lag * T, rel=0.35)
    assert np.abs(np.diff(phase)).max() < 0.5


def test_channel_out_of_order_samples_raise_until_restart():
    one = scene(static_clutter_db=60)
    channel = AirChannel(one)
    channel.process(np.ones(100), 0)
    with pytest.raises(ValueError, match="must continue at 100, got 99"):
        channel.process(np.ones(100), 99)
    channel.restart(1000)
    assert np.abs(channel.process(np.zeros(10), 1000)).max() < 1e-4


def test_channel_changes_while_running_take_effect():
    one = scene(clock_drift_ppm_per_s=0)
    channel = AirChannel(one)
    tag, model = channel.sensors["s0"], one.load_model("line-900mhz")
    untouched = channel.touch_state([0.1])["s0"]
    assert not untouched.touch[0] and np.isnan(untouched.location_mm[0])
    tag.pressed.hold(5.0, 50.0)
    state = channel.touch_state([0.1])["s0"]
    assert state.touch[0] and (state.force_n[0], state.location_mm[0]) == (5.0, 50.0)
    np.testing.assert_allclose(state.phases_deg[0], model.phases_deg(5.0, 50.0))
    tag.pressed.hold(0.1, 50.0)
    assert not channel.touch_state([0.1])["s0"].touch[0]
    tag.pressed.hold(None, None)
    assert np.isnan(channel.touch_state([0.1])["s0"].location_mm[0])
    tag.on = False
    assert not tag.reflection(0, 1000).any()
    noise = channel.noise_std
    channel.set_snr_db(100)  # from 120
    assert channel.noise_std == pytest.approx(10 * noise)


def test_pressed_sensor_moved_tag_rotates_both_ends():
    move = {"start_s": 1.0, "duration_s": 0.5, "distance_mm": 10.0}
    tag = AirChannel(scene(moves=[move])).sensors["s0"]
    turn = tag.pressed.motion(np.array([0.9, 1.25, 1.6]))
    two_way = -720 * 0.010 * 900e6 / 299792458
    np.testing.assert_allclose(np.angle(turn, deg=True), [0, two_way / 2, two_way], atol=1e-9)


def test_touch_state_follows_presses_of_scene():
    press = {
        "start_s": 1.0, "rise_s": 0.1, "hold_s": 0.5, "force_n": 4, "end_force_n": 6,
        "location_mm": 45,
    }  # fmt: skip
    later = press | {"start_s": 2.0, "rise_s": 0.0, "location_mm": 30}
    channel = AirChannel(scene(presses=[later, press]))
    times = [0.99, 1.05, 1.1, 1.35, 1.6, 1.65, 1.71, 2.0, 2.25, 2.49, 2.51]
    state = channel.touch_state(times)["s0"]
    forces = [0, 2, 4, 5, 6, 3, 0, 4, 5, 5.96, 0]
    np.testing.assert_allclose(state.force_n, forces, atol=1e-9)
    places = [np.nan, 45, 45, 45, 45, 45, np.nan, 30, 30, 30, np.nan]
    np.testing.assert_array_equal(state.location_mm, places)
    np.testing.assert_array_equal(state.touch, np.array(forces) >= 0.9)


def test_hand_trembles_by_the_stated_deviation_while_it_holds():
    press = {"start_s": 0.5, "rise_s": 0.1, "hold_s": 5.0, "force_n": 4, "location_mm": 45}
    channel = AirChannel(scene(presses=[press | {"tremor_n": 0.2}]))
    force_n = channel.touch_state(np.arange(0.6, 5.5, 0.01))["s0"].force_n
    assert np.std(force_n - 4) == pytest.approx(0.2, rel=0.05)
    assert np.mean(force_n) == pytest.approx(4, abs=0.02)
