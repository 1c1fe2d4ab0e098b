# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: the received samples of a scene as SigMF, with the truth beside them."""

import csv
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, unwritable
from ..io.capture import second_antenna
from ..io.samples import DATATYPES, samples_of
from .adc import Adc
from .channel import AirChannel

if TYPE_CHECKING:
    from ..scene import Scene

TRUTH_COLUMNS = (
    "time_s", "sensor", "touch", "force_n", "location_mm", "phase1_deg", "phase2_deg",
)  # fmt: skip
_SUFFIXES = (".sigmf-data", ".truth.csv", ".sigmf-meta")
_FRAMES_AT_ONCE = 500


def simulate(
    scene: "Scene",
    name: str | Path,
    datatype: str = "ci16_le",
    progress: Callable[[int], object] | None = None,
) -> list[Path]:
    """Write the capture of a scene and its truth, for each receive antenna.

    The files ``NAME.sigmf-data``, ``NAME.sigmf-meta`` and ``NAME.truth.csv``, and those of
    :func:`second_antenna`, appear when all are complete; on failure nothing is left.

    Parameters
    ----------
    scene : Scene
    name : str or Path
        Path of the capture without suffix.
    datatype : str
        ``ci16_le``: ADC codes, left-justified. ``cf32_le``: the same divided by 32768.
    progress : callable, optional
        Called with the number of samples written since the last call.

    Returns
    -------
    list of Path
        Data, truth, metadata, antenna by antenna.

    Raises
    ------
    InputError
        For an unknown datatype, or files that cannot be written.
    OutputError
        When the disk is full.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = {
    ...     "sensors": [{"name": "arm", "model": "line-900mhz-calibrated"}],
    ...     "simulation": {"truth_model": "line-900mhz", "duration_s": 0.04},
    ... }
    >>> [path.name for path in simulate(load_scene(scene), "short")]
    ['short.sigmf-data', 'short.truth.csv', 'short.sigmf-meta']
    """
    if datatype not in DATATYPES:
        raise InputError("datatype", f"must be one of {', '.join(DATATYPES)}", datatype)
    if not Path(name).name or str(name).endswith("/"):
        raise InputError("NAME", "must be a file name without suffix", str(name))
    names = [name, second_antenna(name)][: scene.environment.receive_antennas]
    paths = [Path(f"{name}{suffix}") for name in names for suffix in _SUFFIXES]
    channels = [AirChannel(scene, antenna=antenna) for antenna in range(len(names))]
    try:
        with _all_or_nothing(paths) as temporary:
            for antenna, channel in enumerate(channels):
                data, truth, meta = temporary[antenna * len(_SUFFIXES) :][: len(_SUFFIXES)]
                _write_capture(scene, channel, datatype, data, truth, meta, progress)
    except OSError as error:
        raise unwritable(name, error) from error
    return paths


def _write_capture(
    scene: "Scene",
    channel: AirChannel,
    datatype: str,
    data: Path,
    truth: Path,
    meta: Path,
    progress: Callable[[int], object] | None,
) -> None:
    with open(data, "wb") as stream:
        for samples in capture(scene, channel, datatype):
            stream.write(samples.data)
            if progress is not None:
                progress(samples.size // (2 if datatype == "ci16_le" else 1))
    write_truth(scene, channel, truth)
    _write_metadata(scene, datatype, data, meta)


def frame_count(scene: "Scene") -> int:
    """Number of whole sounding frames in the scene's duration.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    int

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("demo")
    >>> frame_count(scene) == int(scene.simulation.duration_s / 57.6e-6 + 1e-9)
    True
    """
    return int(scene.simulation.duration_s / scene.snapshot_period_s + 1e-9)


def capture(scene: "Scene", channel: AirChannel, datatype: str) -> Iterator[np.ndarray]:
    """The samples of a scene's capture, in pieces.

    Parameters
    ----------
    scene : Scene
    channel : AirChannel
        That of the scene, at its first sample.
    datatype : str
        As for :func:`simulate`.

    Yields
    ------
    ndarray of int16, shape (2 n,), or of complex64, shape (n,)
        For ``ci16_le`` I and Q in turn.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("demo")
    >>> next(capture(scene, AirChannel(scene), "ci16_le")).dtype.name
    'int16'
    """
    sent = np.tile(scene.waveform().frame().astype(np.complex64), _FRAMES_AT_ONCE)
    adc = Adc(scene.simulation.adc_bits)
    total = frame_count(scene) * scene.sounding.frame_length
    for first in range(0, total, len(sent)):
        received = channel.process(sent[: total - first], first)
        if datatype == "ci16_le":
            yield adc.codes(received).astype("<i2", copy=False)
        elif scene.simulation.adc_bits is None:
            yield received.astype("<c8", copy=False)
        else:
            yield samples_of(adc.codes(received))


def group_centers(scene: "Scene") -> np.ndarray:
    """Centres of the whole phase groups of a scene's capture.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    ndarray of float, shape (groups,)
        In s from the first sample.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> group_centers(load_scene("demo"))[:2].round(3)
    array([0.018, 0.054])
    """
    groups = frame_count(scene) // scene.phase_group.snapshots
    return (np.arange(groups) + 0.5) * scene.group_samples / scene.radio.sample_rate_hz


def write_truth(scene: "Scene", channel: AirChannel, path: str | Path) -> None:
    """Write the state at the centre of each phase group as CSV, a row per group and sensor.

    ``force_n`` is the force on the sensor even where it is too small to short the line (``touch``
    0); ``location_mm`` is empty where nothing presses.

    Parameters
    ----------
    scene : Scene
    channel : AirChannel
        That of the scene.
    path : str or Path

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("demo")
    >>> write_truth(scene, AirChannel(scene), "demo.truth.csv")
    >>> Path("demo.truth.csv").read_text().splitlines()[0]
    'time_s,sensor,touch,force_n,location_mm,phase1_deg,phase2_deg'
    """
    times = group_centers(scene)
    states = channel.touch_state(times)
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS)
        for i, time_s in enumerate(times):
            for name, state in states.items():
                location = state.location_mm[i]
                writer.writerow(
                    [
                        f"{time_s:.9g}",
                        name,
                        int(state.touch[i]),
                        f"{state.force_n[i]:.6g}",
                        "" if np.isnan(location) else f"{location:.6g}",
                        *(f"{phase:.6f}" for phase in state.phases_deg[i]),
                    ]
                )


def _write_metadata(scene: "Scene", datatype: str, data: Path, path: Path) -> None:
    from sigmf import SigMFFile

    from .._config import VERSION

    meta = SigMFFile(
        global_info={
            "core:datatype": datatype,
            "core:sample_rate": scene.radio.sample_rate_hz,
            "core:num_channels": 1,
            "core:description": "Simulated WiForce capture",
            "core:recorder": f"gr-wiforce {VERSION}",
            "core:extensions": [{"name": "wiforce", "version": VERSION, "optional": True}],
            "wiforce:scene": scene.as_dict(),
            "wiforce:seed": scene.simulation.seed,
        }
    )
    meta.add_capture(0, metadata={"core:frequency": scene.radio.center_frequency_hz})
    meta.set_data_file(data)
    with open(path, "w", encoding="utf-8") as stream:
        meta.dump(stream, pretty=True)


@contextmanager
def _all_or_nothing(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Paths in a temporary folder beside ``paths``; moved there in order after success."""
    with tempfile.TemporaryDirectory(prefix=".simulate-", dir=paths[0].parent) as folder:
        temporary = [Path(folder) / path.name for path in paths]
        yield temporary
        for source, target in zip(temporary, paths, strict=True):
            os.replace(source, target)
