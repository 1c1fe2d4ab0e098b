# SPDX-License-Identifier: GPL-3.0-or-later
"""The software N210 as a guest on a machine: what it binds, ignores, and leaves behind."""

import os
import pty
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path
from time import monotonic

import numpy as np
import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from machine import own_address
from software_n210.device import Device, parse_fault
from software_n210.frontend import Cable
from software_n210.host_link import Sockets

CONTROL, RX, TX, FIFO = 49152, 49156, 49157, 49159
PORTS = (49152, 49156, 49157, 49158, 49159, 49172)
HELLO = struct.pack(">III", 12, ord("a"), 7) + bytes(24)


def start_refused(*arguments):
    """The line with which a device refuses to start."""
    with open(os.devnull) as lines, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", lines)
        return refused("emulate", *arguments)


def ask(address, request=HELLO):
    """The reply to one control request."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(60)
        sock.sendto(request, (address, CONTROL))
        return sock.recv(2000)


def sockets_of(process):
    """(protocol, local address, port) of every internet socket that a process holds."""
    links = [os.readlink(f"/proc/{process}/fd/{fd}") for fd in os.listdir(f"/proc/{process}/fd")]
    inodes = {link[8:-1] for link in links if link.startswith("socket:[")}
    found = []
    for protocol in ("udp", "udp6", "tcp", "tcp6", "raw"):
        for line in Path(f"/proc/{process}/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                address, port = fields[1].split(":")
                packed = int(address, 16).to_bytes(4, "little")
                found.append((protocol, socket.inet_ntoa(packed), int(port, 16)))
    return sorted(found)


def test_device_binds_the_given_address_only_and_none_in_use(
    software_usrp,
):
    device = software_usrp("--air", "cable")
    assert sockets_of(device.process.pid) == [("udp", device.address, port) for port in PORTS]
    assert "is in use" in start_refused("--air", "cable", "--bind", device.address)
    assert ask(device.address)[4:8] == struct.pack(">I", ord("A"))


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.10.2", "8.8.8.8", "::1", "localhost", ""])
def test_device_address_outside_loopback_refused(address):
    said = start_refused("--air", "cable", "--bind", address)
    assert "--bind: must be a loopback address" in said and repr(address) in said


@pytest.mark.parametrize(
    "arguments, words",
    [
        ([], "SCENE"),
        (["nowhere.yaml"], "nowhere.yaml"),
        (["--air", "cable", "--fault", "soon lose 1"], "--fault"),
        (["--air", "cable", "--fault", "1 overflow 3 perhaps"], "TIME overflow samples"),
        (["--air", "cable", "--fault", "1 lose -3"], "packets"),
        (["--air", "cable", "--fault", "1 melt"], "overflow"),
        (["--air", "cable", "--bind", "127.9.8.7", "--fault", "1 off arm"], "scene"),
        (["demo", "--air", "cable"], "SCENE"),
    ],
)
def test_emulate_bad_usage_refused_in_one_line(arguments, words):
    assert words in start_refused(*arguments)


def test_device_with_a_refused_fault_binds_no_port():
    """Its ports stayed in use while the process that had asked for it held the error."""
    with pytest.raises(InputError, match="sensor: requires --air scene, got 'arm'"):
        Device(Cable(0), "127.9.8.9", faults=[parse_fault("1 off arm")])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.9.8.9", CONTROL))


def test_device_malformed_and_foreign_packets_counted_and_ignored(software_usrp):
    device = software_usrp("--air", "cable")
    rng = np.random.default_rng(1)
    junk = [b"", b"\0", b"\xff" * 7, rng.bytes(35), rng.bytes(37), rng.bytes(300), rng.bytes(9000)]
    announcement = struct.pack(">II", 0, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for port in PORTS:
            for datagram in junk:
                stranger.sendto(datagram, (device.address, port))
        # A data packet from somebody who never said hello.
        stranger.sendto(struct.pack(">IIII", 0, 3, 1, 2), (device.address, TX))
        # I2C: more than a message holds; registers and EEPROMs that don't exist.
        for code, body in ((b"i", b"\x50\xff"), (b"i", b"\x13\x02"), (b"h", b"\x13\x03abc")):
            ask_it = struct.pack(">III", 12, code[0], 1) + body.ljust(24, b"\0")
            stranger.sendto(ask_it, (device.address, CONTROL))
        stranger.sendto(announcement, (device.address, TX))
        # What says more than it holds, then a second packet type, from a host that did.
        for data in (struct.pack(">IIII", 0, 300, 1, 2), struct.pack(">IIII", 0, 0xF0000003, 1, 2)):
            stranger.sendto(data, (device.address, TX))
    assert ask(device.address)[4:8] == struct.pack(">I", ord("A"))
    status = device.command("status")
    # On TX whatever a stranger sends is foreign, on unused ports nothing is looked at, and a
    # control message of 37, 300 or 9000 bytes is only judged by its first 36.
    assert status["foreign"] == len(junk) + 1
    assert status["malformed"] >= 4 + len(junk) + 1 + 2


def test_reply_to_an_address_that_takes_none_is_lost():
    """A datagram with a forged source port of 0 ended the device."""
    sockets = Sockets("127.9.8.10")
    sockets.send(CONTROL, HELLO, ("127.9.8.10", 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.9.8.10", 0))
        host.settimeout(5)
        sockets.send(CONTROL, HELLO, host.getsockname())
        assert host.recv(2000) == HELLO
    sockets.close()


STREAM = [(32, 1 << 31 | 1 << 29), (33, 0), (34, 0)]


@pytest.mark.parametrize(
    "pokes, time",
    [
        ([(13, 1), (11, 0), (10, 0xF0000000), *STREAM], None),
        ([(39, 0xFFFF), *STREAM], None),
        (STREAM, 1 << 62),
        (STREAM, (1 << 64) - 1),
    ],
    ids=["late device time", "huge packets", "command in 1000 years", "command before power-on"],
)
def test_device_serves_the_next_host_whatever_registers_were_written(software_usrp, pokes, time):
    """Random commands ended it, held its time, or let no other host write a register."""
    device = software_usrp("--air", "cable")
    announcement = struct.pack(">II", 0, 0)
    timed = b"" if time is None else struct.pack(">Q", time)
    header = 0x40000000 | (time is not None) << 20
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(announcement, (device.address, RX))
        for index, value in pokes:
            command = struct.pack(">II", 0, header) + timed + struct.pack(">II", 256 | index, value)
            stranger.sendto(command, (device.address, FIFO))
        assert ask(device.address)[4:8] == struct.pack(">I", ord("A"))
        before_s, limit_s = device.command("status")["device_time_s"], monotonic() + 60
        while device.command("status")["device_time_s"] == before_s:
            assert monotonic() < limit_s
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
            host.settimeout(60)
            for datagram in announcement, struct.pack(">IIII", 7, 0x40000000, 12, 0):
                host.sendto(datagram, (device.address, FIFO))
            assert host.recv(2000)[-4:] == struct.pack(">I", 11 << 16 | 1)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, "closed standard input"])
def test_device_that_is_ended_frees_its_ports(software_usrp, end):
    device = software_usrp("--air", "cable")
    if end in list(signal.Signals):
        device.process.send_signal(end)
    # Closes its standard input.
    _, said = device.process.communicate(timeout=60)
    assert device.process.returncode == 0
    commands, end = said.splitlines()
    assert commands.startswith("commands: press SENSOR FORCE_N LOCATION_MM; release SENSOR; ")
    assert end.startswith("stopped at ")
    for port in PORTS:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind((device.address, port))


# The process that a shell is: it owns the terminal and starts a job in the background.
SHELL = """
import fcntl, os, subprocess, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
job = subprocess.Popen(sys.argv[1:], preexec_fn=os.setpgrp)
print(job.pid, flush=True)
_, status = os.waitpid(job.pid, os.WUNTRACED)
print("stopped" if os.WIFSTOPPED(status) else "ended", flush=True)
job.kill()
"""


def test_device_in_the_background_of_a_terminal_is_not_stopped_by_keys():
    """`emulate demo &` in a shell was stopped by the next command that was typed."""
    address = own_address()
    device = ["-m", "wiforce_app.main", "emulate", "--air", "cable", "--bind", address]
    shell, terminal = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", SHELL, sys.executable, *device],
        stdin=terminal,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as process:
        job = int(process.stdout.readline())
        try:
            assert process.stdout.readline().startswith("listening")
            for _ in range(3):
                os.write(shell, b"press arm 4 45\n")
                assert ask(address)[4:8] == struct.pack(">I", ord("A"))
        finally:  # or the shell would wait for it
            os.kill(job, signal.SIGTERM)
        assert process.stdout.readline() == "ended\n"
    os.close(shell)
    os.close(terminal)
