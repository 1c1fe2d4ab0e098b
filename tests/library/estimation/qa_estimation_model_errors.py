# SPDX-License-Identifier: GPL-3.0-or-later
"""Standard deviations where the model is wrong: residuals, profiles, drift, compression."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.capture.compression import measure_compression
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.reference import ProfileCheck, image_of
from gnuradio.wiforce.io.readings import Flag
from gnuradio.wiforce.press.explanations import filter_of
from gnuradio.wiforce.press.sensor_readout import SensorReadout
from gnuradio.wiforce.press.sensor_state import SensorState
from gnuradio.wiforce.sensor.file import load_sensor
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.wiforce_kernels import conjugate_difference
from plain import averaged_groups, normal

WAVEFORM = sounding_waveform()
PERIOD_S = 0.036


def received_with(image, channel):
    return channel + image * image_of(channel, WAVEFORM)


def compared(check, ends, reference, noise):
    """Changes of ends (G, 2, K) by noise of this variance, and factors of their variance."""
    groups, gain = len(ends), np.ones((len(ends), 2))
    variance = np.full((groups, ends.shape[2]), noise)
    found = conjugate_difference(
        ends, gain, variance, None, reference, np.zeros(2), check.by(reference)
    )
    return found["changes"], found["gain"]


@pytest.mark.parametrize("image_db, limit_deg", [(-40, 0.001), (-30, 0.003), (-20, 0.03)])
def test_image_of_unbalanced_receiver_does_not_change_phases(image_db, limit_deg):
    """An image at -30 dB would turn readings by up to 0.8 deg without a word."""
    rng = np.random.default_rng(5)
    delays = np.exp(-2j * np.pi * np.outer(rng.uniform(0, 0.2, 3), WAVEFORM.subcarriers / 5.12))
    channel = np.stack([np.ones(62), [1, 0.4, 0.2] @ delays])
    level = 10 ** (image_db / 20) * np.exp(1j)
    untouched = received_with(level, channel)
    turns = np.radians(np.array([[10.0, -70.0], [120.0, 95.0]]))
    pressed = received_with(level, np.exp(1j * turns)[:, :, None] * channel)
    changes, factor = compared(ProfileCheck(WAVEFORM, 2), pressed, untouched, 1e-12)
    ratios = changes.mean(axis=2)
    # To second order; what is left grows with the third power of the image.
    assert np.abs(np.degrees(np.angle(ratios) - turns)).max() < limit_deg
    assert factor.max() < 1.3  # the noise along the image's profile, and nothing else


def test_channel_with_another_path_raises_the_variance():
    """A second tag or a moving hand shows in the profile over the subcarriers."""
    rng, groups = np.random.default_rng(7), 30
    channel = np.ones((2, 62), complex)
    late = np.exp(-2j * np.pi * 0.1 * WAVEFORM.subcarriers / 5.12)  # by 100 ns
    noise = 0.01 * normal(rng, groups, 2, 62)
    check = ProfileCheck(WAVEFORM, 2)
    _, factor = compared(check, channel + 0.03 * late + noise, channel, 1e-4)
    assert factor.min() > 30
    check.reset()
    _, factor = compared(check, channel + noise, channel, 1e-4)
    assert np.median(factor) == 1


def compressed_frames(share, offset, before):
    """Frames of three static paths through a third-order receiver; and the linear symbol."""
    spectrum, cycles = np.fft.fft(WAVEFORM.frame()), np.fft.fftfreq(WAVEFORM.frame_length)
    linear = sum(
        level * np.fft.ifft(spectrum * np.exp(-2j * np.pi * cycles * lag))
        for lag, level in [(0, 1.0), (1, 0.4j), (3, -0.2)]
    )
    largest = np.abs(linear).max()
    drive = linear + (offset if before else 0)
    received = drive * (1 - share * np.abs(drive / largest) ** 2)
    received += 0 if before else offset
    return np.tile(received, 3), linear[64:128], largest


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("share, offset", [(0.01, 0.0), (0.03, 0.0), (0.02, 0.1)])
def test_compressed_tag_is_read_with_its_phase(share, offset, before):
    """Compression turns the tag's channel the opposite way: 0.3 deg at 1 %."""
    samples, symbol, largest = compressed_frames(share, offset, before)
    found = measure_compression(samples, WAVEFORM)
    drive = symbol + (offset if before else 0)
    factors, bins = WAVEFORM.equalizer()[WAVEFORM.bins], WAVEFORM.bins

    def channel_of(turn):
        """Channel of a weak tag behind the receiver, to first order in the tag."""
        tag = np.exp(1j * turn) * WAVEFORM.preamble[64:128]
        ratio = share / largest**2
        tag = tag * (1 - 2 * ratio * np.abs(drive) ** 2) - ratio * drive**2 * tag.conj()
        return np.fft.fft(tag)[bins] * factors

    turns = np.radians([0.0, 40.0, 100.0])
    ends = np.stack([channel_of(turn) for turn in turns])[:, None]
    groups = Groups(np.arange(3), ends=ends, gain=np.full((3, 1), 1e-9), noise=np.ones((3, 62)))
    corrected = found.correct(groups)

    def errors_deg(ends):
        return np.degrees(np.angle(np.sum(ends * ends[0].conj(), axis=2))[:, 0] - turns)[1:]

    before_deg, after_deg = np.abs(errors_deg(ends)), np.abs(errors_deg(corrected.ends))
    stated_deg = np.degrees(found.std)
    assert np.all(after_deg < 0.15 * before_deg.max() + 2 * stated_deg)
    assert (stated_deg > 0.01) == (offset > 0)
    np.testing.assert_allclose(
        corrected.gain[:, 0],
        1e-9 + 2 * found.std**2 * np.sum(np.abs(ends[:, 0]) ** 2, axis=1),
    )


@pytest.mark.parametrize(
    ("surveyed_snr_db", "in_lamps", "std_deg", "flagged"),
    [
        (10.0, False, 2.0, True),
        (10.0, False, 0.2, False),
        (3.0, False, 2.0, False),
        (-np.inf, False, 2.0, False),
        (None, False, 2.0, False),
        (None, True, 2.0, True),
        (None, True, 0.6, False),
    ],
)
def test_noise_on_the_lines_alone_is_flagged(surveyed_snr_db, in_lamps, std_deg, flagged):
    """A stronger tag on nearly the same clock takes the place of ours: no touch, and no flag."""
    groups = averaged_groups(
        np.ones((1, 2), complex),
        index=[20],
        phase_std_deg=np.full((1, 2), std_deg),
        snr_db=np.full((1, 2), -10.0),
        in_reference=np.ones((1, 2), bool),
    )
    model = load_sensor("line-900mhz")
    readout = SensorReadout(
        model,
        900e6,
        0j,
        0.036,
        SensorState(lambda: filter_of(model, 900e6, 0j)),
        surveyed_snr_db=surveyed_snr_db,
        in_lamps=in_lamps,
    )
    _, known = readout.take(groups, 0, np.array([[0.0, 0.0, 1e-9]]))
    (found,) = readout.read(readout.state.newest_of(groups.index[0]), known)
    assert bool(found["flags"] & Flag.INCONSISTENT.value) == flagged
