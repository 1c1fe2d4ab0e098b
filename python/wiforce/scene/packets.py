# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets whose channel another device measures, instead of frames that a radio samples."""

from ..io.text.schema import declared, key
from ..io.text.values import Choice, Integer, Number

# Time that a channel estimate averages, in s: two long training symbols of 3.2 us each, as in the
# legacy and HT preambles (IEEE 802.11-2020, 17.3.3 and 19.3.9).
_TRAINING_S = 6.4e-6
# Share of each kind of fault that leaves something to read.
_MOST_LOST = 0.9


@declared
class Packets:
    """Packets, each of which gives one snapshot of the channel at a time of its own."""

    interval_s: float = key(
        Number(unit="s", low=1e-5, high=10),
        default=1e-3,
        doc="Mean time between packets that are received: 0.0026 to 0.112 for an ESP32, about "
        "0.001 for better hardware. Phase groups last `phase_group.snapshots` times this.",
    )
    gaps: str = key(
        Choice(words=("exponential", "regular")),
        default="exponential",
        doc="Times between packets, for `plan` and `simulate`: `exponential` as in traffic of "
        "independent senders, `regular` as from a sender with a timer.",
    )
    window_s: float = key(
        Number(unit="s", low=1e-7, high=1e-2),
        default=_TRAINING_S,
        doc="Time of a packet that its channel estimate averages, Ta: that of its training "
        "symbols.",
    )
    subcarriers: int = key(
        Integer(low=4, high=4096),
        default=52,
        doc="Subcarriers, for `plan` and `simulate`; `read` uses those of the file.",
    )
    spacing_hz: float = key(
        Number(unit="Hz", low=1e3, high=1e8),
        default=312.5e3,
        doc="Distance of these subcarriers.",
    )


@declared
class PacketFaults:
    """What commodity receivers do to channel snapshots, for `simulate`."""

    lost: float = key(
        Number(low=0, high=_MOST_LOST), default=0.0, doc="Share of the packets that is lost."
    )
    repeated: float = key(
        Number(low=0, high=_MOST_LOST),
        default=0.0,
        doc="Share of the packets that is reported twice, as by a driver that logs retransmissions "
        "again.",
    )
    gain_step_db: float = key(
        Number(unit="dB", low=0, high=30),
        default=0.0,
        doc="Step of the receiver's automatic gain, which all antennas share: each packet is "
        "received with a gain of -1, 0 or 1 of these steps.",
    )
    timing_offset_s: float = key(
        Number(unit="s", low=0, high=1e-6),
        default=0.0,
        doc="Standard deviation of the sampling time from packet to packet: a phase that is "
        "linear over the subcarriers, common to all antennas.",
    )
    flips_per_s: float = key(
        Number(unit="1/s", low=0, high=1e4),
        default=0.0,
        doc="How often the phase of each antenna but the first jumps, as that of an Intel AX200: "
        "by a multiple of 360 degrees over `flip_phases`.",
    )
    flip_phases: int = key(
        Integer(low=2, high=8), default=2, doc="Phases that it takes: 2 are 180 degrees apart."
    )
    antenna_gain_step_db: float = key(
        Number(unit="dB", low=0, high=30),
        default=0.0,
        doc="Step of the gain of each antenna by itself: each packet is received with a gain of "
        "-1, 0 or 1 of these steps.",
    )
    antenna_wander_db: float = key(
        Number(unit="dB", low=0, high=3),
        default=0.0,
        doc="Standard deviation of the gain of each antenna against the first, which wanders "
        "within milliseconds on all subcarriers alike: 0.06 of an Intel AX200.",
    )
    antenna_wander_deg: float = key(
        Number(unit="deg", low=0, high=30),
        default=0.0,
        doc="The same of its phase: 0.54 of an Intel AX200.",
    )
    clock_steps: int = key(
        Integer(low=0, high=100),
        default=0,
        doc="How often the card's clock steps back, by 1 to 10 s, at random times.",
    )
    stamp_jitter_s: float = key(
        Number(unit="s", low=0, high=0.1),
        default=0.0,
        doc="Standard deviation of the errors of time stamps.",
    )
    stamp_resolution_s: float = key(
        Number(unit="s", low=0, high=0.1),
        default=0.0,
        doc="Time stamps are multiples of this; 0 for exact ones.",
    )
