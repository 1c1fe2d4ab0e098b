# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks refuse arguments of a wrong type in one line, as they refuse wrong values."""

import importlib
import inspect
import pkgutil
import socket

import numpy as np
import pytest
from gnuradio import gr, wiforce
from gnuradio.wiforce import blocks
from gnuradio.wiforce.blocks.captures import capture_source
from gnuradio.wiforce.errors import InputError

KINDS = gr.basic_block, gr.sync_block, gr.hier_block2
# Right arguments where a block has no default: types are checked before anything is opened.
RIGHT = {
    "plan": wiforce.plan("demo"),
    "scene": "demo",
    "recording": "press",
    "path": "press",
    "waveform": wiforce.sounding_waveform("repeated"),
    "sample_rate": 12.5e6,
    "frame_length": 720,
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
