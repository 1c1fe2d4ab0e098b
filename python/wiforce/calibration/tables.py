# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration tables: phases of known presses, of a VNA, Touchstone files, taps or a model."""

import io
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.optional import optional_module
from ..io.text.textfile import (
    cell_number,
    read_bytes,
    read_csv,
    refuse_pipe,
    require_columns,
    write_text,
)
from ..sensor.model import SensorModel
from ..signal.carrier import CARRIERS_HZ, same_carrier

# A two-port file with 100 000 frequencies.
_MAX_TOUCHSTONE_BYTES = 8_000_000
_VNA_COLUMNS = ("freq_mhz", "location_mm", "port", "force_n", "phase_deg")


@dataclass(frozen=True)
class CalibrationTable:
    """Phases of known presses, one port per row; all arrays of shape (n,).

    Attributes
    ----------
    source : str
        File it came from, for messages and provenance.
    row : ndarray of int
        Line in that file, the header being line 1.
    frequency_hz, location_mm, force_n, phase_deg : ndarray of float
        Untouched rows have force 0 and location NaN.
    port : ndarray of int
        1 or 2.
    press : ndarray of str
        The press that a row belongs to, from the column ``press`` or ``trial``; otherwise empty.

    Examples
    --------
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> from gnuradio.wiforce.calibration.tables import measure_vna
    >>> table = measure_vna(load_sensor("line-900mhz"), [40.0], [2.0], untouched_sweeps=1)
    >>> table.port.tolist(), table.force_n.tolist(), table.untouched.tolist()
    ([1, 2, 1, 2], [0.0, 0.0, 2.0, 2.0], [True, True, False, False])
    """

    source: str
    row: np.ndarray
    frequency_hz: np.ndarray
    location_mm: np.ndarray
    port: np.ndarray
    force_n: np.ndarray
    phase_deg: np.ndarray
    press: np.ndarray

    @classmethod
    def from_rows(cls, source: object, rows: Iterable[tuple]) -> "CalibrationTable":
        """Build a table from tuples of its columns' values, ``row`` to ``press``."""
        columns = list(zip(*rows, strict=True))
        kinds = (int, float, float, int, float, float, str)
        arrays: list[Any] = [np.array(c, kind) for c, kind in zip(columns, kinds, strict=True)]
        return cls(str(source), *arrays)

    @classmethod
    def joined(cls, parts: Sequence["CalibrationTable"]) -> "CalibrationTable":
        """The rows of several tables, of the first one's source."""
        names = [f.name for f in fields(cls) if f.name != "source"]
        columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
        return cls(parts[0].source, *columns)

    def take(self, which: np.ndarray) -> "CalibrationTable":
        """The rows selected by a boolean or index array."""
        arrays = {f.name: getattr(self, f.name)[which] for f in fields(self) if f.name != "source"}
        return replace(self, **arrays)

    def at(self, index: int) -> str:
        """Name of one row, for messages."""
        return f"{self.source}: row {self.row[index]}"

    @property
    def untouched(self) -> np.ndarray:
        """Whether each row is of the untouched sensor; bool (n,)."""
        return (self.force_n == 0) & np.isnan(self.location_mm)


def read_vna_csv(path: str | Path, frequency_hz: float | None = None) -> CalibrationTable:
    """Read a VNA calibration.

    Columns ``freq_mhz, location_mm, port, force_n, phase_deg``; rows with force 0 and no location
    are the untouched sensor. A column ``press`` or ``trial`` distinguishes presses; other columns
    are ignored.

    Parameters
    ----------
    path : str or Path
        CSV file.
    frequency_hz : float, optional
        Carrier in Hz. Required where the file has no ``freq_mhz``; otherwise only rows at this
        carrier are read.

    Returns
    -------
    CalibrationTable

    Raises
    ------
    InputError
        Naming file, row, rule and value.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "vna.csv"
    >>> _ = path.write_text("location_mm,port,force_n,phase_deg\\n40,1,2.5,-100\\n40,2,2.5,-110\\n")
    >>> read_vna_csv(path, frequency_hz=900e6).phase_deg.tolist()
    [-100.0, -110.0]
    """
    needed = _VNA_COLUMNS[1:] if frequency_hz is not None else _VNA_COLUMNS

    def measured(line: Mapping[str, Any], where: str) -> _Phases:
        frequency = frequency_hz
        if "freq_mhz" in line:
            frequency = 1e6 * cell_number(line, "freq_mhz", where, largest=CARRIERS_HZ[1])
        port = cell_number(line, "port", where)
        if port not in (1, 2):
            raise InputError(f"{where}: port", "must be 1 or 2", line["port"])
        return [(frequency, int(port), cell_number(line, "phase_deg", where))]

    table = _read(path, needed, measured)
    if frequency_hz is None:
        return table
    own = same_carrier(table.frequency_hz, frequency_hz)
    if not own.any():
        listed = ", ".join(f"{carrier / 1e6:g}" for carrier in np.unique(table.frequency_hz))
        rule = f"has rows at {listed} MHz, and none at the carrier"
        raise InputError(path, rule, f"{frequency_hz / 1e6:g} MHz")
    return table.take(own)


def read_tap_csv(path: str | Path, frequency_hz: float) -> CalibrationTable:
    """Read wireless taps of known force and location.

    Columns ``phase1_deg, phase2_deg, force_n, location_mm``, as in a readings file whose force and
    location were replaced by those of a load cell and a ruler. A column ``press`` or ``trial``
    distinguishes presses; rows with force 0 and no location are the untouched sensor.

    Parameters
    ----------
    path : str or Path
        CSV file.
    frequency_hz : float
        Carrier, in Hz.

    Returns
    -------
    CalibrationTable

    Raises
    ------
    InputError
        Naming file, row, rule and value.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "taps.csv"
    >>> _ = path.write_text("phase1_deg,phase2_deg,force_n,location_mm\\n-100,-110,2.5,40\\n")
    >>> table = read_tap_csv(path, 900e6)
    >>> table.port.tolist(), table.phase_deg.tolist()
    ([1, 2], [-100.0, -110.0])
    """

    def measured(line: Mapping[str, Any], where: str) -> _Phases:
        return [
            (frequency_hz, port, cell_number(line, f"phase{port}_deg", where)) for port in (1, 2)
        ]

    return _read(path, ("phase1_deg", "phase2_deg", "force_n", "location_mm"), measured)


def read_touchstone_index(path: str | Path, frequency_hz: float) -> CalibrationTable:
    """Read Touchstone ``.s2p`` files listed in an index CSV of ``file, force_n, location_mm``.

    The phases are those of the reflection at port 1 and port 2 with the other port open, as the tag
    leaves it: S11 + S12 S21 / (1 - S22) at port 1, interpolated to the carrier. Sweeps of one port
    that were joined to a file with zeros as transmission were measured so. File names are relative
    to the index file's folder. Rows with force 0 and no location are the untouched sensor.

    Parameters
    ----------
    path : str or Path
        CSV file.
    frequency_hz : float
        Carrier, in Hz.

    Returns
    -------
    CalibrationTable

    Raises
    ------
    InputError
        Naming file, row, rule and value; also for a carrier outside a file's span.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> lines = ["# MHz S MA R 50", "800 1 170 0 0 0 0 1 150", "1000 1 150 0 0 0 0 1 130"]
    >>> _ = (folder / "press.s2p").write_text("\\n".join(lines))
    >>> _ = (folder / "index.csv").write_text("file,force_n,location_mm\\npress.s2p,2.5,40\\n")
    >>> read_touchstone_index(folder / "index.csv", 900e6).phase_deg.round(6).tolist()
    [160.0, 140.0]
    """

    def measured(line: Mapping[str, Any], where: str) -> _Phases:
        name = line["file"] or ""
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(f"{where}: file", "must lie in the index's folder", name)
        phases = _touchstone_phases(Path(path).parent / name, frequency_hz, f"{where}: file")
        return [(frequency_hz, port, phase) for port, phase in enumerate(phases, 1)]

    return _read(path, ("file", "force_n", "location_mm"), measured)


def _touchstone_phases(path: Path, frequency_hz: float, where: str) -> list[float]:
    """Phases (deg) at the carrier of the reflection at each port, with the other port open."""
    skrf = optional_module("skrf", where.removesuffix(": file"))
    try:
        text = read_bytes(path, _MAX_TOUCHSTONE_BYTES)
    except InputError as error:
        raise InputError(where, str(error)) from None
    try:
        named = io.StringIO(text.decode("latin-1"))
        named.name = path.name  # its suffix tells the number of ports
        network = skrf.Network()
        # Values that are not finite or not in order are rejected below.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            network.read_touchstone(named)  # by name, Network would try to unpickle the file
        low, high = network.f[0], network.f[-1]
    except Exception as error:
        # scikit-rf's parser raises exceptions of many types.
        raise InputError(where, "is not a Touchstone file", str(path)) from error
    if network.nports != 2:
        raise InputError(where, "must have two ports", network.nports)
    if not np.all(np.diff(network.f) > 0):
        raise InputError(where, "must hold frequencies that rise", path.name)
    if not low <= frequency_hz <= high:
        rule = f"{path.name} must span the carrier {frequency_hz / 1e6:g} MHz"
        raise InputError(where, rule, f"{low / 1e6:g}..{high / 1e6:g} MHz")
    reflection = network.s[:, [0, 1], [0, 1]]
    through = (network.s[:, 0, 1] * network.s[:, 1, 0])[:, None]
    with np.errstate(all="ignore"):  # what is not finite is rejected below
        opened = np.where(through != 0, through / (1 - reflection[:, ::-1]), 0)
        angles = np.rad2deg(np.unwrap(np.angle(reflection + opened), axis=0))
    phases = [float(np.interp(frequency_hz, network.f, angle)) for angle in angles.T]
    if not np.all(np.isfinite(phases)):
        raise InputError(where, "must hold finite numbers", path.name)
    return phases


def table_kind(path: str | Path) -> str:
    """Kind of a table by its columns: ``vna``, ``touchstone`` or ``taps``; refuses a pipe.

    A pipe would be empty when the table is read.
    """
    refuse_pipe(path)
    header, _ = read_csv(path)
    if "file" in header:
        return "touchstone"
    return "taps" if "phase1_deg" in header else "vna"


def write_vna_csv(table: CalibrationTable, path: str | Path) -> None:
    """Write a table as VNA calibration CSV."""
    columns = table.location_mm, table.port, table.force_n, table.phase_deg
    lines = [",".join(_VNA_COLUMNS)]
    for hertz, location, port, force, phase in zip(table.frequency_hz, *columns, strict=True):
        place = "" if math.isnan(location) else f"{location:g}"
        lines.append(f"{hertz / 1e6:.10g},{place},{port},{force:g},{phase:.4f}")
    write_text(path, "\n".join([*lines, ""]))


# Carrier in Hz, port and phase in degrees of what a line states.
_Phases = list[tuple[float | None, int, float]]


def _read(
    path: str | Path,
    needed: Sequence[str],
    measured: Callable[[Mapping[str, Any], str], _Phases],
) -> CalibrationTable:
    """The table of a CSV file, of whose lines ``measured`` gives the phases."""
    header, lines = read_csv(path)
    only_carrier = set(needed) - set(header) == {"freq_mhz"}
    require_columns(path, header, needed, "or give --frequency-hz" if only_carrier else "")
    rows = []
    for number, line in lines:
        where = f"{path}: row {number}"
        force = cell_number(line, "force_n", where, empty=0.0)
        location = cell_number(line, "location_mm", where, empty=math.nan)
        if math.isnan(location) and force != 0:
            raise InputError(f"{where}: location_mm", "must be given where force_n is not 0", force)
        location = location if force else math.nan
        press = (line.get("press") or line.get("trial") or "").strip()
        for frequency, port, phase in measured(line, where):
            rows.append((number, frequency, location, port, force, phase, press))
    return CalibrationTable.from_rows(path, rows)


def measure_vna(
    model: SensorModel,
    location_mm: Sequence[float] | np.ndarray,
    force_n: Sequence[float] | np.ndarray,
    noise_deg: float = 0.0,
    seed: int = 1,
    untouched_sweeps: int = 10,
) -> CalibrationTable:
    """Simulate the table that a VNA would measure.

    Parameters
    ----------
    model : SensorModel
        The sensor on the bench.
    location_mm, force_n : sequence of float
        Every force in N at every location in mm; untouched rows come first.
    noise_deg : float
        Standard deviation of the phases, in degrees.
    seed : int
        Of the noise.
    untouched_sweeps : int
        Rows of the untouched sensor per port; their noise is common to all readings.

    Returns
    -------
    CalibrationTable

    Examples
    --------
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> table = measure_vna(load_sensor("line-900mhz"), [30.0, 50.0], [1.0, 2.0, 4.0])
    >>> len(table.row)  # 2 ports: 10 untouched rows and 2 x 3 presses
    32
    """
    rng = np.random.default_rng(seed)
    rows: list[tuple] = []
    for frequency in model.frequencies_hz:
        for port, phase in enumerate(model.untouched_deg(frequency), 1):
            rows += [(0, frequency, math.nan, port, 0.0, phase, "")] * untouched_sweeps
        for location in location_mm:
            phases = model.phases_deg(force_n, location, frequency)
            for port in (1, 2):
                for force, phase in zip(force_n, phases[:, port - 1], strict=True):
                    rows.append((0, frequency, location, port, force, phase, ""))
    table = CalibrationTable.from_rows(f"evaluated {model.name}", rows)
    noisy = table.phase_deg + noise_deg * rng.standard_normal(table.phase_deg.size)
    return replace(table, row=np.arange(2, table.row.size + 2), phase_deg=noisy)
