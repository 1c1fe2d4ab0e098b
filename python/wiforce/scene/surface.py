# SPDX-License-Identifier: GPL-3.0-or-later
"""The section ``surface`` of a scene: strips side by side under one skin."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..io.text.schema import ListOf, Mapping, declared, key
from ..io.text.values import Choice, Integer, Text
from ..surface.skin import Skin, Spreading, Strip, law_violations, read_spreading
from .simulated import MAX_SENSORS, MODEL_NAME_LENGTH, POSITION, sensor_name

if TYPE_CHECKING:
    from .schema import Scene

_LEAST_DISTANCE_MM = 0.1


@declared
class SurfaceStrip:
    """A strip of a surface."""

    sensor: str = sensor_name()
    y_mm: float = key(POSITION, doc="Position of the strip across.")
    x_mm: float = key(POSITION, default=0.0, doc="Where port 1 of the strip is along x.")
    direction: str = key(
        Choice(words=("+x", "-x")), default="+x", doc="Direction from port 1 to port 2."
    )


@declared
class Surface:
    """Sensors side by side under one skin, read together as a surface."""

    name: str = key(
        Text(limit=64), default="skin", doc="Name in the readings; differs from every sensor's."
    )
    strips: tuple[SurfaceStrip, ...] = key(
        ListOf(of=SurfaceStrip, least=2, most=MAX_SENSORS), doc="The strips, in any order."
    )
    presses: int = key(
        Integer(low=1, high=2),
        default=1,
        doc="Presses that are resolved at a time. With 2, the second one has rows of its own, "
        "named after the surface with `-2` behind.",
    )
    spreading: Spreading | None = key(
        Mapping(of=Spreading, optional=True),
        doc="How the skin spreads a press; or `spreading_file`. Without either, the strips are "
        "read, but not the surface.",
    )
    spreading_file: str | None = key(
        Text(limit=MODEL_NAME_LENGTH, optional=True),
        doc="File that `calibrate --surface` has written, relative to the scene file.",
    )

    @property
    def known(self) -> bool:
        """Whether the spreading law is known, so that the surface is read."""
        return self.spreading is not None or self.spreading_file is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its rows in the readings; none without a spreading law."""
        return (self.name, f"{self.name}-2")[: self.presses if self.known else 0]

    def law(self, folder: Path) -> Spreading:
        """The spreading law, as stated or from its file."""
        if self.spreading is not None:
            return self.spreading
        return read_spreading(folder / str(self.spreading_file))


def skin_of(scene: "Scene") -> Skin | None:
    """The surface of a scene, with its models and its spreading law; None without one of them."""
    bare = bare_skin(scene)
    if bare is None or scene.surface is None or not scene.surface.known:
        return None
    return replace(bare, spreading=scene.surface.law(scene.folder))


def bare_skin(scene: "Scene") -> Skin | None:
    """The surface of a scene with a spreading law that means nothing; None without a surface."""
    surface = scene.surface
    if surface is None:
        return None
    sensors = {sensor.name: sensor for sensor in scene.sensors}
    strips = tuple(
        Strip(
            each.sensor,
            sensors[each.sensor].load_model(scene),
            each.y_mm,
            each.x_mm,
            each.direction == "-x",
        )
        for each in sorted(surface.strips, key=lambda strip: strip.y_mm)
    )
    indices = tuple(scene.sensor_names.index(strip.sensor) for strip in strips)
    nothing: dict[str, Any] = {"law": "table", "distance_mm": (0.0, 1.0), "shares": (1.0, 0.0)}
    carrier_hz = scene.radio.center_frequency_hz
    return Skin(surface.name, strips, indices, Spreading(**nothing), carrier_hz)


def surface_violations(scene: "Scene") -> Iterator[tuple[str, str, Any] | tuple[str, str]]:
    """What contradicts itself in surface and presses: dotted key, rule and, maybe, value."""
    surface = scene.surface
    presses = scene.simulation.surface_presses
    if surface is None:
        if presses:
            yield "simulation.surface_presses", "need a surface in the scene"
        return
    if surface.name in scene.sensor_names:
        yield "surface.name", "must differ from the name of every sensor", surface.name
    if surface.presses > 1 and f"{surface.name}-2" in scene.sensor_names:
        rule = (
            f"must not be '{surface.name}' where a sensor is named '{surface.name}-2', since rows "
            f"of the second press have that name (surface.presses: {surface.presses})"
        )
        yield "surface.name", rule
    for (i, first), (j, second) in combinations(enumerate(surface.strips), 2):
        if first.sensor == second.sensor:
            rule = f"must differ from that of surface.strips[{i}]"
            yield f"surface.strips[{j}].sensor", rule, second.sensor
        if abs(first.y_mm - second.y_mm) < _LEAST_DISTANCE_MM:
            rule = f"must lie {_LEAST_DISTANCE_MM:g} mm or more from that of surface.strips[{i}]"
            yield f"surface.strips[{j}].y_mm", rule, second.y_mm
    if surface.spreading is not None and surface.spreading_file is not None:
        yield "surface.spreading_file", "must be left out where surface.spreading is given"
    folder = scene.folder
    try:
        law = surface.law(folder) if surface.known else None
    except InputError as error:
        rule = str(error)
        if not (folder / str(surface.spreading_file)).exists():
            rule += "; leave the key out until `calibrate --surface` has written the file"
        yield "surface.spreading_file", rule
        return
    skin = bare_skin(scene)
    assert skin is not None
    for rule in law_violations(skin, law) if law is not None else ():
        if surface.spreading is not None:
            yield "surface.spreading", rule
        else:
            yield "surface.spreading_file", f"{folder / str(surface.spreading_file)}: {rule}"
    low, high = skin.x_span_mm
    if low >= high:
        rule = (
            "must overlap along x; see x_mm and direction: what all of them are calibrated for "
            f"begins at x = {low:g} mm and ends at {high:g} mm"
        )
        yield "surface.strips", rule
    yield from _press_violations(scene, skin)


def _press_violations(scene: "Scene", skin: Skin) -> Iterator[tuple[str, str, Any]]:
    truths = {tag.sensor: tag.truth_model for tag in scene.simulation.tags}
    lengths = [scene.load_model(truths[strip.sensor]).length_mm for strip in skin.strips]
    for i, press in enumerate(scene.simulation.surface_presses):
        where = f"simulation.surface_presses[{i}]"
        for strip, length_mm in zip(skin.strips, lengths, strict=True):
            if not 0 <= strip.location_of(press.x_mm) <= length_mm:
                rule = f"must lie on the line of strip '{strip.sensor}'"
                yield f"{where}.x_mm", rule, press.x_mm
        low, high = skin.y_mm[0] - skin.spacing_mm, skin.y_mm[-1] + skin.spacing_mm
        if not low <= press.y_mm <= high:
            yield f"{where}.y_mm", f"must lie on the surface, {low:g} to {high:g} mm", press.y_mm
