# SPDX-License-Identifier: GPL-3.0-or-later
"""The tag's firmware: its edges in simavr, a simulator of the processor's instructions."""

import re
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce.sensor.microstrip import tag_timer
from machine import wait_until

FIRMWARE = Path(__file__).resolve().parents[3] / "examples" / "tag_firmware" / "tag.s"
PERIODS = 20
# What simavr records, and how: sections of an ELF file that it reads (avr_mcu_section.h of simavr).
# PORTB is 0x38 in the address space of data.
TRACE = """
    .section .mmcu,"a"
    .byte 1, 64
    .ascii "attiny85"
    .fill 56
    .byte 2, 4
    .long 4000000
    .byte 12, 64
1:  .ascii "{name}"
    .fill 64 - (. - 1b)
    .byte 13, 4
    .long 1000
    .byte 14, 35, 1
    .word 0x38
    .ascii "PB0"
    .fill 29
    .byte 14, 35, 2
    .word 0x38
    .ascii "PB1"
    .fill 29
"""


def edges_ns(steps, prescaler, folder):
    """Times at which the pins rise and fall, as simavr records them: {(pin, level): times}."""
    (folder / "trace.s").write_text(TRACE.format(name="t.vcd"))
    options = "--defsym", f"SLOT={steps}", "--defsym", f"PRESCALER={prescaler}"
    for source, more in ((FIRMWARE, options), (folder / "trace.s", ())):
        target = folder / f"{source.stem}.o"
        subprocess.run(["avr-as", "-mmcu=attiny85", *more, source, "-o", target], check=True)
    objects = folder / "tag.o", folder / "trace.o"
    subprocess.run(["avr-ld", "-m", "avr25", *objects, "-o", folder / "tag.elf"], check=True)
    record, needed = folder / "t.vcd", 6 * (PERIODS + 4)
    with subprocess.Popen(["simavr", "tag.elf"], cwd=folder, stdout=subprocess.DEVNULL) as process:
        written = record.exists
        wait_until(lambda: written() and record.read_text().count("#") >= needed, process=process)
        process.send_signal(signal.SIGINT)
    unit = {"1ns": 1, "10ns": 10}[re.search(r"timescale (\w+)", record.read_text())[1]]
    found, now = {}, 0
    for line in record.read_text().split("$end")[-1].splitlines():
        if line.startswith("#"):
            now = unit * int(line[1:])
        elif line[:1] in "01" and line:
            found.setdefault(('!"'.index(line[1]), int(line[0])), []).append(now)
    return {key: np.array(times) for key, times in found.items()}


@pytest.mark.parametrize("clock_hz", [1035.0, 139.0])
def test_edges_lie_within_50_ns_of_the_planned_pulses(clock_hz, tmp_path):
    """Clock 1 is high for |t| < Ts/8, clock 2 for Ts/16 around +-Ts/4; never both together."""
    timer = tag_timer(clock_hz)
    found = edges_ns(timer.steps, timer.prescaler, tmp_path)
    period_ns = 1e9 / timer.clock_hz
    # The first rise of clock 1 begins half a pulse, that of a period the next one.
    start_ns = found[0, 1][1] + period_ns / 8
    planned = {(0, 1): [-2], (0, 0): [2], (1, 1): [3, 11], (1, 0): [5, 13]}
    for (pin, level), sixteenths in planned.items():
        times = found[pin, level]
        times = times[times > start_ns - 5 / 32 * period_ns][: len(sixteenths) * PERIODS]
        wanted = np.add.outer(np.arange(PERIODS), np.array(sixteenths) / 16).ravel()
        assert np.abs(times - start_ns - wanted * period_ns).max() < 50, (pin, level)
