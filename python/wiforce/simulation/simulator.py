# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: the received samples of a scene as SigMF, with the truth beside them."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, unwritable
from ..io.capture.names import recording_stem, second_antenna
from ..io.capture.samples import DATATYPES, samples_of
from ..io.capture.sigmf_metadata import write_metadata
from ..io.text.textfile import check_output
from ..scene import Scene, load_scene
from .channel import AirChannel
from .packets import write_packets
from .radio import Adc
from .truth import all_or_nothing, frame_count, write_truth

# Of a capture of samples, and of one of packets.
_SUFFIXES = ((".sigmf-data", ".truth.csv", ".sigmf-meta"), (".npz", ".truth.csv"))
_FRAMES_AT_ONCE = 500


def simulate(
    scene: str | Path | dict[str, Any] | Scene,
    name: str | Path,
    datatype: str = "ci16_le",
    progress: Callable[[int], object] | None = None,
    overwrite: bool = False,
    replaced_by: str = "overwrite=True",
) -> list[Path]:
    """Write the capture of a scene, or its channel snapshots: see ``wiforce.simulate``.

    ``replaced_by`` is what a refusal says replaces files.
    """
    if datatype not in DATATYPES:
        raise InputError("datatype", f"must be one of {', '.join(DATATYPES)}", datatype)
    scene = load_scene(scene)
    packets = scene.packets is not None
    suffixes = _SUFFIXES[packets]
    stem = recording_stem(os.fspath(name).removesuffix(".npz") if packets else name, "NAME")
    antennas = 1 if packets else scene.environment.receive_antennas
    stems = [stem, second_antenna(stem)][:antennas]
    paths = [Path(f"{each}{suffix}") for each in stems for suffix in suffixes]
    for path in paths:
        check_output(path, scene.files)
        if path.exists() and not overwrite:
            raise InputError(path, f"exists already; {replaced_by} replaces it")
    try:
        with all_or_nothing(paths) as temporary:
            for antenna in range(antennas):
                data, truth = temporary[antenna * len(suffixes) :][:2]
                write_truth(scene, truth)
                if packets:
                    write_packets(scene, data, paths[0], progress)
                    continue
                channel = AirChannel(scene, antenna=antenna)
                with open(data, "wb") as stream:
                    for samples in capture(scene, channel, datatype):
                        stream.write(samples.data)
                        if progress is not None:
                            progress(samples.size // (2 if datatype == "ci16_le" else 1))
                _write_metadata(scene, datatype, data, paths[0])
    except OSError as error:
        raise unwritable(stem, error) from error
    return paths


def capture(scene: Scene, channel: AirChannel, datatype: str) -> Iterator[np.ndarray]:
    """The samples of a capture in pieces: int16 (2 n,), I and Q in turn, or complex64 (n,)."""
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


def _write_metadata(scene: Scene, datatype: str, data: Path, beside: Path) -> None:
    from .._config import VERSION

    fields = {
        "core:datatype": datatype,
        "core:sample_rate": scene.radio.sample_rate_hz,
        "core:num_channels": 1,
        "core:offset": 0,
        "core:description": "Simulated WiForce capture",
        "core:recorder": f"gr-wiforce {VERSION}",
        "core:extensions": [{"name": "wiforce", "version": VERSION, "optional": True}],
        "wiforce:scene": scene.as_dict(beside),
        "wiforce:samples": frame_count(scene) * scene.sounding.frame_length,
        "wiforce:seed": scene.simulation.seed,
    }
    capture = {"core:sample_start": 0, "core:frequency": scene.radio.center_frequency_hz}
    write_metadata(data.with_suffix(".sigmf-meta"), data, fields, [capture])
