# SPDX-License-Identifier: GPL-3.0-or-later
"""What rooms, radios, beams and hands add to a simulated scene: a mapping per effect."""

from ..io.text.schema import declared, key
from ..io.text.values import Choice, Integer, Number, Scope

_LEVEL = Number(unit="dB", low=-100, high=100)
_SHARE = Number(low=0, above=True, high=0.95)
_IMBALANCE_DB = Number(unit="dB", low=-3, high=3)
_IMBALANCE_DEG = Number(unit="deg", low=-20, high=20)
_BURST = Number(unit="s", low=20e-6, high=10)


def _not_below_shortest(longest_s: float, scope: Scope) -> str | None:
    shortest_s = scope["shortest_s"]
    return None if longest_s >= shortest_s else f"must not be below shortest_s ({shortest_s:g})"


@declared
class Bursts:
    """Bursts of other transmitters, such as Wi-Fi frames, over the whole band."""

    share: float = key(_SHARE, default=0.2, doc="Share of the time in which a burst is on the air.")
    shortest_s: float = key(_BURST, default=0.3e-3, doc="Shortest burst.")
    longest_s: float = key(
        _BURST,
        default=2e-3,
        doc="Longest burst. Durations are spread evenly, the pauses between bursts exponentially.",
        check=_not_below_shortest,
    )
    level_db: float = key(
        _LEVEL, default=25.0, doc="Power of a burst relative to the receiver's noise."
    )


@declared
class Hopper:
    """A narrow-band transmitter that hops, such as Bluetooth."""

    subcarriers: int = key(
        Integer(low=1, high=64),
        default=8,
        doc="Bandwidth in subcarriers, of which the sample rate holds 64. The centre of each "
        "visit is drawn at random so that the transmission lies within the band.",
    )
    share: float = key(_SHARE, default=0.5, doc="Share of the time in which it transmits.")
    shortest_s: float = key(_BURST, default=5e-3, doc="Shortest visit to a channel.")
    longest_s: float = key(
        _BURST, default=20e-3, doc="Longest visit to a channel.", check=_not_below_shortest
    )
    level_db: float = key(
        _LEVEL,
        default=30.0,
        doc="Power in a subcarrier that it covers relative to the receiver's noise there.",
    )


@declared
class FrontEnd:
    """What the analogue parts of transmitter and receiver do to the signal."""

    receiver_gain_db: float = key(
        _IMBALANCE_DB, default=0.0, doc="Gain of the receiver's Q relative to its I."
    )
    receiver_phase_deg: float = key(
        _IMBALANCE_DEG,
        default=0.0,
        doc="Deviation of the angle between the receiver's I and Q from 90 degrees.",
    )
    transmitter_gain_db: float = key(
        _IMBALANCE_DB, default=0.0, doc="Gain of the transmitter's Q relative to its I."
    )
    transmitter_phase_deg: float = key(
        _IMBALANCE_DEG, default=0.0, doc="The same deviation in the transmitter."
    )
    dc_offset: float = key(
        Number(low=0, high=1),
        default=0.0,
        doc="Magnitude of the receiver's DC offset relative to the peak of the received signal. "
        "Its angle is drawn at random.",
    )
    compression: float = key(
        Number(low=0, high=0.3),
        default=0.0,
        doc="Third-order compression of the receiver: share of the amplitude that is lost at the "
        "peak of the received signal.",
    )


@declared
class RadioNoise:
    """Noise of synthesizers and transmitter, which the static path carries to the receiver."""

    synthesizers: str = key(
        Choice(words=("two", "one")),
        default="two",
        doc="`two`: transmitter and receiver have a synthesizer each, also on one reference, as in "
        "a USRP's daughterboard. `one`: they share it, and its phase noise cancels.",
    )
    phase_noise_dbc_hz: float = key(
        Number(unit="dBc/Hz", low=-200, high=-40),
        default=-101.0,
        doc="Phase noise of both synthesizers together, within the bandwidth of their loops. The "
        "default is that of two ADF4350 at 900 MHz (data sheet: -97 dBc/Hz at 2.1 GHz).",
    )
    loop_hz: float = key(
        Number(unit="Hz", low=100, high=30_000),
        default=30_000.0,
        doc="Bandwidth of the loops, beyond which it falls by 20 dB per decade.",
    )
    transmitter_dbc_hz: float = key(
        Number(unit="dBc/Hz", low=-200, high=-40),
        default=-145.0,
        doc="White noise of the transmitter relative to the power of a preamble.",
    )


@declared
class Ripple:
    """Amplitude modulation of all that is received, for example by a power supply."""

    percent: float = key(
        Number(unit="%", low=0, high=100), default=10.0, doc="Amplitude of the modulation."
    )
    hz: float = key(
        Number(unit="Hz", low=0, above=True, high=10_000), default=50.0, doc="Its frequency."
    )


@declared
class Lamps:
    """Lamps whose reflections are modulated at twice the mains frequency and its harmonics."""

    mains_hz: float = key(
        Number(unit="Hz", low=10, high=1000), default=50.0, doc="Mains frequency."
    )
    level_db: float = key(
        _LEVEL,
        default=10.0,
        doc="Power of each of the two lines at twice the mains frequency relative to "
        "|c1[1] G1|^2. Harmonic h is 20 log10(h) dB weaker.",
    )
    wander_hz_per_sqrt_s: float = key(
        Number(unit="Hz", low=0, high=1),
        default=0.06,
        doc="Random walk of the mains frequency per root of a second, reflected at 1 % from the "
        "stated frequency.",
    )


@declared
class Fan:
    """A fan whose blades reflect."""

    blade_hz: float = key(
        Number(unit="Hz", low=0.1, high=1000),
        default=40.0,
        doc="Blades that pass per second; all lines lie at multiples of it.",
    )
    highest_hz: float = key(
        Number(unit="Hz", low=0.1, high=5000),
        default=200.0,
        doc="Highest Doppler frequency, that of the tips.",
    )
    level_db: float = key(
        _LEVEL, default=20.0, doc="Power of what the blades reflect relative to |c1[1] G1|^2."
    )


@declared
class Walker:
    """A person who walks, stops, and walks again, beside `moving_clutter_db`."""

    level_db: float = key(
        _LEVEL, default=20.0, doc="Power of all that the person reflects relative to |c1[1] G1|^2."
    )
    highest_hz: float = key(
        Number(unit="Hz", low=1, high=1000),
        default=30.0,
        doc="Highest Doppler frequency, that of a swinging leg. The trunk reaches a third of it.",
    )
    walking_share: float = key(
        _SHARE, default=0.6, doc="Share of the time in which the person walks."
    )
    walk_s: float = key(
        Number(unit="s", low=0.5, high=1000),
        default=2.0,
        doc="Mean duration of a walk, between half and one and a half times of which each lasts.",
    )


@declared
class OtherTag:
    """A tag that the scene does not list among its sensors."""

    clock_hz: float = key(
        Number(unit="Hz", low=0, above=True, high=1e6), doc="Frequency of its clock 1."
    )
    clock_offset_ppm: float = key(
        Number(unit="ppm", low=-20_000, high=20_000), default=0.0, doc="Error of that clock."
    )
    level_db: float = key(
        _LEVEL, default=-10.0, doc="Strength relative to a tag of the scene with `level_db` 0."
    )
    delay_s: float = key(
        Number(unit="s", low=0, high=1e-6),
        default=0.0,
        doc="Delay of its path relative to that of the scene's tags.",
    )


@declared
class Beam:
    """How the soft beam of a sensor deviates from an elastic one."""

    hysteresis: float = key(
        Number(low=0, high=1),
        default=0.05,
        doc="Largest excess of the force that the contact shows while unloading, relative to the "
        "largest force of the press.",
    )
    creep: float = key(
        Number(low=0, high=1),
        default=0.03,
        doc="What the shown force gains in the long run under a constant force, relative to it.",
    )
    creep_s: float = key(
        Number(unit="s", low=0.01, high=1e4), default=2.0, doc="Time constant of the creep."
    )


@declared
class Hand:
    """The hand that presses, as a second path between tag and reader."""

    level_db: float = key(
        _LEVEL,
        default=-20.0,
        doc="Level of the path by way of the hand on the sensor, relative to the tag's own path.",
    )
    delay_s: float = key(
        Number(unit="s", low=0, high=1e-6),
        default=5e-9,
        doc="Its delay relative to the tag's own path.",
    )
    reach_s: float = key(
        Number(unit="s", low=0.01, high=10),
        default=0.3,
        doc="Time in which the hand comes before a press, and goes after it.",
    )
    travel_mm: float = key(
        Number(unit="mm", low=0, high=2000), default=200.0, doc="How far it comes."
    )
    sway_mm: float = key(
        Number(unit="mm", low=0, high=100),
        default=2.0,
        doc="Amplitude of its movement while it presses, at 0.7 Hz.",
    )


# Share of each kind of fault that leaves something to read.
_MOST_LOST = 0.9


@declared
class PacketFaults:
    """What commodity receivers do to channel snapshots, in a scene with `packets`."""

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
