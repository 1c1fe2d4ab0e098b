# SPDX-License-Identifier: GPL-3.0-or-later
"""The library as people type it in a notebook: short calls, and objects that print well."""

import inspect
import os
import shutil

import matplotlib
import numpy as np
import pandas
import pytest
from command_runs import run_command
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two captures, one in a subfolder."""
    path = tmp_path_factory.mktemp("captures")
    (path / "day1").mkdir()
    for written in wiforce.simulate("tabletop", path / "first"):
        shutil.copy(written, path / "day1" / written.name.replace("first", "second"))
    return path


@pytest.fixture(scope="module")
def readings(folder):
    return wiforce.read(folder / "first")


def test_read_folder_and_list_name_each_capture(folder, readings):
    """Who joins frames by hand forgets which capture a row is of."""
    both = wiforce.read(folder)
    assert both.columns[0] == "capture" and both["capture"].unique().tolist() == [
        "day1/second",
        "first",
    ]
    pandas.testing.assert_frame_equal(
        both[both["capture"] == "first"].drop(columns="capture").reset_index(drop=True), readings
    )
    assert (both.index == np.arange(2 * len(readings))).all()
    listed = wiforce.read([folder / "first", str(folder / "day1/*")])
    assert listed["capture"].unique().tolist() == ["first", "second"]


def test_read_of_nothing_and_of_an_empty_folder_says_so(tmp_path):
    with pytest.raises(InputError, match="^capture: must name one capture or more"):
        wiforce.read([])
    with pytest.raises(InputError, match="contains no captures"):
        wiforce.read(tmp_path)
    with pytest.raises(InputError, match="^capture: must be the path of a capture, got 3"):
        wiforce.read([3])


def test_plot_shows_frames_and_truth(folder, readings):
    axes = wiforce.plot(readings, truth=pandas.read_csv(folder / "first.truth.csv"))
    assert "truth" in axes[0].get_legend_handles_labels()[1]
    (bars,) = axes[0].containers
    shown = readings[readings["ok"] & readings["touch"].notna()]
    assert bars.lines[0].get_ydata().tolist() == shown["force_n"].fillna(0).tolist()


@pytest.mark.parametrize(
    ("call", "rule"),
    [
        (lambda frame: wiforce.plot(frame.drop(columns="force_n")), "must have the column force_n"),
        # Doubtful readings would be drawn as clear ones.
        (lambda frame: wiforce.plot(frame.drop(columns="flags")), "must have the column flags"),
        (lambda frame: wiforce.plot(frame["force_n"]), "readings: must be a pandas frame"),
        (lambda frame: wiforce.plot(frame, truth="first.truth.csv"), "truth: must be a pandas"),
        (lambda frame: wiforce.score(frame, frame), "gauge: several columns sound like a force"),
        (lambda frame: wiforce.score([1], "gauge.csv"), "readings: must be a pandas frame"),
    ],
)
def test_wrong_arguments_are_named(readings, call, rule):
    with pytest.raises(InputError, match=rule):
        call(readings)


def test_score_of_a_frame_prints_what_the_command_does(folder, readings):
    truth = folder / "first.truth.csv"
    found = wiforce.score(readings, truth)
    assert np.median(np.abs(found.error_n)) < 0.15
    path = folder / "first.csv"
    readings.drop(columns="ok").to_csv(path, index=False)
    done = run_command("score", path, "--against", truth)
    assert done.stdout.rstrip("\n") == str(found) == str(wiforce.score(path, truth))
    # As pandas reads them: flags that are empty are NaN there.
    frames = pandas.read_csv(path), pandas.read_csv(truth)
    assert str(wiforce.score(*frames)) == str(found)
    both = wiforce.read(folder)
    with pytest.raises(InputError, match="time_s must increase: score one run at a time"):
        wiforce.score(both, truth)


def test_survey_of_a_cut_capture_says_what_the_command_does(folder, tmp_path):
    for file in folder.glob("first.sigmf-*"):
        shutil.copy(file, tmp_path)
    data, capture = tmp_path / "first.sigmf-data", tmp_path / "first"
    os.truncate(data, data.stat().st_size - 4000)
    with pytest.warns(UserWarning, match="ends 1000 samples before") as warned:
        found = wiforce.survey(capture)
    assert found.tags[0].clock_offset_ppm is not None and found.report()["seconds"] > 0.1
    done = run_command("survey", capture)
    assert done.stdout.rstrip("\n") == str(found).rstrip("\n")
    assert str(warned[0].message) in done.stderr


def test_dir_shows_public_names_alone():
    """Completion in a notebook offered modules and helpers of the blocks' descriptions."""
    names = dir(wiforce)
    assert {"read", "plot", "score", "survey", "plan", "reader", "load_scene"} <= set(names)
    assert not [name for name in names if name.startswith(("_", "is_")) or name == "importlib"]
    assert not [name for name in names if inspect.ismodule(getattr(wiforce, name))]
