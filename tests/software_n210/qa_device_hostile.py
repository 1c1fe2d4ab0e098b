# SPDX-License-Identifier: GPL-3.0-or-later
"""The software N210 against crafted datagrams: later sessions must find a working device."""

import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
from long_cases import cases

CONTROL, TX = 49152, 49157
SETTINGS_BASE, POKE, POKE_FIRMWARE = 0x7000, 3, 6
EXTREME = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
# Blocks of setting registers: time, SPI, receive, transmit, GPIO.
REGISTERS = [*range(10, 24), *range(32, 60), *range(80, 108), *range(144, 192)]

SESSION = """
import sys
from gnuradio import blocks, gr, uhd
source = uhd.usrp_source(sys.argv[1], uhd.stream_args(cpu_format="sc16", channels=[0]))
source.set_samp_rate(5e6)
source.set_center_freq(915e6)
assert abs(source.get_center_freq() - 915e6) < 1, source.get_center_freq()
flowgraph, sink = gr.top_block(), blocks.null_sink(4)
flowgraph.connect(source, blocks.head(4, 50_000), sink)
flowgraph.run()
print(sink.nitems_read(0))
"""


def request(code, body):
    return struct.pack(">III", 12, ord(code), 1) + body.ljust(24, b"\0")


def poke(register, value):
    return request("r", struct.pack(">IIB", SETTINGS_BASE + 4 * register, value, POKE))


def send(address, datagrams, port=CONTROL):
    """Sends each and waits for its reply, if there is one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.settimeout(0.05)
        for datagram in datagrams:
            stranger.sendto(datagram, (address, port))
            try:
                stranger.recv(9000)
            except TimeoutError:
                pass


def samples_of_a_session(device):
    """Samples that a new process receives through the real driver."""
    done = subprocess.run(
        [sys.executable, "-c", SESSION, device.args], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout.split()[-1])


FIRMWARE = [
    request("r", struct.pack(">IIB", address, value, POKE_FIRMWARE))
    for address in (0, 1, 2, 3, 4, 7, 0xFFFF)
    for value in (0xFFFFFFFF, 0x55AA55AA)
]
# A byte of the motherboard's EEPROM says that a GPS receiver is fitted.
GPSDO = [request("h", bytes([0x50, 2, 23, 1]))]
EEPROMS = [
    request("h", bytes([address, 20, offset]) + b"\xa5" * 19)
    for address in (0x50, 0x54, 0x55)
    for offset in range(0, 256, 19)
]
# The last tick that a packet's header can hold, set at once.
TIME = [poke(13, 1), poke(11, 0xFFFFFFFF), poke(10, 0xFFFFFFFF)]
STREAM = [poke(39, 100), poke(32, 0xE0000001), poke(33, 0), poke(34, 0)]


@pytest.mark.parametrize(
    "datagrams",
    cases([*TIME, *STREAM], long=(FIRMWARE, EEPROMS, GPSDO)),
    ids=["time", "firmware", "eeprom", "gpsdo"],
)
def test_device_is_usable_after_a_crafted_datagram(software_usrp, datagrams):
    device = software_usrp("--air", "cable")
    send(device.address, datagrams)
    assert samples_of_a_session(device) == 50_000


@pytest.mark.parametrize("seed", cases(0, long=(1,)))
def test_device_with_a_scene_is_usable_after_any_register_writes(software_usrp, seed):
    rng = np.random.default_rng(seed)
    device = software_usrp("tabletop")
    values = [*EXTREME, *rng.integers(0, 1 << 32, 20).tolist()]
    writes = [poke(int(r), int(rng.choice(values))) for r in rng.choice(REGISTERS, 150)]
    send(device.address, [*STREAM, *writes, *STREAM])
    assert device.command("status")["ok"]
    assert samples_of_a_session(device) == 50_000
