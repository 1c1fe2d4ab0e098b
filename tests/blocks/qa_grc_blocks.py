# SPDX-License-Identifier: GPL-3.0-or-later
"""Block descriptions as GNU Radio Companion reads them, and the blocks that they create."""

import ast
import inspect
import re
from pathlib import Path
from types import SimpleNamespace

import pmt
import pytest
import yaml
from gnuradio import gr, wiforce
from gnuradio.wiforce.blocks import names
from PyQt5.QtWidgets import QVBoxLayout

FOLDER = Path(__file__).resolve().parents[2] / "grc"
DESCRIPTIONS = {p.name.split(".")[0]: p for p in sorted(FOLDER.glob("*.block.yml"))}
CATEGORIES = ("Start here", "Simulation", "Inside the chain", "Displays", "Recording")
# Files without which a block cannot be created; any file is sufficient here.
NEEDED = {
    "wiforce_recording_source": {"path": __file__},
    "wiforce_capture_source": {"recording": __file__, "datatype": "ci16_le"},
    "wiforce_sigmf_recorder": {"path": __file__},
}


@pytest.fixture(scope="module")
def platform():
    from grc_compile import platform_for

    return platform_for()


@pytest.fixture(scope="module")
def needed(tmp_path_factory):
    """Parameters without which a block cannot be created, by its ID."""
    scene = wiforce.load_scene("tabletop").as_dict()
    scene["simulation"] |= {"duration_s": 1.0, "presses": []}
    name = tmp_path_factory.mktemp("capture") / "untouched"
    wiforce.simulate(scene, name)
    capture = {"recording": name.with_suffix(".sigmf-meta"), "scene": "tabletop"}
    return NEEDED | {"variable_wiforce_plan_for_capture": capture}


@pytest.fixture
def make_block(platform, qt, needed):
    """Create a GRC block with parameters; return it and the error messages of GRC."""

    def make(block_id, **parameters):
        graph = platform.make_flow_graph()
        block = graph.new_block(block_id)
        block.params["id"].set_value("block_under_test")
        for name, value in {**needed.get(block_id, {}), **parameters}.items():
            block.params[name].set_value(str(value))
        graph.rewrite()
        graph.validate()
        messages = [m for _, m in block.iter_error_messages()]
        return block, [m for m in messages if "not connected" not in m]

    return make


def made_by(block):
    """The block that the description's Python code creates, as in a generated flowgraph."""
    namespace = {"self": SimpleNamespace(top_layout=QVBoxLayout())}
    exec(block.templates.render("imports"), namespace)
    if block.is_variable:
        exec(block.templates.render("var_make"), namespace)
    else:
        exec(f"self.{block.name} = " + block.templates.render("make").strip(), namespace)
    return getattr(namespace["self"], block.name)


@pytest.mark.parametrize("block_id", DESCRIPTIONS)
def test_description_is_complete(block_id):
    description = yaml.safe_load(DESCRIPTIONS[block_id].read_text())
    assert description["id"] == block_id
    root, category = description["category"].split("/")
    assert root == "[WiForce]" and category in CATEGORIES
    assert len(description["documentation"]) > 80
    for ports, heading in (("inputs", "In"), ("outputs", "Out")):
        said = re.search(rf"^(In, )?{heading}(, Out)?:$", description["documentation"], re.M)
        assert bool(said) == bool(description.get(ports)), f"{heading}: of the documentation"
    assert all(p.get("label") for p in description.get("parameters", []))


@pytest.mark.parametrize("block_id", DESCRIPTIONS)
def test_block_with_defaults_is_valid_and_is_created(make_block, block_id):
    block, messages = make_block(block_id)
    assert messages == []
    if block_id == "wiforce_usrp":
        return  # needs a device: tests/blocks/samples/qa_usrp.py
    made = made_by(block)
    if not block.is_variable:
        assert_ports_agree(block, made)


@pytest.mark.parametrize("block_id", ["wiforce_reader", "wiforce_force_inversion"])
def test_block_with_a_file_keeps_the_former_one_until_it_runs(make_block, tmp_path, block_id):
    """A flowgraph whose device did not answer had emptied it."""
    output = tmp_path / "readings.csv"
    output.write_text("former")
    block, messages = make_block(block_id, output=repr(str(output)))
    assert messages == [] and made_by(block) and output.read_text() == "former"


def assert_ports_agree(block, made):
    """Compare the ports of the description with those of the created block."""
    from gnuradio.grc.core.Constants import TYPE_TO_SIZEOF

    for ports, signature in (
        (block.sinks, made.input_signature()),
        (block.sources, made.output_signature()),
    ):
        streams = [p for p in ports if p.domain == "stream"]
        sizes = [p.vlen * TYPE_TO_SIZEOF[p.dtype] for p in streams]
        assert sizes == [signature.sizeof_stream_item(n) for n in range(len(sizes))]
        assert signature.min_streams() <= len(sizes)
        assert signature.max_streams() in (-1, len(sizes))
    for ports, known in ((block.sinks, "in"), (block.sources, "out")):
        described = {p.key for p in ports if p.domain == "message" and not p.hidden}
        assert described == message_ports(made, known)


def message_ports(made, direction):
    if isinstance(made, gr.hier_block2):
        # A hierarchical block can only be asked for a port by name.
        asked = getattr(made, f"message_port_is_hier_{direction}")
        return {v for v in vars(names).values() if isinstance(v, str) and asked(pmt.intern(v))}
    ports = getattr(made, f"message_ports_{direction}")()
    return {str(pmt.vector_ref(ports, n)) for n in range(pmt.length(ports))} - {"system"}


def every_choice(make_block, block_id):
    """The block with its defaults, and with every other option of every enum parameter."""
    yield make_block(block_id)[0]
    for key, parameter in make_block(block_id)[0].params.items():
        for option in parameter.options:
            if parameter.is_enum() and option != parameter.default:
                yield make_block(block_id, **{key: option})[0]


def call_of(block):
    """(target, call) in the rendered code of a block."""
    code = block.templates.render("make").strip()
    call = ast.parse(f"made = {code}").body[0].value
    target = wiforce
    for part in ast.unparse(call.func).removeprefix("wiforce.").split("."):
        target = getattr(target, part)
    return target, call


def parameters_of(target):
    initializer = target.__init__ if inspect.isclass(target) else target
    try:
        return set(inspect.signature(initializer).parameters) - {"self"}
    except ValueError:  # compiled: the first line of its docstring
        return set(re.findall(r"(\w+):", initializer.__doc__.splitlines()[0])) - {"self"}


BLOCKS = [block_id for block_id in DESCRIPTIONS if block_id.startswith("wiforce_")]


@pytest.mark.parametrize("block_id", BLOCKS)
def test_block_parameters_can_all_be_set_in_grc_and_no_others(make_block, block_id):
    default, *others = (call_of(block) for block in every_choice(make_block, block_id))
    for target, call in (default, *others):
        assert not call.args, "an argument is given by position"
        assert {keyword.arg for keyword in call.keywords} <= parameters_of(target)
    target, call = default
    assert target is getattr(wiforce, block_id.removeprefix("wiforce_"))
    assert {keyword.arg for keyword in call.keywords} == parameters_of(target)


@pytest.mark.parametrize(
    ("block_id", "key"),
    [
        ("wiforce_reader", "scene"),
        ("wiforce_capture_source", "scene"),
        ("wiforce_sounding_source", "waveform"),
        ("wiforce_backscatter_tag", "waveform"),
        ("wiforce_frame_alignment", "waveform"),
        ("wiforce_antenna_ratio", "waveform"),
    ],
)
def test_block_takes_the_scene_of_a_scene_block_by_its_id(platform, qt, tmp_path, block_id, key):
    """A second copy of the file's name would be forgotten when the scene is exchanged."""
    path = tmp_path / "slow.yaml"
    path.write_text("sensors: [{name: leg, model: line-900mhz}]\n")
    graph = platform.make_flow_graph()
    variable, block = graph.new_block("variable_wiforce_scene"), graph.new_block(block_id)
    for made, values in (
        (variable, {"id": "of_the_leg", "file": path}),
        (block, {"id": "under_test", key: "of_the_leg", **NEEDED.get(block_id, {})}),
    ):
        for name, value in values.items():
            made.params[name].set_value(str(value))
    graph.rewrite()
    graph.validate()
    assert not [m for _, m in block.iter_error_messages() if "not connected" not in m]
    code = block.templates.render("make")
    (given,) = [
        word.value for word in ast.parse(code.strip()).body[0].value.keywords if word.arg == key
    ]
    # The program passes the variable, which is the scene itself there.
    assert ast.unparse(given) == "of_the_leg"
    assert "of_the_leg = wiforce.load_scene(" in variable.templates.render("var_make")
    assert graph.namespace["of_the_leg"].sensors[0].name == "leg"
    variable.params["id"].set_value("renamed")
    graph.rewrite()
    graph.validate()
    assert any(key in message for _, message in block.iter_error_messages())


# One of each block: its own tests have the others.
REFUSED = [
    ("wiforce_preamble_fold", {"mode": "tones", "group_length": 600}),
    ("wiforce_ofdm_channel_estimator", {"rotation": "[[1] * 63]"}),
    ("wiforce_phase_group_doppler", {"weights": "[[1, 2, 3]]", "group_length": 2}),
    ("wiforce_recording_source", {"segments": []}),
    ("wiforce_end_separation", {"plan": "wiforce.plan('demo', estimator='music')"}),
    ("wiforce_subcarrier_average", {"plan": "wiforce.plan('dome')"}),
    ("wiforce_force_inversion", {"output": "readings.txt"}),
    ("wiforce_antenna_ratio", {"frame_length": 319}),
    ("wiforce_reader", {"scene": "dome"}),
    ("wiforce_reader", {"output": "readings.txt"}),
    ("wiforce_capture_source", {"recording": "/nowhere/press.sigmf-meta", "datatype": "auto"}),
    ("variable_wiforce_plan_for_capture", {"recording": "/nowhere/press.sigmf-meta"}),
    ("wiforce_clock_offset", {"sensors": 0}),
    ("wiforce_doppler_display", {"snapshots": 1}),
    ("wiforce_phase_display", {"history_s": 0}),
    ("wiforce_trend_display", {"y_range": (1, 1)}),
    ("wiforce_readings_to_floats", {"repeat": 0}),
    ("wiforce_force_display", {"force_span_n": 0}),
    ("variable_wiforce_scene", {"file": "missing.yaml"}),
    ("wiforce_sounding_source", {"amplitude": 0.92}),
    ("wiforce_backscatter_tag", {"off_reflection": "0.8+0.8j"}),
]


@pytest.mark.parametrize(("block_id", "parameters"), REFUSED)
def test_block_invalid_parameter_is_refused_by_grc_too(make_block, block_id, parameters):
    block, messages = make_block(block_id, **parameters)
    assert messages
    with pytest.raises(ValueError):
        made_by(block)


def test_waveforms_to_choose_are_those_of_the_library(platform):
    from gnuradio.wiforce.signal.waveform import WAVEFORMS

    lists = {
        block: tuple(next(p["options"] for p in made.parameters_data if p["id"] == "waveform"))
        for block, made in platform.blocks.items()
        if any(p["id"] == "waveform" and p.get("options") for p in made.parameters_data)
    }
    assert len(lists) == 4
    assert set(lists.values()) == {WAVEFORMS}
