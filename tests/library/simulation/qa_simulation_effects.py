# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects of real rooms and radios, measured on simulated samples against the stated keys."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import MARGIN, measure_levels
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.effects import RadioNoise
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.radio import noise_over_static
from long_cases import cases

RATE = 12.5e6
FRAME = 720
T = FRAME / RATE
QUIET = {"static_clutter_db": None, "snr_db": 120, "duration_s": 10, "adc_bits": None}


def channel_of(tags_on=True, environment=None, **simulation):
    """The channel of a scene with one sensor, without anything else unless stated."""
    scene = load_scene(
        {
            "sensors": [{"name": "arm", "model": "line-900mhz"}],
            "environment": environment or {},
            "simulation": QUIET | simulation,
        }
    )
    channel = AirChannel(scene)
    channel.sensors["arm"].on = tags_on
    return channel


def frame():
    k = np.r_[-31:0, 1:32]
    n = np.arange(64)
    symbol = np.exp(2j * np.pi * np.outer(n, k) / 64) @ np.exp(1j * np.pi * k**2 / 64)
    return np.r_[np.tile(symbol / np.sqrt(62), 5), np.zeros(400)]


def snapshots(channel, count, first=0):
    """H[n, k] from the signal model, in units of the tag; shape (count, 62)."""
    received = channel.process(np.tile(frame(), count), first * FRAME)
    folded = received.reshape(count, FRAME)[:, 64:320].reshape(count, 4, 64).mean(axis=1)
    k = np.r_[-31:0, 1:32]
    reference = np.exp(1j * np.pi * k**2 / 64) * 64 / np.sqrt(62)
    return np.fft.fft(folded.astype(complex))[:, k] / reference / channel.scale


def tag_line(clock_hz=1000.0):
    """|c1[1] G1| of the signal model."""
    return 0.25 * np.sinc(0.25) * np.sinc(clock_hz * 256 / RATE)


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


def test_effect_whose_keys_contradict_each_other_is_refused():
    with pytest.raises(InputError, match="bursts.longest_s: must not be below shortest_s .0.003."):
        channel_of(bursts={"shortest_s": 3e-3})


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
    scene = load_scene(
        {
            "sensors": [{"name": "arm", "model": "line-900mhz"}],
            "environment": {"reader_clock": "free", "receive_antennas": 2},
            "simulation": QUIET | {"snr_db": 10, "bursts": {"share": 0.5, "level_db": 40}},
        }
    )
    first, second = (
        AirChannel(scene, antenna=antenna).process(np.zeros(200_000), 0) for antenna in (0, 1)
    )
    powers = [np.mean(np.abs(each) ** 2) for each in (first, second)]
    common = np.vdot(first, second) / np.sqrt(np.prod(powers)) / len(first)
    assert abs(common) > 0.99 and abs(np.angle(common)) > 0.01


def spectrum_db(h, hertz):
    """Power of lines, mean over the subcarriers, relative to the tag's line; Kaiser window."""
    window = np.kaiser(len(h), 14)[:, None]
    times = np.arange(len(h)) * T
    lines = [(h * window * np.exp(-2j * np.pi * f * times)[:, None]).sum(axis=0) for f in hertz]
    return db(np.mean(np.abs(lines) ** 2, axis=1) / window.sum() ** 2 / tag_line() ** 2)


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
    assert db(np.mean(powers) / tag_line() ** 2) == pytest.approx(25, abs=1)


def test_other_tag_has_own_line_level_and_delay():
    stated = {"clock_hz": 1000, "clock_offset_ppm": 20_000, "level_db": -10, "delay_s": 80e-9}
    channel = channel_of(other_tags=[stated])
    h = snapshots(channel, 4000)
    window = np.kaiser(len(h), 14)[:, None]
    times = np.arange(len(h)) * T
    ours, other = (
        (h * window * np.exp(-2j * np.pi * f * times)[:, None]).sum(axis=0) / window.sum()
        for f in (1000 * (1 + 40e-6), 1020)
    )
    assert db(np.mean(np.abs(other) ** 2) / np.mean(np.abs(ours) ** 2)) == pytest.approx(
        -10, abs=0.1
    )
    turns = np.unwrap(np.angle(other / ours))[20:42] / (2 * np.pi)
    slope = np.polyfit(np.r_[-11:0, 1:12] / 64 * RATE, turns, 1)[0]
    assert -slope == pytest.approx(80e-9, rel=0.05)
