# SPDX-License-Identifier: GPL-3.0-or-later
"""The simulated channel, measured on its samples: tag, levels, streaming, rooms and radios."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.capture.frame import MARGIN, measure_levels
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.effects import RadioNoise
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.radio import noise_over_static
from gnuradio.wiforce.simulation.tag import SWITCHES, switch_states
from long_cases import cases
from quiet_air import channel_of, scene
from second_simulator import FRAME, RATE, channels, frame

T = FRAME / RATE
TA = 256 / RATE
FREE = {"reader_clock": "free"}


def snapshots(channel, count, first=0):
    """H[n, k] in units of the tag; shape (count, 62)."""
    return channels(channel.process(np.tile(frame(), count), first * FRAME)) / channel.scale


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
    return one, channel.sensors["s0"].clock, snapshots(channel, 3125)


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
@pytest.mark.parametrize(
    ("waveform", "first", "count", "carriers"), [("repeated", 64, 4, 62), ("wifi", 192, 2, 52)]
)
def test_channel_snr_is_tag_line_over_noise(snr_db, waveform, first, count, carriers):
    one = load_scene(scene(snr_db=snr_db).as_dict() | {"sounding": {"waveform": waveform}})
    channel = AirChannel(one)
    channel.sensors["s0"].on = False
    received = channel.process(np.tile(one.waveform().frame(), 2000), 0).reshape(2000, -1)
    folded = received[:, first : first + 64 * count].reshape(-1, count, 64).mean(axis=1)
    spectrum = np.fft.fft(folded.astype(complex))[:, 1:27]
    noise_h = np.mean(np.abs(spectrum) ** 2) * carriers / 64**2 / channel.scale**2
    c1 = 0.25 * np.sinc(0.25) * np.sinc(1000 * count * 64 / RATE)
    assert db(c1**2 / noise_h) == pytest.approx(snr_db, abs=0.1)


@pytest.mark.parametrize("level_db", [0, 80])
def test_channel_static_clutter_has_stated_power(level_db):
    h = snapshots(channel_of(False, static_clutter_db=level_db), 50)[1:]
    assert db(np.mean(np.abs(h) ** 2) / harmonics(1)[0] ** 2) == pytest.approx(level_db, abs=0.02)
    assert np.ptp(db(np.abs(h[0]) ** 2)) > 1  # frequency-selective


def test_channel_moving_clutter_has_stated_power_in_band():
    channel = channel_of(False, moving_clutter_db=30, environment={"moving_clutter_hz": 60})
    frames = 13021  # 0.75 s
    h = snapshots(channel, frames)[:, ::10]
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
    h = snapshots(channel, 3125)  # 180 and 252 whole periods
    strong = np.abs(line(h, 1, channel.sensors["s0"].clock)) / harmonics(1)[0]
    weak = np.abs(line(h, 1, channel.sensors["s1"].clock)) / harmonics(1, 1400.0)[0]
    assert 20 * np.log10(strong.mean()) == pytest.approx(0, abs=0.05)
    assert 20 * np.log10(weak.mean()) == pytest.approx(-3, abs=0.05)


def test_channel_free_receiver_rotates_by_carrier_offset():
    shared, free = (
        scene(static_clutter_db=60, environment=FREE, carrier_offset_hz=hz) for hz in (0.0, 1234.5)
    )
    a, b = (AirChannel(one).process(np.tile(frame(), 60), 0) for one in (shared, free))
    loud = np.abs(a) > 0.1
    rotated = b[loud] / a[loud] * np.exp(-2j * np.pi * 1234.5 * np.flatnonzero(loud) / 12.5e6)
    assert np.abs(rotated - 1).max() < 1e-4


def test_channel_phase_noise_has_stated_linewidth():
    channel = channel_of(False, static_clutter_db=60, environment=FREE, phase_noise_hz=20.0)
    phase = np.unwrap(np.angle(snapshots(channel, 17361)[1:, 20]))
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


def db(power):
    return 10 * np.log10(power)


PRESS = {"start_s": 0.5, "hold_s": 0.5, "rise_s": 0.001, "force_n": 4.0, "location_mm": 33.0}
EFFECTS = {
    "bursts": {"bursts": {"share": 0.4, "level_db": 30}},
    "front_end": {
        "front_end": {"receiver_gain_db": 0.5, "transmitter_phase_deg": 3, "compression": 0.01}
    },
    "radio_noise": {"radio_noise": {"phase_noise_dbc_hz": -90}},
    "ripple": {"ripple": {}},
    "lamps": {"lamps": {"level_db": 20}},
    "fan": {"fan": {}},
    "walker": {"walker": {"level_db": 30}},
    "other_tags": {"other_tags": [{"clock_hz": 1500, "delay_s": 3e-8, "level_db": 0}]},
    "clock": {
        "tags": [
            {
                "clock_offset_ppm": 3000,
                "clock_wander_ppm_per_sqrt_s": 20,
                "clock_period_jitter_s": 3e-7,
                "clock_jitter_s": 1e-6,
                "clock1_duty_error": -0.008,
                "clock2_duty_error": 0.009,
                "clock2_delay_s": 3e-6,
                "switch_rise_s": 2e-6,
            }
        ]
    },
    "drift": {"tags": [{"drift_deg_per_sqrt_s": 30}]},
    "beam": {"tags": [{"beam": {"creep": 0.5, "creep_s": 0.01}}], "presses": [PRESS]},
    "hand": {"tags": [{"hand": {"level_db": 0}}], "presses": [PRESS]},
    "hopper": {"hopper": {"shortest_s": 1e-3, "longest_s": 2e-3}},
    "room": {
        "moving_clutter_db": 30,
        "tag_coherence_hz": 2e6,
        "carrier_offset_hz": 500.0,
        "phase_noise_hz": 1.0,
        "presses": [PRESS],
        "environment": {"reader_clock": "free", "moving_clutter_hz": 60},
    },
}


@pytest.mark.parametrize("name", EFFECTS)
def test_effect_is_the_same_wherever_a_stream_starts_and_is_divided(name):
    """A host of the software N210 may start late, and receives in pieces of any size."""
    sent = np.tile(frame(), 140).astype(np.complex64)
    settings = {"static_clutter_db": 30, "snr_db": 10} | EFFECTS[name]
    start = 6_249_000  # sample 6 250 000 is 0.5 s
    # The phase of two free oscillators is drawn as it comes.
    later = start if name == "room" else start + 30 * FRAME
    key = next(iter(EFFECTS[name]))
    whole, pieces, without = (
        channel_of(**each) for each in (settings, settings, settings | {key: None})
    )
    for channel, first in ((whole, start), (pieces, later), (without, start)):
        channel.set_snr_db(140)  # as is the receiver's noise
        channel.restart(first)
    expected = whole.process(sent, start)
    assert np.abs(without.process(sent, start) - expected).max() > 1e-4  # it does something
    sent, expected = sent[later - start :], expected[later - start :]
    got, done = [], 0
    for size in (1, 2, 1000, 7, 40_000, 363, 33_000, len(sent)):
        got.append(pieces.process(sent[done : done + size], later + done))
        done += len(got[-1])
    np.testing.assert_allclose(np.concatenate(got)[10:], expected[10:], atol=3e-6)


@pytest.mark.parametrize("share, level_db", cases((0.2, 25), long=((0.45, 35),)))
def test_bursts_have_stated_share_level_and_durations(share, level_db):
    channel = channel_of(bursts={"share": share, "level_db": level_db}, snr_db=10)
    count = 6_250_000
    received = np.concatenate(
        [channel.process(np.zeros(1_250_000), 1_250_000 * i) for i in range(count // 1_250_000)]
    )
    power = np.convolve(np.abs(received) ** 2, np.ones(50) / 50, "same")
    on = power > 10 * channel.noise_std**2
    assert np.mean(on) == pytest.approx(share, rel=0.15)
    inside = np.abs(received[on]) ** 2
    assert db(inside.mean() / channel.noise_std**2) == pytest.approx(level_db, abs=0.3)
    edges = np.flatnonzero(np.diff(on.astype(int)))
    durations = np.diff(edges)[::2] if on[edges[0] + 1] else np.diff(edges)[1::2]
    assert 0.3e-3 - 1e-5 < durations.min() / RATE < 0.4e-3
    # Two bursts with a short pause between them count as one here.
    assert 1e-3 < np.median(durations) / RATE < 1.3e-3 / (1 - share)


def test_bursts_reach_both_antennas_at_once():
    """The ratio of two antennas must meet the same bursts in both."""
    bursts = {"share": 0.5, "level_db": 40}
    both = scene(environment=FREE | {"receive_antennas": 2}, snr_db=10, bursts=bursts)
    first, second = (
        AirChannel(both, antenna=antenna).process(np.zeros(200_000), 0) for antenna in (0, 1)
    )
    powers = [np.mean(np.abs(each) ** 2) for each in (first, second)]
    common = np.vdot(first, second) / np.sqrt(np.prod(powers)) / len(first)
    assert abs(common) > 0.99 and abs(np.angle(common)) > 0.01


def lines_at(h, hertz):
    """Lines at some frequencies on each subcarrier, through a Kaiser window."""
    window = np.kaiser(len(h), 14)[:, None]
    times = np.arange(len(h)) * T
    lines = [(h * window * np.exp(-2j * np.pi * f * times)[:, None]).sum(axis=0) for f in hertz]
    return np.array(lines) / window.sum()


def spectrum_db(h, hertz):
    """Power of lines, mean over the subcarriers, relative to the tag's line."""
    return db(np.mean(np.abs(lines_at(h, hertz)) ** 2, axis=1) / harmonics(1)[0] ** 2)


@pytest.mark.parametrize("side", ["receiver", "transmitter"])
def test_front_end_image_has_ratio_of_stated_imbalance(side):
    """A tone above the carrier: its image stands below, .5 dB and 3 deg give -28.2 dB."""
    stated = {f"{side}_gain_db": 0.5, f"{side}_phase_deg": 3.0}
    channel = channel_of(False, static_clutter_db=60, front_end=stated)
    tone = 0.5 * np.exp(2j * np.pi * 8 * np.arange(64_000) / 64)
    spectrum = np.fft.fft(channel.process(tone, 0)[64 * 100 :].reshape(-1, 64).mean(axis=0))
    ratio = np.abs(spectrum[-8] / spectrum[8])
    response = np.fft.fft(static_response(channel), 64)
    if side == "transmitter":  # the image goes through the room at its own frequency
        ratio *= np.abs(response[8] / response[-8])
    assert ratio == pytest.approx(0.0389, rel=0.01)


def static_response(channel):
    """Impulse response of the static paths, as received."""
    pulse = np.zeros(64)
    pulse[0] = 1e-3
    clean = channel_of(False, static_clutter_db=60)
    assert clean.scale == channel.scale
    return clean.process(pulse, 0) / 1e-3


def test_front_end_dc_and_compression_have_stated_size():
    plain = channel_of(False, static_clutter_db=60)
    bent = channel_of(False, static_clutter_db=60, front_end={"compression": 0.04})
    shifted = channel_of(False, static_clutter_db=60, front_end={"dc_offset": 0.05})
    samples = np.tile(frame(), 3)
    a, b, c = (channel.process(samples, 0) for channel in (plain, bent, shifted))
    peak = 10 ** (-3 / 20)
    loud = np.abs(a) > 0.3
    lost = 1 - np.abs(b[loud] / a[loud])
    np.testing.assert_allclose(lost, 0.04 * (np.abs(a[loud]) / peak) ** 2, atol=1e-5)
    assert np.ptp(np.angle(b[loud] / a[loud])) < 1e-5
    assert np.abs((c - a).mean()) == pytest.approx(0.05 * peak, rel=1e-4)


def test_phase_noise_has_stated_density_and_is_alike_on_all_subcarriers():
    """-80 dBc/Hz, falling beyond 5 kHz: what a line of the tag meets beside a static path."""
    stated = {"phase_noise_dbc_hz": -80, "loop_hz": 5000, "transmitter_dbc_hz": -200}
    channel = channel_of(False, static_clutter_db=60, radio_noise=stated)
    h = snapshots(channel, 8192)
    mean = h.mean(axis=0)
    turned = h @ mean.conj() / np.vdot(mean, mean)
    # Within 20.48 us the phase changes by what lies above 48 kHz: 2/pi atan(5/48) = 7 % of it.
    within = np.mean(np.abs(h - np.outer(turned, mean)) ** 2)
    assert within < 0.1 * np.var(turned.imag) * np.mean(np.abs(mean) ** 2)
    density = np.abs(np.fft.fft((turned.imag) * np.hanning(8192))) ** 2 * T / (8192 * 3 / 8)
    hertz = np.fft.fftfreq(8192, T)
    near = (np.abs(hertz) > 900) & (np.abs(hertz) < 1100)
    # What lies a snapshot rate away, seen through 20.48 us of averaging, adds to the density there.
    aliased = 1000 + np.arange(-16, 17) / T
    passed = 1e-8 / (1 + (aliased / 5000) ** 2) * np.sinc(aliased * 20.48e-6) ** 2
    # 94 values of a chi-squared of 2: known to 10 %
    assert db(density[near].mean()) == pytest.approx(db(passed.sum()), abs=1.5)


@pytest.mark.parametrize("density", [-101, -110])
def test_check_measures_phase_noise_beside_tag_and_noise(density):
    """What decides how far below the static path a tag may be, before anything is read."""
    stated = RadioNoise(phase_noise_dbc_hz=density)
    settings = {"static_clutter_db": 60, "snr_db": 10}
    noisy = channel_of(**settings, radio_noise={"phase_noise_dbc_hz": density})
    waveform = sounding_waveform("repeated", FRAME, RATE)
    sent = np.tile(frame(), 2001).astype(np.complex64)
    measured, clean = (
        measure_levels(channel.process(sent, 0)[FRAME - MARGIN : -MARGIN], waveform)
        for channel in (noisy, channel_of(**settings))
    )
    hertz = np.linspace(0.5, 8.5, 50) * 1e3
    alike = [noise_over_static(stated, waveform, f)[0] for f in hertz]
    # The simulated phase is linear between knots of 10 us, which takes 1 dB at 17 kHz and 0.5 dB of
    # what the snapshots hold. The median of 940 frequencies is known to 0.2 dB, four of which are
    # allowed.
    assert measured.phase_noise_dbc_hz == pytest.approx(db(np.median(alike) * T) - 0.5, abs=0.8)
    assert clean.phase_noise_dbc_hz is None


def test_ripple_has_stated_frequency_and_depth():
    channel = channel_of(False, static_clutter_db=60, ripple={"percent": 10, "hz": 50})
    h = snapshots(channel, 6945)  # 0.4 s, 20 periods
    lines = spectrum_db(h, [50, -50, 0, 100])
    np.testing.assert_allclose(lines[:3], [60 - 26.02, 60 - 26.02, 60], atol=0.05)
    assert lines[3] < -20


@pytest.mark.parametrize("mains_hz", cases(60, long=(50,)))
def test_lamps_lines_fall_with_harmonic_number(mains_hz):
    stated = {"mains_hz": mains_hz, "level_db": 10, "wander_hz_per_sqrt_s": 0}
    h = snapshots(channel_of(False, lamps=stated), 12_000)
    harmonics = np.array([1, 2, 5, -10, 20])
    lines = spectrum_db(h, 2 * mains_hz * harmonics)
    expected = 10 - 20 * np.log10(np.abs(harmonics))
    # The snapshot averages 20 us, which costs 0.1 dB at 2.4 kHz.
    np.testing.assert_allclose(lines, expected, atol=0.3)
    assert spectrum_db(h, [3 * mains_hz])[0] < -40


def test_walker_has_stated_level():
    channel = channel_of(False, walker={"level_db": 25, "walk_s": 5, "walking_share": 0.9})
    powers = []
    for first in range(0, 200_000, 1000):
        channel.restart(first * FRAME)
        powers.append(np.mean(np.abs(snapshots(channel, 1, first)) ** 2))
    assert db(np.mean(powers) / harmonics(1)[0] ** 2) == pytest.approx(25, abs=1)


def test_other_tag_has_own_line_level_and_delay():
    stated = {"clock_hz": 1000, "clock_offset_ppm": 20_000, "level_db": -10, "delay_s": 80e-9}
    ours, other = lines_at(snapshots(channel_of(other_tags=[stated]), 4000), (1000.04, 1020))
    relative = np.mean(np.abs(other) ** 2) / np.mean(np.abs(ours) ** 2)
    assert db(relative) == pytest.approx(-10, abs=0.1)
    turns = np.unwrap(np.angle(other / ours))[20:42] / (2 * np.pi)
    slope = np.polyfit(np.r_[-11:0, 1:12] / 64 * RATE, turns, 1)[0]
    assert -slope == pytest.approx(80e-9, rel=0.05)
