# SPDX-License-Identifier: GPL-3.0-or-later
"""Every block description as GNU Radio Companion sees it, and the block it makes."""

import inspect
import re
from pathlib import Path

import pytest
import yaml
from gnuradio import gr, wiforce

FOLDER = Path(__file__).resolve().parent.parent / "grc"
DESCRIPTIONS = {p.name.split(".")[0]: p for p in sorted(FOLDER.glob("*.block.yml"))}


@pytest.fixture(scope="module")
def platform():
    from gnuradio.grc.core.platform import Platform

    platform = Platform(
        version=gr.version(),
        version_parts=(gr.major_version(), gr.api_version(), gr.minor_version()),
        prefs=gr.prefs(),
    )
    # Of GNU Radio's own descriptions only those that any flowgraph needs: all take 15 s.
    needed = ("options.block.yml", "stream.domain.yml", "message.domain.yml")
    own = [
        str(Path(folder) / name)
        for folder in platform.config.block_paths
        for name in needed
        if (Path(folder) / name).is_file()
    ]
    platform.build_library([*own, str(FOLDER)])
    return platform


@pytest.fixture
def make_block(platform):
    """Makes a block of GRC with parameters; returns it and what GRC says against it."""

    def make(block_id, **parameters):
        graph = platform.make_flow_graph()
        block = graph.new_block(block_id)
        block.params["id"].set_value("block_under_test")
        for name, value in parameters.items():
            block.params[name].set_value(str(value))
        graph.rewrite()
        graph.validate()
        messages = [m for _, m in block.iter_error_messages()]
        return block, [m for m in messages if "not connected" not in m]

    return make


def made_by(block):
    """What the block's Python code makes."""
    namespace = {}
    exec(block.templates.render("imports"), namespace)
    return eval(block.templates.render("make").strip(), namespace)


@pytest.mark.parametrize("block_id", DESCRIPTIONS)
def test_description_is_complete(block_id):
    description = yaml.safe_load(DESCRIPTIONS[block_id].read_text())
    assert description["id"] == block_id
    assert description["category"] == "[WiForce]"
    assert len(description["documentation"]) > 80
    assert all(p.get("label") for p in description.get("parameters", []))


@pytest.mark.parametrize("block_id", DESCRIPTIONS)
def test_defaults_pass_the_checks_and_make_the_block(make_block, block_id):
    block, messages = make_block(block_id)
    assert messages == []
    assert_ports_agree(block, made_by(block))


def assert_ports_agree(block, made):
    """Ports of the description against those of the block that it makes."""
    from gnuradio.grc.core.Constants import TYPE_TO_SIZEOF

    for ports, signature, messages in (
        (block.sinks, made.input_signature(), made.message_ports_in()),
        (block.sources, made.output_signature(), made.message_ports_out()),
    ):
        streams = [p for p in ports if p.domain == "stream"]
        sizes = [p.vlen * TYPE_TO_SIZEOF[p.dtype] for p in streams]
        assert sizes == [signature.sizeof_stream_item(n) for n in range(len(sizes))]
        assert signature.min_streams() <= len(sizes)
        assert signature.max_streams() in (-1, len(sizes))
        known = {str(port) for port in to_list(messages)}
        assert {p.key for p in ports if p.domain == "message"} == known - {"system"}


def to_list(vector):
    import pmt

    return [pmt.vector_ref(vector, n) for n in range(pmt.length(vector))]


@pytest.mark.parametrize("block_id", DESCRIPTIONS)
def test_arguments_are_given_by_the_names_that_the_block_knows(block_id):
    make = yaml.safe_load(DESCRIPTIONS[block_id].read_text())["templates"]["make"]
    calls = re.findall(r"wiforce\.([\w.]+)\(((?:[^()]|\$\{(?:[^{}]|\([^()]*\))*\})*)\)", make)
    assert calls, "make calls nothing of gnuradio.wiforce"
    for name, arguments in calls:
        target = wiforce
        for part in name.split("."):
            target = getattr(target, part)
        initializer = target.__init__ if inspect.isclass(target) else target
        try:
            known = set(inspect.signature(initializer).parameters)
        except ValueError:  # compiled: the first line of its docstring
            known = set(re.findall(r"(\w+):", initializer.__doc__.splitlines()[0]))
        for argument in re.split(r",(?![^{]*\})", arguments):
            given = re.match(r"\s*(\w+)=", argument)
            assert given, f"{argument.strip()!r} is given by position"
            assert given[1] in known


REFUSED = [
    ("wiforce_preamble_fold", {"frame_length": 319}),
    ("wiforce_preamble_fold", {"first_averaged": -1}),
    ("wiforce_preamble_fold", {"repetitions": 0}),
    ("wiforce_preamble_fold", {"repetitions": 65537, "frame_length": 10**7}),
    ("wiforce_preamble_fold", {"sample_rate": 0}),
    ("wiforce_ofdm_channel_estimator", {"rows": 0}),
    ("wiforce_ofdm_channel_estimator", {"factors": "[1] * 63"}),
    ("wiforce_ofdm_channel_estimator", {"rotation": "[[1] * 63]"}),
    ("wiforce_phase_group_doppler", {"group_length": 0}),
    ("wiforce_phase_group_doppler", {"weights": "[[1, 2, 3]]", "group_length": 2}),
    ("wiforce_phase_group_doppler", {"mode": "spectrum", "group_length": 0}),
]


@pytest.mark.parametrize(("block_id", "parameters"), REFUSED)
def test_what_the_block_refuses_grc_shows_before_the_run(make_block, block_id, parameters):
    block, messages = make_block(block_id, **parameters)
    assert messages
    with pytest.raises(ValueError):
        made_by(block)
