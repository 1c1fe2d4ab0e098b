# SPDX-License-Identifier: GPL-3.0-or-later
"""Files and keys of a sounding symbol that cannot be used: one line, status 2."""

import io
import json
import pickle

import numpy as np
import pytest
from command_runs import refused
from waveform_captures import chirp


def plan_refused(folder, *arguments, **sounding):
    """The line on stderr with which `plan` refuses a scene with this sounding."""
    scene = {
        "sounding": {"waveform": "own.npy", **sounding},
        "sensors": [{"name": "arm", "model": "line-900mhz"}],
    }
    (folder / "scene.yaml").write_text(json.dumps(scene))
    return refused("plan", folder / "scene.yaml", *arguments)


def one_tone():
    return np.exp(2j * np.pi * np.arange(64) * 5 / 64)


@pytest.mark.parametrize(
    "values, rule",
    [
        (np.ones(64), "must hold complex samples, got 'float64'"),
        (chirp(15), "must hold one symbol of 16 to 4096 samples, got 'shape (15,)'"),
        (chirp(64).reshape(8, 8), "must hold one symbol of 16 to 4096 samples"),
        (np.zeros(64, complex), "must not be zero at all samples"),
        (np.where(np.arange(64) == 7, np.nan, chirp(64)), "must hold finite samples, sample 7"),
        (one_tone(), "must have energy on 4 or more subcarriers"),
    ],
)
def test_symbol_that_cannot_be_used_is_refused_by_rule(values, rule, tmp_path):
    np.save(tmp_path / "own.npy", values)
    line = plan_refused(tmp_path)
    assert "scene.yaml: sounding.waveform: " in line and "own.npy: " in line and rule in line


def test_pickled_objects_are_never_loaded(tmp_path):
    """A file from elsewhere must not run code."""
    np.save(tmp_path / "own.npy", np.array([print] * 16, object), allow_pickle=True)
    assert "must be a .npy file of complex samples" in plan_refused(tmp_path)


def header(text):
    content = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(content).to_bytes(2, "little") + content


def archive():
    content = io.BytesIO()
    np.savez(content, symbol=chirp(64))
    return content.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        archive(),
        pickle.dumps(print),
        b"\x93NUMPY\x09\x00" + bytes(100),
        header("{'descr': '<c16', 'fortran_order': False, 'shape': (64,), }"),
        header("{'descr': '<c16', 'fortran_order': False, 'shape': (1000000000000,), }"),
        header("{'descr': '<c16', 'fortran_order': False, 'shape': (-64,), }") + bytes(1024),
        header("__import__('os').mkdir('sprung')") + bytes(1024),
        header("[" * 60 + "]" * 60) + bytes(1024),
    ],
)
def test_file_that_is_no_npy_file_is_refused(content, tmp_path):
    (tmp_path / "own.npy").write_bytes(content)
    assert "own.npy: must" in plan_refused(tmp_path)


def test_missing_file_and_folder_are_named(tmp_path):
    assert "own.npy: does not exist" in plan_refused(tmp_path)
    (tmp_path / "own.npy").mkdir()
    assert "own.npy: is no file" in plan_refused(tmp_path)


@pytest.mark.parametrize(
    "sounding, rule",
    [
        ({"averaged_repetitions": 6, "repetitions": 5}, "from 1 to repetitions (5), got 6"),
        ({"averaged_repetitions": 5, "repetitions": 5}, "must be below 5"),
        ({"repetitions": 12}, "frame_length: must be an integer >= 768, the samples of the pre"),
        ({"symbol_length": 65}, "symbol_length: must be 64, as this symbol has, got 65"),
        ({"waveform": 7}, "sounding.waveform: must be 'repeated'"),
        ({"waveform": "wifi", "repetitions": 3}, "repetitions: does not apply to the waveform"),
        ({"waveform": "chirp", "symbol": "AAAA"}, "symbol: applies to a waveform from a .npy"),
        ({"waveform": "chirp", "symbol_length": 256}, "frame_length: must be an integer >= 1280"),
        ({"symbol": "not base64"}, "symbol: must be samples of complex64 in base64"),
        ({"symbol": "A" * 43_704}, "symbol: must be printable text of 1 to 43692 characters"),
    ],
)
def test_keys_that_contradict_each_other_are_named(sounding, rule, tmp_path):
    np.save(tmp_path / "own.npy", chirp(64))
    line = plan_refused(tmp_path, **sounding)
    assert "scene.yaml: sounding." in line and rule in line
