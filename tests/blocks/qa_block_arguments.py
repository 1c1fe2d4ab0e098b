# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks refuse arguments of a wrong type in one line, as they refuse wrong values."""

import importlib
import inspect
import pkgutil
import socket
from functools import partial

import numpy as np
import pytest
from gnuradio import gr, wiforce
from gnuradio.wiforce import blocks
from gnuradio.wiforce.blocks.frame_alignment import FrameSearch
from gnuradio.wiforce.blocks.sample_files import capture_source
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.wiforce_kernels import tone_reader

KINDS = gr.basic_block, gr.sync_block, gr.hier_block2
# Right arguments where a block has no default: types are checked before anything is opened.
RIGHT = {
    "plan": wiforce.plan("demo"),
    "scene": "demo",
    "recording": "press",
    "path": "press",
    "waveform": wiforce.sounding_waveform("repeated"),
    "sample_rate": 12.5e6,
    "carrier": 900e6,
    "frame_length": 720,
    "search": FrameSearch(wiforce.sounding_waveform("repeated")),
    "stream": socket.socket(),
    "count": 1000,
}


def parameters():
    """Every parameter of every block in Python, those without a description in grc/ included."""
    for module in pkgutil.iter_modules(blocks.__path__):
        loaded = importlib.import_module(f"{blocks.__name__}.{module.name}")
        for block in vars(loaded).values():
            # Those whose constructor checks its arguments; the others are what blocks share.
            is_class = isinstance(block, type) and issubclass(block, KINDS)
            if getattr(block, "__module__", "") != loaded.__name__ or not (
                block is capture_source or (is_class and hasattr(block.__init__, "__wrapped__"))
            ):
                continue
            own = inspect.signature(block).parameters
            required = {n: RIGHT[n] for n, p in own.items() if p.default is inspect.Parameter.empty}
            kind = block.__name__
            yield from (pytest.param(block, name, required, id=f"{kind}-{name}") for name in own)


@pytest.mark.parametrize("block, name, required", parameters())
def test_block_argument_of_a_wrong_type_is_refused_in_one_line(block, name, required):
    """A TypeError from inside of NumPy or GNU Radio names neither the parameter nor the value."""
    wrong = type("Wrong", (), {"__repr__": lambda self: "<wrong>"})()
    with pytest.raises(InputError, match=r"must be .*, got <wrong>$") as raised:
        block(**required | {name: wrong})
    assert raised.value.where == name and "\n" not in str(raised.value)


# Blocks in C++, with values in range.
OF_GROUPS = {"weights": np.ones((2, 10)), "group_length": 10}
OF_FILE = {"path": "x", "datatype": "cf32_le", "segments": [(0, 0, 1000)], "frame_length": 720}
FOLD = partial(wiforce.preamble_fold, frame_length=720)
TONES = partial(wiforce.preamble_fold.tones, frame_length=720, **OF_GROUPS)
DOPPLER = partial(wiforce.phase_group_doppler, **OF_GROUPS)
COLLECTED = partial(wiforce.phase_group_doppler.collected, group_length=10)
ESTIMATOR = partial(wiforce.ofdm_channel_estimator, factors=np.ones(64))
RECORDING = partial(wiforce.recording_source, **OF_FILE)
SYMBOLS = {"first_averaged": 64, "repetitions": 4, "frame_offset": 0, "symbol_length": 64}
TO_CHANNEL = {"weights": np.ones((1, 6)), "factors": np.ones(64), "rotation": [], "bins": [0]}
READER = partial(tone_reader, **OF_FILE, **SYMBOLS, **TO_CHANNEL)
OUT_OF_RANGE = [
    (FOLD, {"frame_length": 319}, "frame_length must be >= .*320, got 319"),
    (FOLD, {"first_averaged": -1}, "first_averaged must be >= 0, got -1"),
    (FOLD, {"repetitions": 0}, "repetitions must be 1 to 65536, got 0"),
    (FOLD, {"sample_rate": 0.0}, "sample_rate must be positive, got 0"),
    (FOLD, {"sample_rate": np.nan}, "sample_rate must be positive"),
    (FOLD, {"item_type": "sc8"}, "item_type must be 'fc32' or 'sc16', got"),
    (FOLD, {"symbol_length": 15}, "symbol_length must be 16 to 4096"),
    (FOLD, {"symbol_length": 165}, r"first_averaged \+ 165 repetitions = 724"),
    (TONES, {"frame_length": 319}, "frame_length must be >= .*320, got 319"),
    (DOPPLER, {"group_length": 0}, "group_length must"),
    (DOPPLER, {"group_length": 5}, "weights must have group_length = 5 columns, got 10"),
    (DOPPLER, {"weights": np.ones(11)}, "one or more rows of group_length = 10, got 11"),
    (DOPPLER, {"weights": np.ones(0)}, "weights must hold one or more rows"),
    (DOPPLER, {"weights": np.full((1, 10), np.inf)}, "weights must be finite"),
    (COLLECTED, {"symbol_length": 4097}, "symbol_length must be 16 to 4096"),
    (ESTIMATOR, {"factors": np.ones(15)}, "factors must hold .*, got 15 values"),
    (ESTIMATOR, {"factors": np.ones(4097)}, "factors must hold .*, got 4097 values"),
    (ESTIMATOR, {"factors": np.full(64, np.nan)}, "factors must be finite"),
    (ESTIMATOR, {"rows": 0}, "rows must be >= 1, got 0"),
    (ESTIMATOR, {"rows": 2, "rotation": np.ones(64)}, "rotation must hold 128 values, got 64"),
    (ESTIMATOR, {"rotation": np.full(64, np.inf)}, "rotation must be finite"),
    (RECORDING, {"path": "/nowhere/x"}, "/nowhere/x cannot be opened"),
    (RECORDING, {"path": "/"}, "/ must be a regular file"),
    (RECORDING, {"path": "empty"}, "empty holds no sample"),
    (RECORDING, {"datatype": "cf64_le"}, "must be 'ci16_le' or 'cf32_le', got 'cf64_le'"),
    (RECORDING, {"segments": [(0, 0, 20), (10, 30, 5)]}, "segments must follow each other"),
    (READER, {"weights": np.ones(6)}, "weights must have 2 dimensions"),
    (READER, {"factors": np.ones(63)}, "factors must be as many as a symbol has samples, 64"),
    (READER, {"bins": [1, 64]}, "bins must be 0 to 63, got 64"),
    (wiforce.sounding_source, {"symbol_length": -1}, "symbol_length"),
]


@pytest.mark.parametrize("make, wrong, rule", OUT_OF_RANGE)
def test_block_value_out_of_range_is_named(tmp_path, monkeypatch, make, wrong, rule):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").write_bytes(bytes(8000))
    (tmp_path / "empty").write_bytes(b"")
    with pytest.raises(InputError, match=rule):
        make(**wrong)


def test_block_arguments_of_other_numeric_types_are_taken():
    """Companion's variables are often floats, and NumPy's numbers come from computations."""
    source = wiforce.sounding_source(frame_length=720.0, amplitude=np.float32(0.25))
    source.set_amplitude(np.float64(0.5))
    floats = wiforce.readings_to_floats(repeat=np.int64(4), flagged=1, unknown=0)
    assert floats.output_multiple() == 4


def test_block_setter_of_a_running_flowgraph_refuses_text():
    tag = wiforce.backscatter_tag("line-900mhz")
    with pytest.raises(InputError, match="^force_n: must be a number, got '3'$"):
        tag.set_force_n("3")
    assert tag.force_n() == 0.0
