# SPDX-License-Identifier: GPL-3.0-or-later
"""What pip installs: the library and the commands that need no flowgraph, beside GNU Radio or not.

The build tree stands in for an installation. The long form builds and installs the package.
"""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from command_runs import succeeded
from gnuradio import wiforce
from press_capture import SCENE

ROOT = Path(__file__).resolve().parents[2]
RUN = "import sys; from wiforce_app.main import run; sys.exit(run())"


def link_all(folder, target, without=()):
    """Links to the entries of a folder, but to those whose names begin with one of some words."""
    target.mkdir(parents=True, exist_ok=True)
    for entry in folder.iterdir():
        link = target / entry.name
        if not entry.name.startswith(tuple(without)) and not link.exists():
            link.symlink_to(entry)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder as pip fills it: without gnuradio/__init__.py and without the blocks."""
    site = tmp_path_factory.mktemp("site")
    package = Path(wiforce.__file__).parent
    compiled = ("wiforce_python", "__pycache__")
    link_all(package, site / "gnuradio" / "wiforce", compiled)
    for command in ("wiforce_app", "software_n210"):
        (site / command).symlink_to(ROOT / "gr-wiforce" / command)
    return site


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    """All packages of this interpreter but GNU Radio."""
    folder = tmp_path_factory.mktemp("libraries")
    for path in map(Path, sys.path):
        if path.name in ("site-packages", "dist-packages") and path.is_dir():
            link_all(path, folder, ("gnuradio", "pmt", "wiforce", "__pycache__"))
    return folder


def run_python(code, *folders, arguments=(), **options):
    """Run code with packages of the standard library and of some folders only."""
    path = {"PYTHONPATH": os.pathsep.join(map(str, folders))}
    return subprocess.run(
        [sys.executable, "-S", "-c", code, *map(str, arguments)],
        env=os.environ | path,
        capture_output=True,
        text=True,
        timeout=300,
        **options,
    )


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """The stem of a capture with its scene."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    wiforce.simulate(folder / "scene.yaml", folder / "press")
    return folder / "press"


def test_read_without_gnuradio_gives_the_readings_of_the_flowgraph(
    installed, libraries, capture, tmp_path
):
    """Analysts without GNU Radio would get other forces than the reader in the laboratory."""
    from gnuradio import gr

    scene = capture.with_name("scene.yaml")
    words = ("read", capture, "-o", tmp_path / "library.csv")
    done = run_python(RUN, installed, libraries, arguments=words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    flowgraph = gr.top_block()
    source = wiforce.capture_source(capture, scene)
    with wiforce.open_writer(tmp_path / "flowgraph.csv") as writer:
        reader = wiforce.reader(scene, input_type="folded", on_reading=writer.write)
        flowgraph.connect(source, reader)
        flowgraph.run()
    assert reader.failure is None
    found = (tmp_path / "library.csv").read_text()
    assert found == (tmp_path / "flowgraph.csv").read_text()
    rows = list(csv.DictReader(found.splitlines()))
    clear = [float(row["force_n"]) for row in rows if row["force_n"] and not row["flags"]]
    assert len(clear) >= 5 and 3.5 < sorted(clear)[len(clear) // 2] < 4.5


def test_features_of_gnuradio_without_it_are_refused_in_one_line(installed, libraries, capture):
    """A traceback that ends in `cannot import name gr` says nothing of what to install."""
    radio = "--scene demo --args addr=127.0.0.9"
    commands = [
        f"live {radio}",
        f"check {radio}",
        "read press --follow",
        "bench speed",
        "bench live",
    ]
    code = (
        "import sys; from wiforce_app.main import log, main; log.set_up()\n"
        "print(*[main(words.split()) for words in sys.argv[1:]])\n"
        "from gnuradio import wiforce; wiforce.Receiver('demo')\n"
        "import inspect; members = dict(inspect.getmembers(wiforce))\n"
        "assert 'read' in members and 'reader' not in members\n"
        "try: wiforce.reader\nexcept ImportError as error: print(error)"
    )
    done = run_python(code, installed, libraries, arguments=commands, cwd=capture.parent)
    rule = r"needs GNU Radio and gr-wiforce built with it, which pip does not install \(no .+\)"
    statuses, block = done.stdout.splitlines()
    assert statuses == "2 2 2 2 2", done.stderr
    assert re.fullmatch(f"reader {rule}", block)
    for line, name in zip(
        done.stderr.splitlines(), "live check read speed live".split(), strict=True
    ):
        assert re.fullmatch(f"gr-wiforce: {name}: {rule}", line)


@pytest.fixture
def beside(tmp_path):
    """GNU Radio as its package installs it, in the test's folder; the other folders."""
    import gnuradio.gr

    link_all(Path(gnuradio.gr.__file__).parent.parent, tmp_path / "gnuradio", ("wiforce",))
    return [path for path in sys.path if "-packages" in path]


def test_library_of_pip_is_found_beside_gnuradio(installed, tmp_path, beside):
    """A namespace package is hidden by a regular one, unless that one searches for it."""
    code = (
        "from gnuradio import gr, wiforce; import gnuradio, pathlib\n"
        "wiforce.load_scene, gr.top_block()\n"
        "print(gnuradio.__file__)\nprint(pathlib.Path(wiforce.__file__).parent)"
    )
    for folders in ([installed, tmp_path], [tmp_path, installed]):
        done = run_python(code, *folders, *beside)
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == [
            str(tmp_path / "gnuradio" / "__init__.py"),
            str(installed / "gnuradio" / "wiforce"),
        ]


def test_command_of_pip_uses_its_own_library(installed, tmp_path, beside):
    """Another release of the library may be in the folder of GNU Radio, which is searched first."""
    (tmp_path / "gnuradio" / "wiforce").mkdir()
    (tmp_path / "gnuradio" / "wiforce" / "__init__.py").write_text("release = 'other'\n")
    code = "import wiforce_app.main; from gnuradio import wiforce; print(wiforce.__file__)"
    done = run_python(code, tmp_path, installed, *beside)
    assert done.stdout.strip() == str(installed / "gnuradio" / "wiforce" / "__init__.py")


def test_wheel_holds_no_package_file_of_gnuradio():
    """It would hide GNU Radio, or be hidden by it."""
    assert not list(ROOT.glob("python/**/gnuradio/__init__.py"))
    rules = (ROOT / "cmake" / "InstallWheel.cmake").read_text()
    destinations = re.findall(r"DESTINATION (\S+?)[)\s]", rules)
    own = re.compile(r"\.|\$\{package\}(/share)?|\$\{SKBUILD_DATA_DIR\}/share/.+")
    assert destinations and all(own.fullmatch(name) for name in destinations)


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_package_built_and_installed_by_pip_reads_a_capture(capture, tmp_path):
    """In an environment of its own; downloads the dependencies."""
    python = tmp_path / "venv" / "bin" / "python3"
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    install = [python, "-m", "pip", "install", "--quiet", ROOT]
    subprocess.run(install, check=True, timeout=2900)
    succeeded("read", capture, "-o", tmp_path / "here.csv")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command = [tmp_path / "venv" / "bin" / "gr-wiforce", "read", capture]
    command += ["-o", tmp_path / "pip.csv"]
    subprocess.run(command, check=True, env=environment, timeout=300)
    assert (tmp_path / "pip.csv").read_text() == (tmp_path / "here.csv").read_text()
    code = "import gnuradio, json, sys; print(json.dumps([gnuradio.__file__, list(sys.path)]))"
    done = subprocess.run([python, "-c", code], env=environment, capture_output=True, text=True)
    file, path = json.loads(done.stdout)
    assert file is None and not any("dist-packages" in folder for folder in path)
