# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of CSI tools, synthesised by their published formats: none is of a real card."""

import struct

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.csi_tools import check_tool, open_csi

pytest.importorskip("csiread")
PACKETS = 80


def values_of(subcarriers, antennas, size):
    rng = np.random.default_rng(1)
    parts = rng.integers(-size, size, (PACKETS, subcarriers, antennas, 2))
    return parts @ np.array([1, 1j])


def same_up_to_scale(found, expected):
    assert found.shape == expected.shape
    scale = np.vdot(expected, found) / np.vdot(expected, expected)
    assert np.allclose(found, scale * expected, atol=1e-4 * np.abs(found).max())


def intel_file(values, start_us=(1 << 32) - 30_000):
    """Linux 802.11n CSI Tool: 8-bit values, 3 bits before each subcarrier, a 1 MHz clock."""
    _, _, antennas = values.shape
    records = []
    for number, packet in enumerate(values):
        bits = []
        for row in packet:
            bits += [0, 0, 0]
            for value in row:
                for part in (int(value.real), int(value.imag)):
                    bits += [(part >> bit) & 1 for bit in range(8)]
        bits += [0] * (-len(bits) % 8)
        payload = np.packbits(bits, bitorder="little").tobytes()
        length = 60 * antennas + 12
        payload = payload.ljust(length, b"\0")
        clock = (start_us + 1000 * number) % (1 << 32)
        head = struct.pack("<IHHBBBBBbBBHH", clock, number, 0, antennas, 1, 40, 40, 40, -90, 30,
                           0b100100, length, 0x1103)  # fmt: skip
        records.append(struct.pack(">HB", len(head) + length + 1, 0xBB) + head + payload)
    return b"".join(records) + b"\0\0\0"


def atheros_file(values):
    """Atheros CSI Tool: 10-bit values, imaginary part first."""
    _, tones, antennas = values.shape
    records = []
    for number, packet in enumerate(values):
        bits = []
        for value in packet.ravel():
            for part in (int(value.imag), int(value.real)):
                bits += [(part >> bit) & 1 for bit in range(10)]
        csi = np.packbits(bits, bitorder="little").tobytes()
        csi += b"\0" * (len(csi) % 2)
        head = struct.pack("<QHHBBBBBBBBBBBH", 5_000_000 + 1000 * number, len(csi), 2437, 0, 0, 0,
                           0, tones, antennas, 1, 40, 40, 40, 40, 0)  # fmt: skip
        records.append(struct.pack("<H", len(head) + len(csi)) + head + csi)
    return b"".join(records) + b"\0\0\0\0"


def nexmon_file(values):
    """nexmon_csi of a 43455c0: UDP packets in a pcap file, one per core."""
    records = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
    for number, packet in enumerate(values):
        for core in range(packet.shape[1]):
            parts = np.stack([packet[:, core].real, packet[:, core].imag], axis=1)
            csi = parts.astype("<i2").tobytes()
            head = b"\xff" * 6 + b"NEXMON" + b"\0" * 30
            head += struct.pack("<I6sHHHH", 0x11111111, b"\0" * 6, number, core, 0, 0x6500)
            length = len(head) + len(csi)
            time = struct.pack("<II", 10, 1000 * number + 3 * core)
            records.append(time + struct.pack("<II", length, length) + head + csi)
    return b"".join(records)


def esp32_file(values):
    """ESP32-CSI-Tool: lines of CSV with pairs of imaginary and real parts."""
    lines = []
    for number, packet in enumerate(values[:, :, 0]):
        pairs = " ".join(f"{int(v.imag)} {int(v.real)}" for v in packet)
        numbers = "-40,11,1,0,0,1,0,0,0,0,0,-90,0,6,1"
        times = f"{2000 * number},0,100,0,1,{number}.5,128"
        lines.append(f"CSI_DATA,AP,00:00:00:00:00:00,{numbers},{times},[{pairs} ]\n")
    return "".join(lines).encode()


def test_intel_file_is_read_with_its_clock_unwrapped(tmp_path):
    values = values_of(30, 3, 100)
    (tmp_path / "a.dat").write_bytes(intel_file(values))
    found = open_csi(tmp_path / "a.dat", "intel")
    same_up_to_scale(found.channel, values)
    assert np.allclose(np.diff(found.time_s), 1e-3)
    assert found.subcarrier_hz[0] == -28 * 312.5e3 and found.subcarrier_hz[-1] == 28 * 312.5e3


def test_atheros_file_is_read(tmp_path):
    values = values_of(56, 2, 400)
    (tmp_path / "a.dat").write_bytes(atheros_file(values))
    found = open_csi(tmp_path / "a.dat", "atheros")
    same_up_to_scale(found.channel, values)
    assert np.allclose(np.diff(found.time_s), 1e-3) and len(found.subcarrier_hz) == 56


def test_nexmon_file_is_read_core_by_core(tmp_path):
    values = values_of(64, 2, 2000)
    (tmp_path / "a.pcap").write_bytes(nexmon_file(values))
    found = open_csi(tmp_path / "a.pcap", "nexmon/43455c0/20")
    same_up_to_scale(found.channel, values)
    assert np.allclose(np.diff(found.time_s), 1e-3)


def test_esp32_file_has_one_antenna_and_is_refused_by_the_reader(tmp_path):
    values = values_of(64, 1, 100)
    (tmp_path / "a.csv").write_bytes(esp32_file(values))
    found = open_csi(tmp_path / "a.csv", "esp32")
    same_up_to_scale(found.channel, values)
    assert np.allclose(np.diff(found.time_s), 2e-3)
    done = run_command(
        "read", "a.csv", "--csi-tool", "esp32", "--scene", "wifi_packets", cwd=tmp_path
    )
    assert done.returncode == 2 and "single antenna" in done.stderr


def test_broken_files_and_unknown_tools_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.dat").write_text("no CSI at all\n" * 50)
    noise = np.random.default_rng(1).bytes(20_000)
    (tmp_path / "noise.dat").write_bytes(noise)
    for name in ("text.dat", "noise.dat", "nowhere.dat"):
        for tool in ("intel", "nexmon/4358/80"):
            with pytest.raises(InputError, match=name) as caught:
                open_csi(tmp_path / name, tool)
            assert "\n" not in str(caught.value)
    for tool in ("", "picoscenes", "nexmon", "nexmon/4358/60"):
        with pytest.raises(InputError, match="--csi-tool: must be one of"):
            check_tool(tool)
    done = run_command("read", "text.dat", "--csi-tool", "nexmon", cwd=tmp_path)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
