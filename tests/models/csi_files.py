# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of CSI tools, synthesised by their published formats and by what real cards wrote."""

import struct

import numpy as np

PACKETS = 80


def values_of(subcarriers, antennas, size):
    rng = np.random.default_rng(1)
    parts = rng.integers(-size, size, (PACKETS, subcarriers, antennas, 2))
    return parts @ np.array([1, 1j])


def packed(fields):
    """Whole numbers in so many bits each, from the lowest one on, filled up to whole bytes."""
    bits = [(number >> bit) & 1 for number, width in fields for bit in range(width)]
    return np.packbits(bits, bitorder="little").tobytes()


def intel_file(values, start_us=(1 << 32) - 30_000):
    """Linux 802.11n CSI Tool: 8-bit values, 3 bits before each subcarrier, a 1 MHz clock."""
    _, _, antennas = values.shape
    records = []
    for number, packet in enumerate(values):
        fields = []
        for row in packet:
            fields.append((0, 3))
            fields += [(int(part), 8) for value in row for part in (value.real, value.imag)]
        length = 60 * antennas + 12
        payload = packed(fields).ljust(length, b"\0")
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
        csi = packed((int(part), 10) for v in packet.ravel() for part in (v.imag, v.real))
        csi += b"\0" * (len(csi) % 2)
        head = struct.pack("<QHHBBBBBBBBBBBH", 5_000_000 + 1000 * number, len(csi), 2437, 0, 0, 0,
                           0, tones, antennas, 1, 40, 40, 40, 40, 0)  # fmt: skip
        records.append(struct.pack("<H", len(head) + len(csi)) + head + csi)
    return b"".join(records) + b"\0\0\0\0"


def nexmon_file(values, sequence=True, senders=(0,), lost=()):
    """nexmon_csi of a 43455c0: UDP packets in a pcap file, one per core."""
    records = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
    for number, packet in enumerate(values):
        sender = bytes([senders[number % len(senders)]] * 6)
        for core in range(packet.shape[1]):
            if (number, core) in lost:
                continue
            parts = np.stack([packet[:, core].real, packet[:, core].imag], axis=1)
            csi = parts.astype("<i2").tobytes()
            head = b"\xff" * 6 + b"NEXMON" + b"\0" * 30
            count = number if sequence else 0
            head += struct.pack("<I6sHHHH", 0x11111111, sender, count, core, 0, 0x0065)
            length = len(head) + len(csi)
            time = struct.pack("<II", 10, 1000 * number + 3 * core)
            records.append(time + struct.pack("<II", length, length) + head + csi)
    return b"".join(records)


ESP32_HEADER = (
    "type,role,mac,rssi,rate,sig_mode,mcs,bandwidth,smoothing,not_sounding,aggregation,stbc,"
    "fec_coding,sgi,noise_floor,ampdu_cnt,channel,secondary_channel,local_timestamp,ant,sig_len,"
    "rx_state,real_time_set,real_timestamp,len,CSI_DATA\n"
)


def esp32_lines(values, mac="00:00:00:00:00:00"):
    """ESP32-CSI-Tool: lines of CSV with pairs of imaginary and real parts."""
    lines = []
    for number, packet in enumerate(values[:, :, 0]):
        pairs = " ".join(f"{int(v.imag)} {int(v.real)}" for v in packet)
        numbers = "-40,11,1,0,0,1,0,0,0,0,0,-90,0,6,1"
        times = f"{2000 * number},0,100,0,1,{number}.5,{2 * len(packet)}"
        lines.append(f"CSI_DATA,AP,{mac},{numbers},{times},[{pairs} ]\n")
    return lines


def crab_file(values, first=0, header="seq"):
    """esp-crab, and esp-csi on an ESP32-C5: quoted values, and the sender's number of packets."""
    lines = [
        f"type,{header},mac,rssi,rate,noise_floor,fft_gain,agc_gain,channel,local_timestamp,"
        "sig_len,rx_state,len,first_word,data\n"
    ]
    for number, packet in enumerate(values):
        pairs = ",".join(f"{int(v.imag)},{int(v.real)}" for v in packet)
        start = f"CSI_DATA,{first + number},1a:00:00:00:00:00,-23,11,-96,32,4,11"
        lines.append(f'{start},{2000 * number + 7},47,0,{2 * len(packet)},0,"[{pairs}]"\n')
    return "".join(lines)


def picoscenes_file():
    """PicoScenes: records by their length and magic number, with noise in place of segments."""
    rng, records = np.random.default_rng(1), []
    for length in rng.integers(800, 1200, PACKETS):
        records.append(struct.pack("<II", length, 0x20150315) + rng.bytes(length - 4))
    return b"".join(records)
