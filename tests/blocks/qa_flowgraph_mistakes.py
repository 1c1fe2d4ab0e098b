# SPDX-License-Identifier: GPL-3.0-or-later
"""Mistakes in flowgraphs: each gives one sentence that names its cause, and none crashes."""

import copy
import gc
import importlib
import subprocess
import sys
import weakref
from types import SimpleNamespace

import numpy as np
import pmt
import pytest
from chain_runs import readings_of_chain
from device_times import tag_at
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks.stream_watch import Folded, StreamWatch
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.press.sensor_state import CLIPPED
from machine import wait_until
from press_capture import (
    DEFAULT,
    SLOW,
    array_source,
    as_floats,
    press_codes,
    run_flowgraph,
    running,
)

# Half the usual rate takes half the time; frames and groups last as long as usual.
RATE_HZ, FRAME, GROUP = 6.25e6, 360, 225_000
SCENE = DEFAULT | {
    "radio": {"sample_rate_hz": RATE_HZ},
    "sounding": {"frame_length": FRAME, "repetitions": 3},
}
# A slow radio with a long press, which is also in the reference where the capture is cut.
LONG = copy.deepcopy(DEFAULT | SLOW)
LONG["simulation"]["duration_s"] = 3.0
LONG["simulation"]["presses"][0] |= {"start_s": 0.35, "hold_s": 0.8}


@pytest.fixture(scope="module")
def codes(tmp_path_factory):
    """ADC codes of a short press, int16 pairs; shape (n, 2)."""
    return press_codes(tmp_path_factory.mktemp("capture"), SCENE)


@pytest.fixture(scope="module")
def slow_codes(tmp_path_factory):
    """The same of the slow radio."""
    return press_codes(tmp_path_factory.mktemp("slow"), LONG)


def said_of(samples, scene=SCENE, tags=(), **settings):
    """What a reader says of samples."""
    said = []
    settings = {"input_type": "sc16" if samples.ndim == 2 else "fc32", **settings}
    reader = wiforce.reader(scene, **settings)
    reader.groups.on_warning = said.append
    run_flowgraph(array_source(samples, tags), reader)
    assert reader.failure is None
    return said


def said_before(samples, scene=SCENE):
    """What a frame alignment says of samples; each start of a flowgraph begins its watch anew."""
    item_type = "sc16" if samples.ndim == 2 else "fc32"
    alignment = wiforce.frame_alignment(wiforce.load_scene(scene), item_type=item_type)
    said = []
    alignment._warn = said.append
    run_flowgraph(array_source(samples), alignment, blocks.null_sink(samples[:1].nbytes))
    return said


def resampled(samples, ratio):
    """Samples at another rate."""
    times = np.arange(0, len(samples) - 1, 1 / ratio)
    at = np.arange(len(samples))
    found = np.interp(times, at, samples.real) + 1j * np.interp(times, at, samples.imag)
    return found.astype(np.complex64)


def clipped(codes):
    return np.clip(8 * codes.astype(int), -32768, 32767).astype(np.int16)


def noise(codes):
    return (1000 * np.random.default_rng(1).standard_normal(codes.shape)).astype(np.int16)


def test_flowgraph_without_a_mistake_says_nothing(codes):
    assert said_of(codes) == said_of(as_floats(codes)) == said_before(codes) == []


# What is said of samples, or of settings that contradict them.
MISTAKES = {
    "integers have that are read as": lambda codes: codes.ravel().view("<c8"),
    "1; lower the level": lambda codes: 10 * as_floats(codes),
    "and the type of the samples": lambda codes: codes.byteswap(),
    "I and Q are swapped": lambda codes: codes[:, ::-1].copy(),
    "NaN or infinite": lambda codes: np.nan * as_floats(codes),
    "frame length and sample rate": lambda codes: resampled(as_floats(codes[: 10 * GROUP]), 0.8),
    "only noise or another signal": lambda codes: noise(codes[: 10 * GROUP]),
    "arm: it may have been touched while its reference was measured": (
        lambda codes: codes[10_000 * FRAME :]
    ),
    "the receiver is saturated": clipped,
    "within the untouched reference of 0.288 s": lambda codes: codes[: 3 * GROUP],
    "without a whole phase group of 36 ms behind frame_offset": lambda codes: codes[:1000],
}
SLOWER = [{**SCENE["sensors"][0], "clock_hz": 1250}]
WRONG_SETTINGS = {
    "a tag is found at 1000 Hz, 0.8 times the clock_hz of arm; check clock_hz": {
        "scene": {**SCENE, "sensors": SLOWER}
    },
    "not those of the scene (waveform 'repeated', 320 samples": {
        "scene": {**SCENE, "sounding": {"frame_length": 320, "repetitions": 3}}
    },
    "a carrier of 2400 MHz, and the scene of 900 MHz": {
        "tags": [tag_at(0, "rx_freq", pmt.from_double(2.4e9))]
    },
    "a sample rate of 6 MHz, and the scene of 6.25 MHz": {
        "tags": [tag_at(0, "rx_rate", pmt.from_double(6e6))]
    },
}


@pytest.mark.parametrize("cause", [*MISTAKES, *WRONG_SETTINGS])
def test_reader_names_the_cause_of_a_mistake_in_one_sentence(codes, cause):
    """An int16 file that was opened as floats gave no reading and no message."""
    samples = MISTAKES.get(cause, np.array)(codes)
    (sentence,) = said_of(samples, **WRONG_SETTINGS.get(cause, {}))
    assert sentence.startswith("reader: ") and cause in sentence


def test_reader_refuses_a_scene_of_packets_for_what_it_is():
    """The message blamed the number of antennas, which follows from the packets."""
    with pytest.raises(InputError, match="packets: says that another device measures the channel"):
        wiforce.reader("wifi_packets")


@pytest.fixture
def warned_in(monkeypatch):
    """What blocks of a module log as warnings, in a list that grows: ``warned_in("chain")``."""

    def begin(module):
        said = []
        module = importlib.import_module(f"gnuradio.wiforce.blocks.{module}")
        monkeypatch.setattr(module, "gr", SimpleNamespace(log=SimpleNamespace(warn=said.append)))
        return said

    return begin


def test_chain_names_a_press_in_a_part_of_the_reference(slow_codes, warned_in):
    """Streams and files said it, and the chain of blocks did not."""
    logged = warned_in("chain")
    plan = wiforce.plan(LONG)
    rate_hz = plan.waveform.sample_rate_hz
    fold = wiforce.preamble_fold(**plan.waveform.folding, item_type="sc16", sample_rate=rate_hz)
    readings_of_chain(plan, array_source(slow_codes[1944 * 360 :]), fold)
    (sentence,) = logged
    assert sentence.startswith("force_inversion: arm: was touched in ")


def test_short_guards_are_told_from_noise_and_from_another_frame_offset(slow_codes):
    """Noise passed a frame alignment, and a wrong offset was read without a word."""
    (sentence,) = said_of(slow_codes, LONG, frame_offset=250)
    assert sentence.startswith("reader: frames begin at sample ")
    assert "and every 360 from there, not at sample 250" in sentence
    (sentence,) = said_before(noise(slow_codes[: 4000 * 360]), LONG)
    assert "only noise or another signal" in sentence


SHORT = copy.deepcopy(LONG)
SHORT["simulation"]["duration_s"] = 1.4
SHORT["simulation"]["presses"][0] |= {"start_s": 0.5, "hold_s": 0.2}


# Of a press in a part of it, 0.15 s after the start, and of one that later groups solve.
@pytest.mark.parametrize("scene, first", [(SHORT, 2431 * 360), ("tabletop", round(1.2 * 1.25e6))])
def test_reader_names_a_press_in_the_reference(tmp_path, scene, first):
    """It looks like noise around the tag's lines: the message blamed the scene, or none came."""
    (sentence,) = said_of(press_codes(tmp_path, scene)[first:], scene)
    assert sentence.startswith("reader: arm: it may have been touched while its reference")


def watched(folded=None, problem=lambda sensor: "", touched=dict):
    """A watch of the scene whose sensors have a problem or were touched, and what it says."""
    said = []
    counts = SimpleNamespace(touched_reference=touched)
    stream = SimpleNamespace(
        counts=counts, survey=None, mean_frame=None, lasting_problem=problem, final_problem=problem
    )
    watch = StreamWatch(wiforce.plan(SCENE), stream, said.append)
    watch.folded = folded
    return watch, said


def test_watch_of_groups_that_wait_to_be_read_knows_that_samples_are_finite():
    """A flowgraph that was stopped early blamed the type of its samples."""
    watch, said = watched(lambda: Folded(5000, 3))
    watch.end()
    assert len(said) == 1 and "within the untouched reference of" in said[0]


@pytest.mark.parametrize(
    "clear, flag, sentence",
    [(21, "weak", "arm is not received since 2.00 s"), (0, "inconsistent", "arm: more than this")],
)
def test_watch_says_once_what_all_readings_say(clear, flag, sentence):
    """Readings of a tag that was switched off were weak, and the log was empty."""
    watch, said = watched()
    watch.read([Reading(0.1 * i, "arm", 0) for i in range(clear)])
    watch.read([Reading(0.1 * i, "arm", flags=(flag,)) for i in range(clear, 60)])
    assert len(said) == 1 and said[0].startswith(f"reader: {sentence}")


@pytest.mark.parametrize("doubtful, said_first", [(5, "was touched in 3"), (20, "it moved")])
def test_watch_says_one_sentence_of_a_reference_in_doubt_and_what_follows(doubtful, said_first):
    """A doubt of half a second hid that the reference was touched, which hid the cause behind."""
    doubts = []
    touched = {"arm": "arm: was touched in 3 groups"}
    watch, said = watched(None, lambda sensor: "".join(doubts), lambda: touched)
    flags = [("reference",)] * 3 + [("ambiguous",)] * doubtful + [("weak",)] * 12
    for i, each in enumerate(flags):
        doubts[:] = ["it moved"] if doubtful > 10 and i >= 13 else []
        watch.read([Reading(0.1 * i, "arm", 0, flags=each)])
    first, second = said if doubtful < 10 else (*said, "")
    assert f"arm: {said_first}" in first and ("no tag is found" in second) == (doubtful < 10)


def test_watch_says_again_what_recurs_after_clear_readings():
    """Of a receiver that clipped again, days later, nothing was said."""
    watch, said = watched(problem=lambda sensor: CLIPPED)
    flags = ([()] * 5 + [("saturated",)] * 30) * 2
    for i, each in enumerate(flags):
        watch.read([Reading(0.1 * i, "arm", 0, flags=each)])
    watch.read([Reading(8.0, "arm", 0)])
    watch.take([SimpleNamespace(index=100, present=np.zeros(1, bool))] * 100)
    watch.end()
    assert said == [f"reader: arm: {CLIPPED}"] * 2


def test_frame_alignment_and_capture_source_name_why_there_are_no_frames(
    codes, tmp_path, warned_in
):
    cause = "0.8 times that of the transmitter"
    # Twice as long as frames are searched in.
    samples = np.ascontiguousarray(resampled(as_floats(codes[: int(0.5 * RATE_HZ)]), 0.8))
    (sentence,) = said_before(
        samples, {**SCENE, "sounding": {"frame_length": FRAME, "repetitions": 2}}
    )
    assert sentence.startswith("frame_alignment: ") and cause in sentence
    samples.tofile(tmp_path / "press.bin")
    logged = warned_in("sample_files")
    wiforce.capture_source(tmp_path / "press.bin", SCENE, datatype="cf32_le")
    (sentence,) = logged
    assert sentence.startswith("capture_source: ")
    assert cause in sentence or "no sounding frames found" in sentence


def test_frame_alignment_says_that_a_stream_is_too_short_for_its_search(codes):
    """Good frames of 8 ms were called noise."""
    (sentence,) = said_before(codes[:50_000])
    assert sentence.endswith("has ended after 0.008 s; frames are searched in 0.115 s")


def test_frame_alignment_says_it_after_a_second_and_not_again():
    silent = np.zeros((int(2.5 * RATE_HZ), 2), np.int16)
    (sentence,) = said_before(silent)
    assert "all samples are 0" in sentence


def test_reader_tells_of_frames_without_groups_while_it_runs():
    """A stream without end has no last sentence."""
    said = []
    reader = wiforce.reader(SCENE)
    reader.groups.on_warning = said.append
    bad = blocks.vector_source_c([complex(np.nan)] * FRAME, True)
    flowgraph = gr.top_block()
    flowgraph.connect(bad, reader)
    with running(flowgraph):
        wait_until(lambda: said or reader.ended.is_set(), 20)
    assert len(said) == 1 and "every frame holds samples that are NaN" in said[0]


def test_flowgraph_keeps_its_blocks_and_frees_them():
    """Blocks without a variable ended in a segmentation fault."""
    flowgraph = gr.top_block()
    samples = blocks.null_source(8), blocks.head(8, 5 * GROUP)
    reader, floats = wiforce.reader(SCENE), wiforce.readings_to_floats()
    kept = [weakref.ref(block) for block in (reader, reader.groups, floats)]
    flowgraph.connect(*samples, reader)
    flowgraph.msg_connect(reader, "readings", floats, "readings")
    for port in range(4):
        flowgraph.connect((floats, port), blocks.null_sink(4))
    del reader, floats
    gc.collect()
    assert all(block() is not None for block in kept)
    flowgraph.start()
    assert kept[0]().ended.wait(60)
    flowgraph.stop()
    flowgraph.wait()
    del flowgraph
    gc.collect()
    assert all(block() is None for block in kept)


LEFT = """
import os
from functools import partial
from gnuradio import blocks, gr, wiforce

floats = wiforce.readings_to_floats()
# Without a reference to this program, which would be a cycle.
floats.closing = type("Closing", (), {"__del__": partial(os.write, 1, b"closed")})()
flowgraph = gr.top_block()
for port in range(4):
    flowgraph.connect((floats, port), blocks.null_sink(4))
"""


def test_program_that_leaves_its_flowgraph_ends_with_its_blocks_destroyed():
    """Threads of a USRP went on while the process ended, which could crash it."""
    done = subprocess.run([sys.executable, "-c", LEFT], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "closed", "")
