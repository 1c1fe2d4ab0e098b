# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of channel snapshots: what is refused in one line, and what is read."""

import os
import pickle

import numpy as np
import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots


def arrays_of(packets=100, subcarriers=8, antennas=2):
    rng = np.random.default_rng(1)
    shape = (packets, subcarriers, antennas)
    return {
        "time_s": 100.0 + np.arange(packets) * 1e-3,
        "channel": rng.standard_normal((*shape, 2)) @ np.array([1, 1j]),
        "subcarrier_hz": np.arange(subcarriers) * 312.5e3,
    }


def changed(name, index, value):
    arrays = arrays_of()
    arrays[name][index] = value
    return arrays


BAD = {
    "missing": ({"time_s": np.arange(100.0)}, "missing: channel, subcarrier_hz"),
    "falling": (changed("time_s", 50, 0.0), r"time_s\[50\]: must not lie before"),
    "nan time": (changed("time_s", 7, np.nan), r"time_s\[7\]: must be finite, got nan"),
    "late": (changed("time_s", 99, 1e300), r"time_s\[99\]: must lie at most 3600 s"),
    "standing": (arrays_of() | {"time_s": np.ones(100)}, "time_s: must not be the same"),
    "few packets": (arrays_of(63), "time_s: must hold 64 packets or more, got 63"),
    "few subcarriers": (arrays_of(subcarriers=3), "subcarrier_hz: must hold 4 to 4096"),
    "no antenna": (arrays_of(antennas=0), "channel: must have 1 to 16 antennas, got 0"),
    "times": (arrays_of() | {"time_s": np.arange(99.0)}, "as many packets as time_s"),
    "hertz": (arrays_of() | {"subcarrier_hz": np.arange(7.0)}, "as many subcarriers as"),
    "nan hertz": (changed("subcarrier_hz", 1, np.nan), r"subcarrier_hz\[1\]: must be a number"),
    "real": (arrays_of() | {"channel": np.ones((100, 8))}, "channel: must be complex"),
    "magnitudes": (
        arrays_of() | {"channel": np.abs(arrays_of()["channel"]).astype(complex)},
        "channel: must hold phases, but all imaginary parts are 0",
    ),
    "text": (arrays_of() | {"time_s": np.array(["a"] * 100)}, "time_s: must be one real"),
    "silent": (arrays_of() | {"channel": np.zeros((100, 8, 2), complex)}, "64 packets or more"),
    "scene": (arrays_of() | {"scene": "{"}, "scene: is not JSON"),
}


@pytest.mark.parametrize("name", BAD)
def test_file_with_a_mistake_is_refused_by_name_and_rule(name, tmp_path):
    arrays, rule = BAD[name]
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=rule) as caught:
        open_snapshots(tmp_path / "a.npz")
    assert "a.npz: " in str(caught.value) and "\n" not in str(caught.value)


def test_pickled_objects_are_refused_and_never_loaded(tmp_path):
    """A file from elsewhere must not run anything."""
    objects = np.array([{"a": 1}] * 100, object)
    np.savez(tmp_path / "a.npz", **(arrays_of() | {"time_s": objects}))
    with pytest.raises(InputError, match="pickles"):
        open_snapshots(tmp_path / "a.npz")
    (tmp_path / "b.npz").write_bytes(pickle.dumps([1, 2, 3]))
    with pytest.raises(InputError, match="pickles|broken"):
        open_snapshots(tmp_path / "b.npz")


def test_files_that_are_no_npz_are_refused(tmp_path):
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "text.npz").write_text("time_s,channel\n")
    np.savez(tmp_path / "cut.npz", **arrays_of())
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cut.npz").read_bytes()[:-300])
    (tmp_path / "folder.npz").mkdir()
    np.save(tmp_path / "array.npy", np.ones(3))
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    os.mkfifo(tmp_path / "pipe.npz")  # whose writer may never come
    for name in ("empty", "text", "cut", "folder", "array", "pipe", "nowhere"):
        with pytest.raises(InputError, match=f"{name}.npz: "):
            open_snapshots(tmp_path / f"{name}.npz")


def test_commands_say_what_a_file_of_snapshots_lacks_or_is(tmp_path):
    np.savez(tmp_path / "a.npz", **arrays_of())
    for command, rule in (
        ("read", "holds no scene; name one with --scene"),
        ("survey", "a.npz: holds channel snapshots, which only `read` and `check` take"),
    ):
        assert rule in refused(command, "a.npz", cwd=tmp_path)


def test_size_and_unit_of_the_channel_do_not_matter(tmp_path):
    arrays = arrays_of()
    for size in (1e-30, 1.0, 1e30):
        np.savez(tmp_path / "a.npz", **(arrays | {"channel": size * arrays["channel"]}))
        found = open_snapshots(tmp_path / "a.npz")
        assert found.channel.shape == (100, 8, 2) and not found.left_out
        assert 0.5 < np.median(np.abs(found.channel)) < 2


def test_guard_subcarriers_that_are_always_zero_are_left_out(tmp_path):
    arrays = arrays_of(antennas=1)
    arrays["channel"][:, 3] = 0
    np.savez(tmp_path / "a.npz", **(arrays | {"channel": arrays["channel"][:, :, 0]}))
    found = open_snapshots(tmp_path / "a.npz")
    assert found.channel.shape == (100, 7, 1)
    assert 3 * 312.5e3 not in found.subcarrier_hz
