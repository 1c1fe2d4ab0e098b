# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of CSI tools, synthesised by their published formats and by what real cards wrote."""

import json

import numpy as np
import pytest
from command_runs import refused, succeeded
from csi_files import (
    ESP32_HEADER,
    PACKETS,
    atheros_file,
    crab_file,
    esp32_lines,
    intel_file,
    nexmon_file,
    values_of,
)
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.csi_tools import check_tool, open_csi, sent_subcarriers, tool_of
from long_cases import cases

pytest.importorskip("csiread")


def same_up_to_scale(found, expected):
    assert found.shape == expected.shape
    scale = np.vdot(expected, found) / np.vdot(expected, expected)
    assert np.allclose(found, scale * expected, atol=1e-4 * np.abs(found).max())


@pytest.mark.parametrize(
    ("tool", "file", "shape"),
    [("intel", intel_file, (30, 3, 100)), ("atheros", atheros_file, (56, 2, 400))],
)
def test_file_of_a_card_is_read_with_its_clock_unwrapped(tmp_path, tool, file, shape):
    values = values_of(*shape)
    (tmp_path / "a.dat").write_bytes(file(values))
    found = open_csi(tmp_path / "a.dat", tool)
    same_up_to_scale(found.channel, values)
    assert np.allclose(np.diff(found.time_s), 1e-3) and len(found.subcarrier_hz) == shape[0]
    assert found.subcarrier_hz[0] == -28 * 312.5e3 and found.subcarrier_hz[-1] == 28 * 312.5e3


def test_intel_clock_that_steps_back_is_a_gap_and_other_packets_are_left_out(tmp_path):
    """One real file steps back by seconds; packets that one antenna received lie among others."""
    values = values_of(30, 3, 100)
    others = intel_file(values_of(30, 1, 100)[:9], 9_000_000)
    parts = intel_file(values, 9_000_000), others, intel_file(values, 5_000_000)
    (tmp_path / "a.dat").write_bytes(b"".join(part[:-3] for part in parts) + b"\0\0\0")
    found = open_csi(tmp_path / "a.dat")
    same_up_to_scale(found.channel, np.concatenate([values, values]))
    assert found.clock_steps == 1 and np.all(np.diff(found.time_s) > 0)
    assert found.left_out == (
        ("packet with another number of antennas, streams or subcarriers", 9),
    )
    assert "stepped back once" in found.notes[0] and found.notes[1].startswith(
        "left out 9 x packet"
    )


@pytest.mark.parametrize("sequence", [True, False])
def test_nexmon_file_is_read_core_by_core(sequence, tmp_path):
    """Some versions of the firmware number all packets 0: all of them were one packet."""
    values = values_of(64, 2, 2000)
    lost = [(5, 0), (9, 1)]
    (tmp_path / "a.pcap").write_bytes(nexmon_file(values, sequence, lost=lost))
    found = open_csi(tmp_path / "a.pcap", "nexmon/43455c0/20")
    kept = np.delete(values, [5, 9], axis=0)
    same_up_to_scale(found.channel, kept[:, sent_subcarriers(64)])
    assert np.allclose(np.median(np.diff(found.time_s)), 1e-3)
    assert found.left_out == (("packet that not all cores report", 2),)


def test_nexmon_packets_of_one_sender_are_read(tmp_path):
    values = values_of(64, 2, 2000)
    values = np.concatenate([values, values[:, ::-1]])
    (tmp_path / "a.pcap").write_bytes(nexmon_file(values, senders=(1, 2)))
    found = open_csi(tmp_path / "a.pcap", mac="02:02:02:02:02:02")
    same_up_to_scale(found.channel, values[1::2][:, sent_subcarriers(64)])
    assert found.left_out == (("frame of another sender", 160),)


def test_esp32_header_odd_lines_and_other_senders_are_left_out(tmp_path):
    """The tool's own header row made csiread fail, and so did every line that was cut."""
    values = values_of(64, 1, 100)
    lines = [ESP32_HEADER, *esp32_lines(values), *esp32_lines(values[:7], "11:22:33:44:55:66")]
    lines[20] = lines[20][:150] + "\n"
    lines[30] = "I (3411) wifi: station joined\0\n"
    lines[40:40] = esp32_lines(values_of(32, 1, 100)[:3])
    (tmp_path / "a.csv").write_text("".join(lines))
    found = open_csi(tmp_path / "a.csv")
    same_up_to_scale(found.channel, np.delete(values, [19, 29], 0)[:, sent_subcarriers(64)])
    assert np.allclose(found.time_s, np.delete(2e-3 * np.arange(PACKETS), [19, 29]))
    assert dict(found.left_out) == {
        "line that is incomplete or of another kind": 1,
        "packet of another sender": 7,
        "packet with another number of subcarriers": 3,
    }
    with pytest.raises(InputError, match="a.csv.*64 packets or more, got 7"):
        open_csi(tmp_path / "a.csv", mac="11:22:33:44:55:66")
    with pytest.raises(InputError, match="--mac: must be that of a sender in .*a.csv"):
        open_csi(tmp_path / "a.csv", mac="11:22:33:44:55:67")


@pytest.mark.parametrize("header", cases("seq", long=("id",)))
def test_two_esp32_on_one_crystal_are_two_antennas(header, tmp_path):
    """esp-crab: each device prints lines of its own, and misses packets of its own."""
    values = values_of(64, 2, 100)
    (tmp_path / "a.csv").write_text(crab_file(values[:-4, :, 0], header=header))
    (tmp_path / "b.csv").write_text(crab_file(values[3:, :, 1], 3, header))
    done = succeeded("check", "a.csv", "--second-antenna", "b.csv", "--json", cwd=tmp_path)
    report = json.loads(done.stdout)
    assert report["antennas"]["count"] == 2 and report["file"]["packets"] == PACKETS - 7
    assert "left out 7 x packet that one device received" in report["notes"]
    found = open_csi(tmp_path / "a.csv", second=tmp_path / "b.csv")
    same_up_to_scale(found.channel, values[3:-4, sent_subcarriers(64)])


def test_tool_is_found_by_the_first_bytes(tmp_path):
    files = {
        "intel": intel_file(values_of(30, 3, 100)),
        "atheros": atheros_file(values_of(56, 2, 400)),
        "nexmon/43455c0/20": nexmon_file(values_of(64, 2, 2000)),
        "esp32": crab_file(values_of(64, 1, 100)[:, :, 0]).encode(),
        None: np.random.default_rng(1).integers(-99, 99, 9999).astype("<i2").tobytes(),
    }
    for tool, content in files.items():
        (tmp_path / "a").write_bytes(content)
        assert tool_of(tmp_path / "a") == tool
    assert tool_of(tmp_path) is None


def test_options_that_do_not_suit_a_tool_are_refused(tmp_path):
    (tmp_path / "a.dat").write_bytes(intel_file(values_of(30, 3, 100)))
    for tool in ("intel", None):
        with pytest.raises(InputError, match="--mac: must not be given for intel"):
            open_csi(tmp_path / "a.dat", tool, mac="11:22:33:44:55:66")
    with pytest.raises(InputError, match="--mac: must be like"):
        check_tool("esp32", mac="nobody")
    with pytest.raises(InputError, match="--second-antenna: must not be given"):
        check_tool("nexmon/4358/80", second="b.csv")
    said = refused("read", "a.dat", "--csi-tool", "intel", "--datatype", "ci16_le", cwd=tmp_path)
    assert "not for channel snapshots" in said


def test_broken_files_and_unknown_tools_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.dat").write_text("no CSI at all\n" * 50)
    noise = np.random.default_rng(1).bytes(20_000)
    (tmp_path / "noise.dat").write_bytes(noise)
    for name, tool in (("text", "intel"), ("noise", "nexmon/4358/80"), ("nowhere", "intel")):
        with pytest.raises(InputError, match=f"{name}.dat") as caught:
            open_csi(tmp_path / f"{name}.dat", tool)
        assert "\n" not in str(caught.value)
    for tool in ("", "picoscenes", "nexmon", "nexmon/4358/60"):
        with pytest.raises(InputError, match="--csi-tool: must be one of"):
            check_tool(tool)
    refused("read", "text.dat", "--csi-tool", "nexmon", cwd=tmp_path)
