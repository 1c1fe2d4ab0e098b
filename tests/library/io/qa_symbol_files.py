# SPDX-License-Identifier: GPL-3.0-or-later
"""Files and keys of a sounding symbol that cannot be used: one line, status 2."""

import io
import json
import os
import pickle

import numpy as np
import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.signal.symbols import read_symbol
from long_cases import cases
from waveform_captures import chirp


def plan_refused(folder, *arguments, **sounding):
    """The line on stderr with which `plan` refuses a scene with this sounding."""
    scene = {
        "sounding": {"waveform": "own.npy", **sounding},
        "sensors": [{"name": "arm", "model": "line-900mhz"}],
    }
    (folder / "scene.yaml").write_text(json.dumps(scene))
    return refused("plan", folder / "scene.yaml", *arguments)


class Trap:
    """Unpickling it leaves a file behind."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def one_tone():
    return np.exp(2j * np.pi * np.arange(64) * 5 / 64)


@pytest.mark.parametrize(
    "values, rule",
    [
        (np.ones(64), "must hold complex samples, got 'float64'"),
        (np.ones(64, int), "must hold complex samples, got 'int64'"),
        (np.array(["a"] * 64), "must hold complex samples"),
        (chirp(15), "must hold one symbol of 16 to 4096 samples, got 'shape (15,)'"),
        (np.tile(chirp(64), 65), "must hold one symbol of 16 to 4096 samples"),
        (chirp(64).reshape(8, 8), "must hold one symbol of 16 to 4096 samples"),
        (np.array(1j), "must hold one symbol of 16 to 4096 samples"),
        (np.zeros(64, complex), "must not be zero at all samples"),
        (np.where(np.arange(64) == 7, np.nan, chirp(64)), "must hold finite samples, sample 7"),
        (np.where(np.arange(64) == 9, np.inf, chirp(64)), "must hold finite samples, sample 9"),
        (one_tone(), "must have energy on 4 or more subcarriers"),
        (np.ones(64, complex), "must have energy on 4 or more subcarriers"),
    ],
)
def test_symbol_that_cannot_be_used_is_refused_by_rule(values, rule, tmp_path):
    np.save(tmp_path / "own.npy", values)
    line = plan_refused(tmp_path)
    assert "scene.yaml: sounding.waveform: " in line and "own.npy: " in line and rule in line


def test_pickled_objects_are_never_loaded(tmp_path):
    """A file from elsewhere must not run code."""
    trap = np.array([Trap(tmp_path / "sprung")] * 16, object)
    np.save(tmp_path / "own.npy", trap, allow_pickle=True)
    assert "must be a .npy file of complex samples" in plan_refused(tmp_path)
    (tmp_path / "own.npy").write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    assert "must be a .npy file of complex samples" in plan_refused(tmp_path)
    assert not (tmp_path / "sprung").exists()


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
        b"symbol\n",
        b"\x93NUMPY",
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
        ({"repetitions": 0}, "repetitions: must be an integer from 1"),
        ({"symbol_length": 65}, "symbol_length: must be 64, as this symbol has, got 65"),
        ({"waveform": "own.npz"}, "sounding.waveform: must be 'repeated'"),
        ({"waveform": 7}, "sounding.waveform: must be 'repeated'"),
        ({"waveform": "wifi", "repetitions": 3}, "repetitions: does not apply to the waveform"),
        ({"waveform": "chirp", "symbol": "AAAA"}, "symbol: applies to a waveform from a .npy"),
        ({"waveform": "chirp", "symbol_length": 15}, "symbol_length: must be an integer from 16"),
        ({"waveform": "chirp", "symbol_length": 256}, "frame_length: must be an integer >= 1280"),
        ({"symbol": "not base64"}, "symbol: must be samples of complex64 in base64"),
        ({"symbol": "AAAA"}, "symbol: must be samples of complex64 in base64, got '3 bytes'"),
        ({"symbol": "A" * 43_704}, "symbol: must be printable text of 1 to 43692 characters"),
        ({"symbol": "AAAAAAAAAAA=" * 16}, "symbol: must be"),
    ],
)
def test_keys_that_contradict_each_other_are_named(sounding, rule, tmp_path):
    np.save(tmp_path / "own.npy", chirp(64))
    line = plan_refused(tmp_path, **sounding)
    assert "scene.yaml: sounding." in line and rule in line


@pytest.mark.parametrize("command", ["simulate", "read", "check"])
def test_every_command_refuses_a_symbol_alike(command, tmp_path):
    np.save(tmp_path / "own.npy", np.ones(64))
    plan_refused(tmp_path)
    scene = tmp_path / "scene.yaml"
    arguments = {
        "simulate": [scene, tmp_path / "run"],
        "read": [tmp_path / "run", "--scene", scene],
        "check": ["--scene", scene, "--args", "addr=127.0.0.1"],
    }[command]
    (tmp_path / "run.sigmf-meta").write_text("{}")
    refused(command, *arguments)


@pytest.mark.parametrize("length", cases(64, long=(4096,)))
def test_damaged_files_are_refused_or_read_never_crash(length, tmp_path, long_run):
    """Any byte of a file may be wrong: what is accepted is a finite symbol."""
    rng = np.random.default_rng(2)
    np.save(tmp_path / "own.npy", chirp(length))
    whole = np.fromfile(tmp_path / "own.npy", np.uint8)
    outcomes = set()
    for _ in range(5000 if long_run else 300):
        damaged = whole.copy()
        # Mostly in the header, which is where a parser may fail.
        end = 128 if rng.random() < 0.7 else len(whole)
        for at in rng.integers(0, end, rng.integers(1, 6)):
            damaged[at] = rng.integers(0, 256)
        if rng.random() < 0.2:
            damaged = damaged[: rng.integers(0, len(damaged))]
        damaged.tofile(tmp_path / "own.npy")
        try:
            symbol = read_symbol(tmp_path / "own.npy")
        except InputError as error:
            outcomes.add("refused")
            assert "\n" not in str(error)
        else:
            outcomes.add("read")
            assert 16 <= len(symbol) <= 4096 and np.isfinite(symbol).all()
    assert outcomes == {"refused", "read"}
