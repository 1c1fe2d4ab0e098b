# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene files, declared key by key: what is measured, and with what.

What a simulation adds is declared in :mod:`.simulated`. Rules that involve several keys are in
:mod:`.consistency`.
"""

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..io.readings import SURFACE_COLUMNS
from ..io.text.schema import DRAFT_7, Derived, ListOf, declared, json_schema, key, plain, section
from ..io.text.values import (
    AutomaticNumber,
    Choice,
    Integer,
    Number,
    Scope,
    Text,
    ValueType,
    as_number,
)
from ..signal.carrier import BANDS, CARRIERS_HZ
from ..signal.symbols import LONGEST_SYMBOL, SHORTEST_SYMBOL, decode_symbol
from ..signal.waveform import WAVEFORMS, Waveform, packet_waveform, sounding_waveform
from .simulated import MAX_SENSORS, MODEL_NAME_LENGTH, Simulation
from .surface import Surface

if TYPE_CHECKING:
    from ..sensor import SensorModel


# All public power grids use one of these.
FREQUENCIES_HZ = (50.0, 60.0)
Mains = str | float | None


class MainsFrequency(ValueType):
    """``auto``, 50 or 60 Hz; null, where allowed, is a room without lamps."""

    allowed = "'auto' or 50 or 60 Hz"

    def _converted(self, value: Any) -> Mains:
        if isinstance(value, str) and value == "auto":
            return "auto"
        number = as_number(value)
        return number if number in FREQUENCIES_HZ else None

    def _json_schema(self) -> dict[str, Any]:
        # Numbers may be typed as text, as everywhere in these files.
        return {"enum": ["auto", *FREQUENCIES_HZ, *(f"{hz:g}" for hz in FREQUENCIES_HZ)]}


class OffReflection(ValueType):
    """G_off / rho, one pair [re, im] or one for each switch, read as two complex numbers."""

    allowed = "a pair [re, im] of magnitude below 1, or a list of two such pairs"

    def _converted(self, value: Any) -> tuple[complex, complex] | None:
        pairs = value if _is_pair(value) and _is_pair(value[0]) else [value, value]
        first, second = (_as_complex(pair) for pair in pairs)
        if first is None or second is None or max(abs(first), abs(second)) >= 1:
            return None
        return first, second

    def plain(self, value: tuple[complex, complex]) -> list[Any]:
        first, second = ([number.real, number.imag] for number in value)
        return first if first == second else [first, second]

    def _json_schema(self) -> dict[str, Any]:
        part = Number(low=-1, above=True, high=1).json_schema() | {"exclusiveMaximum": 1}
        sizes = {"type": "array", "minItems": 2, "maxItems": 2}
        pair = sizes | {"items": part}
        return {"anyOf": [pair, sizes | {"items": pair}]}


def _is_file_name(model: str) -> bool:
    """Whether a model is a file, not a shipped one."""
    return model.lower().endswith((".yaml", ".yml", ".npy"))


def _is_pair(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2


def _as_complex(value: Any) -> complex | None:
    real, imaginary = map(as_number, value) if _is_pair(value) else (None, None)
    return None if real is None or imaginary is None else complex(real, imaginary)


class WaveformName(Text):
    """The name of a shipped waveform, or the path of a ``.npy`` file with a symbol."""

    @property
    def allowed(self) -> str:
        return f"{', '.join(map(repr, WAVEFORMS))} or a path that ends in .npy"

    def _converted(self, value: Any) -> str | None:
        name = super()._converted(value)
        return name if name in WAVEFORMS or (name or "").lower().endswith(".npy") else None

    def _json_schema(self) -> dict[str, Any]:
        path = super()._json_schema() | {"pattern": r"\.[nN][pP][yY]$"}
        return {"anyOf": [{"enum": list(WAVEFORMS)}, path]}


# The kernels sum more without an overflow; 1000 are 5 ms of the default symbol.
MAX_REPETITIONS = 1000
# Characters of the longest symbol in base64.
_SYMBOL_TEXT = (8 * LONGEST_SYMBOL + 2) // 3 * 4


@declared
class Radio:
    """Carrier and sample rate."""

    center_frequency_hz: float = key(
        Number(unit="Hz", low=CARRIERS_HZ[0], high=CARRIERS_HZ[1]),
        default=900e6,
        doc="Carrier frequency, within 10 % of one that every sensor model holds.",
    )
    sample_rate_hz: float = key(
        Number(unit="Hz", low=1e5, high=1e9), default=12.5e6, doc="Complex samples per second."
    )


@declared
class Sounding:
    """The frame that the reader sends; each frame gives one snapshot of the channel."""

    waveform: str = key(
        WaveformName(),
        default="repeated",
        doc="`repeated`: five repetitions of one symbol with 62 subcarriers. `wifi`: the 802.11 "
        "preamble with 52. `chirp`, `fmcw`, `zadoff-chu`, or a file with one symbol: see "
        "docs/radios.md.",
    )
    frame_length: int = key(
        Integer(unit="samples", low=SHORTEST_SYMBOL, high=1_000_000),
        default=720,
        doc="Length of a frame: the preamble and the zeros that follow it.",
    )
    symbol_length: int | None = key(
        Integer(unit="samples", low=SHORTEST_SYMBOL, high=LONGEST_SYMBOL, optional=True),
        doc="Length of the symbol of `repeated`, `chirp`, `fmcw` or `zadoff-chu`; 64, 128, 128 "
        "and 63 unless given.",
    )
    repetitions: int | None = key(
        Integer(low=1, high=MAX_REPETITIONS, optional=True),
        doc="Times that the symbol is sent per frame, 5 unless given. Not for `wifi`.",
    )
    averaged_repetitions: int | None = key(
        Integer(low=1, high=MAX_REPETITIONS, optional=True),
        doc="The last of them, which are averaged to a snapshot; all but the first unless given.",
    )
    symbol: str | None = key(
        Text(limit=_SYMBOL_TEXT, optional=True),
        doc="The symbol of a `.npy` file, complex64 in base64. Captures store it, so that they "
        "can be read without the file.",
    )

    def waveform_at(self, sample_rate_hz: float) -> Waveform:
        """The frame at a sample rate."""
        return sounding_waveform(
            self.waveform,
            self.frame_length,
            sample_rate_hz,
            symbol_length=self.symbol_length,
            repetitions=self.repetitions,
            averaged_repetitions=self.averaged_repetitions,
            symbol=None if self.symbol is None else decode_symbol(self.symbol),
        )


# Time that a channel estimate averages, in s: two long training symbols of 3.2 us each, as in the
# legacy and HT preambles (IEEE 802.11-2020, 17.3.3 and 19.3.9).
_TRAINING_S = 6.4e-6


@declared
class Packets:
    """Packets at times of their own, of which another device measures a channel snapshot each."""

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
        Number(unit="Hz", low=1e3, high=1e8), default=312.5e3, doc="Distance of these subcarriers."
    )


@declared
class PhaseGroup:
    """Snapshots per reading, and how phases are estimated from them."""

    snapshots: int = key(
        Integer(low=32, high=100_000), default=625, doc="N_g, the snapshots per reading."
    )
    estimator: str = key(
        Choice(words=("harmonic", "sideband", "paper")),
        default="harmonic",
        doc="`harmonic`: this project's estimator. For comparison `paper`, as published, and "
        "`sideband`, half the angle of P(+m) P(-m).",
    )
    smoothing_s: float = key(
        Number(unit="s", low=0, high=1),
        default=0.036,
        doc="Time over which groups shorter than this are averaged while nothing changes; 0 makes "
        "readings independent of their neighbours.",
    )


def _default_antennas(scope: Any) -> int:
    return 2 if scope.get("packets") and scope["reader_clock"] == "free" else 1


@declared
class Environment:
    """What the reader knows about the room and its own clocks."""

    moving_clutter_hz: float | None = key(
        AutomaticNumber(unit="Hz", low=0, high=10_000),
        default=None,
        doc="Highest Doppler frequency of anything that moves; 0 where nothing moves. `auto`: as "
        "much as can be rejected at a cost of 0.1 dB, at most 250 Hz; more where the survey of a "
        "recording finds it necessary.",
    )
    reader_clock: str = key(
        Choice(words=("shared", "free")),
        derived=Derived(
            "`shared`; `free` with `packets`",
            lambda scope: "free" if scope.get("packets") else "shared",
        ),
        doc="`shared`: transmitter and receiver use one clock. `free`: each uses its own.",
    )
    receive_antennas: int = key(
        Integer(low=1, high=8),
        derived=Derived("1; 2 with `packets` and `reader_clock: free`", _default_antennas),
        doc="2 needs `reader_clock: free`: `simulate` writes a second capture `NAME.antenna2`, "
        "and `read` uses the ratio of the two. More than 2 need `packets`. With 1 and "
        "`reader_clock: free`, samples cannot be read: `read` warns and flags every reading.",
    )
    mains_hz: Mains = key(
        MainsFrequency(optional=True),
        default="auto",
        doc="Frequency of the mains. Lamps modulate what they reflect at multiples of twice this "
        "frequency. `auto`: not known beforehand. null: no lamps.",
    )
    band: str | None = key(
        Choice(words=tuple(BANDS), optional=True),
        doc="Frequency band that you may transmit in; `plan` and `check` warn where the signal "
        "leaves it.",
    )

    @property
    def possible_mains_hz(self) -> tuple[float, ...]:
        """Mains frequencies that are possible in this room, in Hz; empty without lamps."""
        if self.mains_hz is None:
            return ()
        return FREQUENCIES_HZ if isinstance(self.mains_hz, str) else (self.mains_hz,)


# Directivity, tracking and source match that calibration with an economy kit leaves, each -40 dB.
# They add 1, m and m^2 times this to a reflection of magnitude m (HP 8753, one-port error model).
_VNA_RESIDUAL = 0.01


def _off_reflection_std(scope: Scope) -> float:
    one, other = scope["off_reflection"]
    magnitude = max(abs(one), abs(other))
    return 0.0 if one == other else _VNA_RESIDUAL * (1 + magnitude + magnitude**2)


# Of an RC oscillator, in ppm.
LOOSEST_CLOCK_PPM = 20_000.0


@declared
class SceneSensor:
    """A sensor of the scene and its tag, as the reader knows them."""

    name: str = key(Text(limit=64), doc="Name in the readings; differs from every other.")
    model: str = key(
        Text(limit=MODEL_NAME_LENGTH),
        doc="Sensor model that phases are inverted with: a shipped name, or the path of a sensor "
        "file relative to the scene file.",
    )
    clock_hz: float = key(
        Number(unit="Hz", low=0, above=True, high=1e6),
        default=1000.0,
        doc="Frequency fs of the tag's clock, above `moving_clutter_hz`. 4 fs must lie below half "
        "the snapshot rate.",
    )
    clock_tolerance_ppm: float = key(
        Number(unit="ppm", low=0, high=LOOSEST_CLOCK_PPM),
        default=100.0,
        doc="Largest error of the tag's clock: 100 ppm suit a crystal, 5000 a ceramic resonator, "
        "20 000 an RC oscillator. Above 1000, one antenna and 0.1 s of `reference_s` are needed.",
    )
    drift_deg_per_sqrt_s: float | None = key(
        Number(unit="deg", low=0, high=360, optional=True),
        doc="Random walk of the untouched phases: its standard deviation after one second. It "
        "raises the standard deviations during a touch. Learned while untouched when null; 0 also "
        "says that no finger warms the line.",
    )
    turns_per_s: float | None = key(
        Number(unit="1/s", low=0, high=10, optional=True),
        doc="How often the tag or an antenna is turned or moved. Learned while untouched when "
        "null; state it where that happens during touches as well.",
    )
    off_reflection: tuple[complex, complex] = key(
        OffReflection(),
        default=(0j, 0j),
        doc="G_off / rho of the open switches; two pairs where the switches differ.",
    )
    off_reflection_std: float = key(
        Number(low=0, high=0.5),
        derived=Derived("0 where both are alike, otherwise that of a VNA", _off_reflection_std),
        doc="Standard deviation of the real and the imaginary part of each, which widens readings.",
    )

    def load_model(self, scene: "Scene") -> "SensorModel":
        """Load the reader's model of this sensor (see ``sensor.load_sensor``)."""
        return scene.load_model(self.model)


@declared
class Scene:
    """A scene: what is measured, with what, and, for simulations, what happens.

    ``path``: its file; None for a scene given as a dict.
    """

    radio: Radio = section(Radio)
    sounding: Sounding = section(Sounding)
    packets: Packets | None = section(Packets, absent="samples")
    phase_group: PhaseGroup = section(PhaseGroup)
    environment: Environment = section(Environment)
    sensors: tuple[SceneSensor, ...] = key(
        ListOf(of=SceneSensor, least=1, most=MAX_SENSORS), doc="The sensors that are read."
    )
    surface: Surface | None = section(Surface, absent="none")
    reference_s: float = key(
        Number(unit="s", low=0, high=3600),
        default=0.5,
        doc="Time at the start in which no sensor is touched; phases are differences against it.",
    )
    simulation: Simulation = section(Simulation)
    path: Path | None = dataclasses.field(default=None, compare=False)

    def waveform(self) -> Waveform:
        """The sounding frame of this scene, or what its packets are."""
        if self.packets:
            own = self.packets
            # Channels per subcarrier without an oscillator's phase, of all antennas together.
            antennas = self.environment.receive_antennas
            if self.environment.reader_clock == "free":
                antennas = max(antennas - 1, 1)
            return packet_waveform(
                own.interval_s, own.window_s, own.subcarriers, own.spacing_hz, antennas
            )
        return self.sounding.waveform_at(self.radio.sample_rate_hz)

    @property
    def folder(self) -> Path:
        """Folder that the paths in the scene start from."""
        return self.path.parent if self.path else Path()

    @property
    def files(self) -> tuple[Path, ...]:
        """The scene's file and those of the sensors that it names by path."""
        models = [sensor.model for sensor in self.sensors]
        models += [tag.truth_model for tag in self.simulation.tags]
        if self.surface is not None and self.surface.spreading_file is not None:
            models.append(self.surface.spreading_file)
        models.append(self.sounding.waveform)
        paths = [self.folder / model for model in models if _is_file_name(model)]
        return tuple(dict.fromkeys([*([self.path] if self.path else []), *paths]))

    @property
    def snapshot_period_s(self) -> float:
        """Time between two snapshots: length of a frame, or mean between packets."""
        if self.packets:
            return self.packets.interval_s
        return self.sounding.frame_length / self.radio.sample_rate_hz

    @property
    def group_samples(self) -> int:
        """Samples per phase group."""
        return self.phase_group.snapshots * self.sounding.frame_length

    @property
    def group_period_s(self) -> float:
        """Length of a phase group in s, the time between readings."""
        return self.phase_group.snapshots * self.snapshot_period_s

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors, in their order."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Names in the readings of every group: those of the sensors, then of the surface."""
        return self.sensor_names + (self.surface.names if self.surface is not None else ())

    @property
    def more_columns(self) -> tuple[str, ...]:
        """Columns of its readings behind those that every scene has."""
        return SURFACE_COLUMNS if self.surface is not None else ()

    def with_clocks(self, clocks_hz: dict[int, float]) -> "Scene":
        """The scene with other clocks (Hz) of some sensors, by their index."""
        sensors = list(self.sensors)
        for i, clock_hz in clocks_hz.items():
            sensors[i] = dataclasses.replace(sensors[i], clock_hz=clock_hz)
        return dataclasses.replace(self, sensors=tuple(sensors))

    def load_model(self, name: str) -> "SensorModel":
        """Load a shipped model, or one relative to the scene file, at the scene's carrier."""
        from ..sensor import load_sensor

        return load_sensor(name, self.folder, self.radio.center_frequency_hz)

    def as_dict(self, beside: str | Path | None = None) -> dict[str, Any]:
        """The scene with all defaults as plain values; sensor files as named ``beside`` a file."""
        return plain(Scene, self if beside is None else self._read_from(Path(beside).parent))

    def _read_from(self, folder: Path) -> "Scene":
        def named(name: str) -> str:
            if not _is_file_name(name) or os.path.isabs(name):
                return name
            return os.path.relpath(self.folder / name, folder)

        replace = dataclasses.replace
        surface, simulation = self.surface, self.simulation
        if surface is not None and surface.spreading_file is not None:
            surface = replace(surface, spreading_file=named(surface.spreading_file))
        tags = tuple(replace(each, truth_model=named(each.truth_model)) for each in simulation.tags)
        common = simulation.truth_model and named(simulation.truth_model)
        return replace(
            self,
            sensors=tuple(replace(each, model=named(each.model)) for each in self.sensors),
            surface=surface,
            simulation=replace(simulation, tags=tags, truth_model=common),
        )


def scene_json_schema() -> dict[str, Any]:
    """JSON Schema of scene files, draft 7, for completion and checks in editors."""
    return {"$schema": DRAFT_7, "title": "gr-wiforce scene"} | json_schema(Scene)
