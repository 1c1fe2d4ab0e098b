# SPDX-License-Identifier: GPL-3.0-or-later
"""Where frames begin, also without a guard or by a sample clock of the transmitter's own."""

from functools import lru_cache

import numpy as np
import pmt
import pytest
from device_times import rx_time, tag_at
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks.snapshots import free_fold
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import (
    MARGIN,
    FrameFollower,
    elsewhere,
    find_frame_offset,
    find_frame_period,
    keeps_alignment,
    repeats_every_frame,
    samples_needed,
)
from gnuradio.wiforce.signal.waveform import sounding_waveform
from plain import normal
from press_capture import array_source


def stream(waveform, offset, snr_db=-10.0):
    sent = np.roll(np.tile(waveform.frame(), 200), offset)
    noise = 10 ** (-snr_db / 20) * normal(np.random.default_rng(1), len(sent))
    return sent + 0.5 * np.roll(sent, 11) + noise


@pytest.mark.parametrize("name, length", [("repeated", 720), ("wifi", 720), ("repeated", 320)])
@pytest.mark.parametrize("offset", [0, 5, 123, 319])
def test_the_strongest_path_comes_a_margin_after_the_offset(name, length, offset):
    waveform = sounding_waveform(name, length)
    found = find_frame_offset(stream(waveform, offset), waveform)
    # Without a guard the repeated preamble has no other beginning than its symbols'.
    period = 64 if (name, length) == ("repeated", 320) else length
    assert (found + MARGIN) % period == offset % period


@pytest.mark.parametrize("length", [320, 360, 640, 720])
@pytest.mark.parametrize("name", ["repeated", "wifi"])
def test_noise_and_a_dc_offset_are_not_taken_for_a_preamble(name, length):
    """Frames with a short guard were found in anything."""
    rng = np.random.default_rng(2)
    waveform = sounding_waveform(name, length)
    noise = np.sqrt(2) * normal(rng, length * 500)
    assert find_frame_offset(noise, waveform) is None
    for value in (0.0, np.nan, np.inf):
        assert find_frame_offset(np.full(10 * length, value, complex), waveform) is None
    assert find_frame_offset(noise + 3, waveform) is None
    assert find_frame_offset(stream(waveform, 100) + 3, waveform) is not None


@pytest.mark.parametrize(
    "name, length, known",
    [
        ("repeated", 320, False),  # any place of symbols without a guard is their beginning
        ("repeated", 360, True),
        ("wifi", 320, True),
        ("repeated", 720, True),
    ],
)
def test_elsewhere_is_known_where_one_place_matches_best(name, length, known):
    waveform = sounding_waveform(name, length)
    frames = stream(waveform, 250, snr_db=20)
    assert elsewhere(frames, waveform) == (250 if known else None)
    assert elsewhere(np.roll(frames, -250), waveform) is None
    assert elsewhere(frames - stream(waveform, 250, snr_db=300), waveform) is None


@pytest.mark.parametrize("name, length", [("repeated", 720), ("repeated", 320), ("wifi", 720)])
def test_no_period_is_found_in_less_than_a_frame_and_a_half(name, length):
    """Of 450 to 480 samples, no lag beyond the preamble was left to compare."""
    waveform = sounding_waveform(name, length)
    sent = np.tile(waveform.frame(), 2)
    for count in range(0, 3 * length // 2, 10):
        assert find_frame_period(sent[:count], waveform).samples is None, count


@pytest.mark.parametrize("name, last", [("repeated", 56), ("wifi", 24)])
def test_a_delay_inside_the_cyclic_prefix_needs_no_new_alignment(name, last):
    waveform = sounding_waveform(name, 720)
    for late in (0, 20, last, last + 1, 100, 700):
        assert keeps_alignment((late - MARGIN) % 720, waveform) is (late <= last)


def received(name, length, count, snr_db, offset_hz=0.0):
    """Samples with a few static paths, a carrier offset and noise; SNR of the strongest path."""
    rng = np.random.default_rng(5)
    sent = np.tile(sounding_waveform(name, length).frame(), count // length + 2)
    paths = sent + 0.5j * np.roll(sent, 3) + 0.3 * np.roll(sent, 11) - 0.2 * np.roll(sent, 40)
    noise = 10 ** (-snr_db / 20) * normal(rng, count)
    turning = np.exp(2j * np.pi * offset_hz / 12.5e6 * np.arange(count))
    return paths[137 : 137 + count] * turning + noise


@pytest.mark.parametrize("name", ["repeated", "wifi"])
@pytest.mark.parametrize(
    "true, snr_db",
    [(320, 0), (320, 30), (321, 30), (384, 0), (660, 0), (720, 0), (720, 30), (20_000, 30)],
)
def test_find_frame_period_names_the_true_length_whatever_is_expected(name, true, snr_db):
    """A wrong frame length gives confident wrong readings; a true one must never be refused."""
    samples = received(name, true, samples_needed(true), snr_db, offset_hz=800)
    own = find_frame_period(samples, sounding_waveform(name, true))
    assert own.agrees and own.samples == true and own.likeness > 0.3
    lengths = {true // 2, 2 * true, 3 * true // 2, true + 1, true - 1, true + 64, 720} - {true}
    # Symbols without a guard repeat after every multiple of 64 samples.
    lengths -= {384} if (name, true) == ("repeated", 320) else set()
    for length in (length for length in lengths if 320 <= length < len(samples) // 4):
        found = find_frame_period(samples, sounding_waveform(name, length))
        assert (found.samples, found.agrees) == (true, False), length


def test_find_frame_period_of_another_rate_is_a_fraction():
    """Whole samples would suggest a frame length that is as wrong."""
    fine = np.fft.fft(received("repeated", 720, 72_000, 30))
    # 1 % more samples of the same band.
    wider = np.insert(fine, len(fine) // 2, np.zeros(720))
    found = find_frame_period(np.fft.ifft(wider), sounding_waveform())
    assert found.samples == pytest.approx(727.2, abs=0.01) and not found.agrees


def test_find_frame_period_without_preambles_finds_none():
    """Tones, DC and bursts of noise repeat as well; read as frames, they gave readings."""
    rng = np.random.default_rng(6)
    count = samples_needed(720)
    noise = 0.014 * normal(rng, count)
    tone = np.exp(0.1j * np.arange(count))
    bursts = 100 * noise * (np.arange(count) % 5000 < 1000)
    for signal in (0, 1, tone, bursts):
        for added in (0, noise):
            found = find_frame_period(signal + added + np.zeros(count), sounding_waveform())
            assert found.samples is None or found.likeness < 0.1


def test_find_frame_period_sees_frames_beside_a_stronger_tone_or_reader():
    """A second reader in the room must not make ours unreadable."""
    count = samples_needed(720)
    ours = received("repeated", 720, count, 30)
    tone = 3 * np.exp(0.233j * np.arange(count))
    other = 3 * received("repeated", 1440, count + 300, 30)[300:]
    assert repeats_every_frame(ours + tone, sounding_waveform())
    assert repeats_every_frame(ours + other, sounding_waveform())
    assert not repeats_every_frame(other, sounding_waveform())


RATE_HZ = 1.25e6


def symbol_file(folder, length, seed):
    """A random symbol of unit power."""
    symbol = np.random.default_rng(seed).standard_normal((length, 2)) @ np.array([1, 1j])
    path = folder / f"symbol{length}_{seed}.npy"
    np.save(path, (symbol / np.sqrt(np.mean(np.abs(symbol) ** 2))).astype(np.complex64))
    return path


def scene_of(symbol, length, clock_hz=1040.0):
    press = {"start_s": 0.4, "hold_s": 0.25, "force_n": 4.0, "end_force_n": 4.0}
    return {
        "radio": {"center_frequency_hz": 900e6, "sample_rate_hz": RATE_HZ},
        "sounding": {"waveform": str(symbol), "repetitions": 5, "frame_length": 5 * length},
        "phase_group": {"snapshots": round(0.036 * RATE_HZ / (5 * length))},
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": clock_hz}],
        "reference_s": 0.3,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": 0.8,
            "static_clutter_db": 50,
            "presses": [{"sensor": "arm", "location_mm": 37.0, **press}],
        },
    }


@pytest.mark.parametrize("length, seed", [(17, 1), (23, 1)])
def test_frames_without_a_guard_are_read(length, seed, tmp_path):
    """Half of the captures were refused, as if they held no frames."""
    scene = scene_of(symbol_file(tmp_path, length, seed), length)
    wiforce.simulate(scene, tmp_path / "press")
    readings = wiforce.read(tmp_path / "press", scene)
    held = readings[(readings["time_s"] > 0.52) & (readings["time_s"] < 0.64) & readings["ok"]]
    assert len(held) >= 2
    assert np.abs(held["force_n"] - 4).max() < 0.4


@pytest.mark.parametrize("length", [17, 23, 64])
def test_other_symbols_and_noise_of_the_same_period_are_no_frames(length, tmp_path):
    """Everything that repeats as often has the same period."""
    sent, expected = (
        sounding_waveform(str(symbol_file(tmp_path, length, seed)), 5 * length, repetitions=5)
        for seed in (1, 2)
    )
    noise = np.random.default_rng(1).standard_normal((65_000, 2)) @ np.array([1, 1j])
    received = np.tile(sent.frame(), 65_000 // (5 * length))
    received = received + 0.03 * noise[: len(received)]
    assert find_frame_period(received, sent).agrees
    assert not find_frame_period(received, expected).agrees
    assert not find_frame_period(noise, expected).agrees


def test_clock_whose_lines_alias_is_refused_by_simulate_as_by_plan(tmp_path):
    """It was simulated, and then refused with words about another tag."""
    scene = scene_of("repeated", 64, RATE_HZ / 320 / 10)
    for refuse in (wiforce.plan, lambda scene: wiforce.simulate(scene, tmp_path / "press")):
        with pytest.raises(InputError, match=r"sensors\[0\].clock_hz: must leave the tag") as said:
            refuse(scene)
        assert "another tag" not in str(said.value) and not list(tmp_path.iterdir())


LENGTH, FRAMES = 400, 1500
SYMBOL = np.exp(1j * np.pi * np.r_[0, np.arange(1, 32), 0, np.arange(-31, 0)] ** 2 / 64)
SYMBOL[[0, 32]] = 0


@lru_cache
def received_by_antennas(ppm):
    """Samples of two antennas, (n, 4): every frame has a common phase of its own."""
    rng = np.random.default_rng(1)
    frame = np.zeros(LENGTH, complex)
    frame[8:328] = np.tile(np.fft.ifft(SYMBOL), 5)
    spectrum, bins = np.fft.fft(frame), np.fft.fftfreq(LENGTH, 1 / LENGTH)
    period = LENGTH * (1 + 1e-6 * ppm)
    samples = np.zeros((FRAMES * LENGTH, 2), complex)
    for number in range(int(FRAMES * LENGTH / period)):
        first = int(np.ceil(number * period))
        shift = np.exp(2j * np.pi * bins * (first - number * period) / LENGTH)
        part = np.fft.ifft(spectrum * shift) * np.exp(2j * np.pi * rng.random())
        end = min(first + LENGTH, len(samples))
        samples[first:end] = part[: end - first, None] * [1.0, 0.5j]
    noise = rng.normal(0, 3e-4, (2, *samples.shape))
    samples += noise[0] + 1j * noise[1]
    parts = np.stack([samples.real, samples.imag], axis=-1).reshape(len(samples), 4)
    return np.rint(60_000 * parts).astype(np.int16)


def delays(frames):
    """Delay of every frame against the first antenna's symbol, in samples."""
    values = (
        frames.reshape(-1, LENGTH, 4)[:, 64:128, 0]
        + 1j * frames.reshape(-1, LENGTH, 4)[:, 64:128, 1]
    )
    channel = np.fft.fft(values)[:, 1:32] / SYMBOL[1:32]
    return -np.angle(np.sum(channel[:, 1:] * channel[:, :-1].conj(), axis=1)) * 64 / (2 * np.pi)


@pytest.mark.parametrize("ppm", [0, 8, -40])
def test_follower_keeps_frames_of_another_clock_in_place(ppm):
    follower, items = FrameFollower(LENGTH), received_by_antennas(ppm)
    frames = np.concatenate([follower.take(part) for part in np.array_split(items, 53)])
    late = delays(frames)
    assert len(late) > FRAMES - 70 and follower.moved == follower.lost == 0
    assert follower.period / LENGTH - 1 == pytest.approx(1e-6 * ppm, abs=2e-6)
    assert np.abs(late - late[0]).max() < 4  # while the period is learned
    assert np.abs(late[900:] - late[0]).max() < 1.6


def test_follower_finds_frames_after_an_unknown_loss():
    follower, items = FrameFollower(LENGTH), received_by_antennas(8)
    items = np.concatenate([items[: 500 * LENGTH + 99], items[500 * LENGTH + 99 + 577 :]])
    late = delays(follower.take(items))
    assert follower.moved >= 1
    assert np.abs(late[:499] - late[0]).max() < 3
    assert np.abs(late[-64:] - late[0]).max() < 1.5


@pytest.mark.parametrize(("within", "lost"), [(50, 4), (0, 3)])
def test_follower_gap_costs_only_the_frames_that_it_hits(within, lost):
    """Frames that are skipped besides give all later ones the times of their predecessors."""
    items, start = received_by_antennas(0), 700 * LENGTH + within
    end = start + 3 * LENGTH
    whole, follower = FrameFollower(LENGTH).take(items), FrameFollower(LENGTH)
    before = len(follower.take(items[:start])) + len(follower.lose(end - start, 4))
    after = follower.take(items[end:])
    assert (before, follower.lost) == (700 * LENGTH, lost)
    assert np.array_equal(after[: 64 * LENGTH], whole[(700 + lost) * LENGTH :][: 64 * LENGTH])


def folded_freely(items, tags):
    """The block and its two sinks, after a run over samples of two antennas."""
    fold = free_fold(sounding_waveform("repeated", LENGTH, 2.5e6), 900e6)
    sinks = [blocks.vector_sink_c(64), blocks.vector_sink_c(64)]
    sources = [array_source(items[:, :2].copy(), tags), array_source(items[:, 2:].copy())]
    flowgraph = gr.top_block()
    for port in range(2):
        flowgraph.connect(sources[port], (fold, port))
        flowgraph.connect((fold, port), sinks[port])
    flowgraph.run()
    return fold, sinks


def offsets(sink, key):
    return [tag.offset for tag in sink.tags() if str(tag.key) == key]


@pytest.mark.parametrize("key, other, own", [("rx_freq", 910e6, 900e6), ("rx_rate", 1e6, 2.5e6)])
def test_free_fold_discards_samples_of_another_rate_or_carrier(key, other, own):
    """With one antenna they were discarded, and read as good ones with two."""
    items, start, stop = received_by_antennas(8).copy(), 300 * LENGTH + 50, 500 * LENGTH + 50
    items[start:stop] = 0
    tags = [tag_at(at, key, pmt.from_double(hz)) for at, hz in ((start, other), (stop, own))]
    _, sinks = folded_freely(items, tags)
    vectors = np.reshape(sinks[0].data(), (-1, 64))
    assert len(vectors) > FRAMES - 80 - 202
    assert np.abs(vectors).max(axis=1).all()
    assert offsets(sinks[0], "snapshot") == [0, 300]
    assert offsets(sinks[0], "retuned") == [300]


def test_free_fold_gives_the_noise_that_preamble_fold_gives():
    items = received_by_antennas(0)
    _, sinks = folded_freely(items, [rx_time(0, 3.0)])
    source, sink = array_source(items[:, :2].copy()), blocks.vector_sink_c(64)
    flowgraph = gr.top_block()
    flowgraph.connect(source, wiforce.preamble_fold(LENGTH, item_type="sc16"), sink)
    flowgraph.run()
    freely, known = (
        np.concatenate(
            [pmt.f32vector_elements(t.value) for t in each.tags() if str(t.key) == "noise"]
        ).reshape(-1, 2)
        for each in (sinks[0], sink)
    )
    # Of the same frames, of which other parts are averaged.
    assert freely.mean(axis=0) == pytest.approx(known.mean(axis=0), rel=0.02)


def test_free_fold_frames_before_a_retuning_are_not_marked():
    items, start = received_by_antennas(8), 700 * LENGTH + 50
    retuned = tag_at(start, "retuned", pmt.from_uint64(1))
    _, sinks = folded_freely(items, [rx_time(0, 3.0), retuned])
    assert offsets(sinks[0], "retuned") == [700]


def test_free_fold_vectors_of_both_antennas_have_one_phase_and_indices_over_gaps():
    items, start, lost = received_by_antennas(8), 700 * LENGTH + 50, 3 * LENGTH
    items = np.concatenate([items[:start], items[start + lost :]])
    times = [rx_time(0, 3.0), rx_time(start, 3.0 + (start + lost) / 2.5e6)]
    fold, sinks = folded_freely(items, times)
    first, second = (np.fft.fft(np.reshape(sink.data(), (-1, 64)))[:, 1:32] for sink in sinks)
    assert len(first) > FRAMES - 80
    ratio = second / first
    assert np.abs(ratio - 0.5j).max() < 0.02
    found = {t.offset: pmt.to_uint64(t.value) for t in sinks[0].tags() if str(t.key) == "snapshot"}
    assert found == {0: 0, 700: 704}
    assert (fold.gaps(), fold.samples_lost(), fold.frames_moved()) == (1, lost, 0)
    noise = [t.value for t in sinks[1].tags() if str(t.key) == "noise"]
    assert sum(map(pmt.length, noise)) == 2 * len(second)
