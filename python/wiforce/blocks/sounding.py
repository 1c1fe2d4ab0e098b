# SPDX-License-Identifier: GPL-3.0-or-later
"""The samples that are sent, and what a tag makes of them."""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from gnuradio import blocks, gr

from ..errors import InputError
from ..estimation.groups import Array
from ..io.capture.samples import item_type_named
from ..scene import Scene, load_scene
from ..simulation.channel import AirChannel
from .argument_types import Kept, enlarge_output_buffer, typed
from .rules import WaveformOrScene, frames_of, largest_amplitude, scene_meant


def frame_samples(frame: Array, amplitude: float, item_type: str) -> Array:
    """A frame to transmit: complex64 (n,), or int16 (n, 2); an InputError beyond full scale."""
    largest = largest_amplitude(frame)
    if not 0 < amplitude <= largest:
        raise InputError("amplitude", f"must be above 0 and at most {largest:.4f}", amplitude)
    if item_type == "fc32":
        return (amplitude * frame).astype(np.complex64)
    return np.rint(32767 * amplitude * frame.view(float)).astype(np.int16).reshape(-1, 2)


class sounding_source(gr.hier_block2):
    """Transmit samples: preamble and guard zeros, repeated indefinitely.

    Output: complex samples, or pairs of 16-bit integers (full scale 32767) for ``sc16``. The
    first sample is the first of a frame.

    Parameters
    ----------
    waveform : str, Path, Waveform or Scene
        A shipped waveform's name, or the ``.npy`` file of a symbol. A Waveform or a scene (its
        ``.yaml`` file, or the ID of a Scene block) states its own frame length, rate and symbol.
    frame_length : int
        Samples per frame, at least those of the preamble.
    sample_rate : float
        In samples per second.
    amplitude : float
        Root of the mean preamble power, above 0 and such that no component exceeds full scale.
    item_type : str
        ``fc32`` or ``sc16``.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> source = sounding_source("repeated", frame_length=720, amplitude=0.5)
    >>> source.set_amplitude(0.3)
    """

    @typed
    def __init__(
        self,
        waveform: WaveformOrScene = "repeated",
        frame_length: int = 720,
        sample_rate: float = 12.5e6,
        amplitude: float = 0.5,
        item_type: str = "fc32",
        symbol_length: int = 0,
        repetitions: int = 0,
        averaged_repetitions: int = 0,
    ) -> None:
        size = item_type_named(item_type).sample_bytes
        self._frame = frames_of(
            waveform, frame_length, sample_rate, symbol_length, repetitions, averaged_repetitions
        ).frame()
        self._item_type = item_type
        data = self._data(amplitude)
        gr.hier_block2.__init__(
            self, "sounding_source", gr.io_signature(0, 0, 0), gr.io_signature(1, 1, size)
        )
        if item_type == "fc32":
            self._source = blocks.vector_source_c(data, True)
        else:
            self._source = blocks.vector_source_s(data, True, 2)
        self.connect(self._source, self)

    @typed
    def set_amplitude(self, amplitude: float) -> None:
        """Change the amplitude while running."""
        self._source.set_data(self._data(amplitude))

    def _data(self, amplitude: float) -> list[Any]:
        return frame_samples(self._frame, amplitude, self._item_type).ravel().tolist()


# The tag is pressed by calls, and rounding is the receiver's part.
_WITHOUT_EFFECT = ("presses", "truth_model", "adc_bits")
_WORK_ITEMS = 16384  # as many samples at once as keep the cost of a call small


class backscatter_tag(Kept, gr.sync_block):
    """Adds the reflection of a pressed sensor, and noise, to the samples that pass.

    Input: complex transmit samples, as they are or behind a channel (of stock blocks, say).
    Output: input + tag + noise. The tag's clock runs free, its switches are exact to a fraction of
    a sample, and its phases are those of a sensor model at the force and location that are set.

    Parameters
    ----------
    model : str
        Name of a shipped sensor, or path of a sensor file.
    clock_hz : float
        Clock of the tag, fs; 4 fs below half the frame rate.
    clock_offset_ppm : float
        Error of the tag's clock; positive when it is fast.
    force_n : float
        0 or more; the line is touched from the model's ``onset_force_n`` on.
    location_mm : float
        From port 1, on the line.
    snr_db : float
        |c1[1] G1|^2 against the noise, per subcarrier and snapshot.
    static_clutter_db : float
        Power of the input against that of the tag's line, |c1[1] G1|^2.
    amplitude : float
        Root of the mean preamble power of the input, as set in ``sounding_source``.
    off_reflection : complex
        G_off / rho of the open switches, below 1 in magnitude.
    center_frequency, sample_rate : float
        In Hz and samples per second.
    waveform : str or Scene
        As of ``sounding_source``: what ``snr_db`` counts for.
    frame_length : int
        Samples per frame.
    seed : int
        Of the noise and of the clock's start phase.
    effects : dict, optional
        Further keys of a scene's ``simulation``, for rooms and components that are not ideal, such
        as ``{"bursts": {"share": 0.2}, "tags": [{"clock_jitter_s": 3e-7}]}``.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> tag = backscatter_tag("line-900mhz", clock_hz=1000.0)
    >>> tag.set_force_n(4.0)
    >>> tag.force_n()
    4.0
    """

    @typed
    def __init__(
        self,
        model: str = "line-900mhz",
        clock_hz: float = 1000.0,
        clock_offset_ppm: float = 40.0,
        force_n: float = 0.0,
        location_mm: float = 40.0,
        snr_db: float = 10.0,
        static_clutter_db: float = 60.0,
        amplitude: float = 0.5,
        off_reflection: complex = 0j,
        center_frequency: float = 900e6,
        sample_rate: float = 12.5e6,
        waveform: str | Scene = "repeated",
        frame_length: int = 720,
        seed: int = 1,
        effects: dict[str, Any] | None = None,
        symbol_length: int = 0,
        repetitions: int = 0,
        averaged_repetitions: int = 0,
    ) -> None:
        if not (np.isfinite(amplitude) and amplitude > 0):
            raise InputError("amplitude", "must be above 0", amplitude)
        off = complex(off_reflection)
        stated = {
            "duration_s": 1e6,
            "clock_offset_ppm": clock_offset_ppm,
            "clock_drift_ppm_per_s": 0.0,
            "static_clutter_db": static_clutter_db,
            "snr_db": snr_db,
            "seed": seed,
        }
        twice = sorted({*stated, *_WITHOUT_EFFECT} & {*(effects or {})})
        if twice:
            rule = f"must not hold what the block itself sets ({', '.join(twice)})"
            raise InputError("effects", rule)
        meant = scene_meant(waveform)
        sounding = {
            "waveform": waveform,
            "frame_length": int(frame_length),
            "symbol_length": symbol_length or None,
            "repetitions": repetitions or None,
            "averaged_repetitions": averaged_repetitions or None,
        }
        scene = load_scene(
            {
                "radio": {"center_frequency_hz": center_frequency, "sample_rate_hz": sample_rate},
                "sounding": meant.as_dict()["sounding"] if meant else sounding,
                "sensors": [
                    {
                        "name": "tag",
                        "model": model,
                        "clock_hz": clock_hz,
                        "off_reflection": [off.real, off.imag],
                    }
                ],
                "simulation": stated | (effects or {}),
            }
        )
        gr.sync_block.__init__(self, "backscatter_tag", [np.complex64], [np.complex64])
        self._length_mm = scene.load_model(model).length_mm
        self._rate = scene.radio.sample_rate_hz
        self._air = AirChannel(scene, amplitude, through=True)
        self._tag = self._air.sensors["tag"]
        self._changes: deque[Callable[[float], None]] = deque()
        self._force_n, self._location_mm = 0.0, 0.0
        self.set_location_mm(location_mm)
        self.set_force_n(force_n)
        enlarge_output_buffer(self, 4 * _WORK_ITEMS)

    @typed
    def set_force_n(self, force_n: float) -> None:
        """Press with this force from now on."""
        self._force_n = _checked("force_n", force_n, 0, 1000)
        self._press()

    @typed
    def set_location_mm(self, location_mm: float) -> None:
        """Press here from now on."""
        self._location_mm = _checked("location_mm", location_mm, 0, self._length_mm)
        self._press()

    @typed
    def set_clock_offset_ppm(self, offset_ppm: float) -> None:
        """Change the rate of the tag's clock; its phase stays continuous."""
        offset_ppm = _checked("clock_offset_ppm", offset_ppm, -20_000, 20_000)
        self._changes.append(lambda now_s: self._tag.clock.retune(now_s, offset_ppm))

    @typed
    def set_snr_db(self, snr_db: float) -> None:
        """Change the noise; the tag stays as strong as it is."""
        snr_db = _checked("snr_db", snr_db, -100, 140)
        self._changes.append(lambda now_s: self._air.set_snr_db(snr_db))

    @typed
    def set_on(self, on: bool) -> None:
        """Take the tag off the air, or put it back."""
        self._tag.on = bool(on)

    def force_n(self) -> float:
        """Force that is set, in N."""
        return self._force_n

    def location_mm(self) -> float:
        """Location that is set, in mm from port 1."""
        return self._location_mm

    def _press(self) -> None:
        self._tag.pressed.hold(self._force_n, self._location_mm)

    def start(self) -> bool:
        self._air.restart(self.nitems_read(0))
        return super().start()

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        first = self.nitems_read(0)
        while self._changes:  # set by other threads, applied between two calls
            self._changes.popleft()(first / self._rate)
        output_items[0][:] = self._air.process(input_items[0], first)
        return len(output_items[0])


def _checked(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise InputError(name, f"must be from {low:g} to {high:g}", value)
    return float(value)
