# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of a radio: its device, signal and settings."""

from __future__ import annotations

import gc
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from gnuradio.wiforce.errors import InputError

# Time after which a thread that computes gives way to one that has received something. Python's
# own 5 ms are longer than the whole processing of a group.
_SWITCH_S = 0.5e-3


def shorten_pauses() -> None:
    """Leave present objects out of garbage collections, which would take a tenth of a second."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_S)


if TYPE_CHECKING:
    from gnuradio.wiforce.scene.schema import Scene, Sounding


# Time for which samples are collected, by the option --latency. Handling every packet by itself
# would cost two cores.
RECEIVE_S = {"low": 1e-3, "relaxed": 20e-3}


class Driver(NamedTuple):
    """How a radio is opened: by which module and class, and whether its delay differs each time."""

    module: str
    radio: str
    delay_differs: bool = False


# By the option --driver.
DRIVERS = {"uhd": Driver(".uhd", "UhdRadio"), "soapy": Driver(".soapy", "SoapyRadio", True)}
LOST_STATUS = 3  # of the process that used a device, when that has gone


class DeviceAbsent(InputError):
    """No such device answers now; the same request may succeed later."""


class DeviceUnusable(DeviceAbsent):
    """The driver of the device does not start to stream, and may never return."""


class DeviceLost(Exception):
    """The device sends no samples, or has stopped sending them."""

    @classmethod
    def silent(cls, silence_s: float) -> DeviceLost:
        """A device that has stopped sending for a time."""
        return cls(
            f"has sent no samples for {silence_s:g} s: check its cable and power, and the load of "
            "this machine (`live --reconnect` opens it again)"
        )


@dataclass(frozen=True)
class RadioRequest:
    """A device with its settings, None for its own, and the signal that it transmits."""

    args: str  # device arguments, of the receiver where tx_args names another transmitter
    sample_rate_hz: float
    center_frequency_hz: float
    sounding: Sounding
    amplitude: float = 0.5  # root of the mean preamble power, over full scale
    tx_gain_db: float | None = None
    rx_gain_db: float | None = None
    tx_antenna: str | None = None
    rx_antenna: str | None = None
    reference: str | None = None  # clock source: internal, external, ...
    receive_s: float = RECEIVE_S["low"]  # time for which received samples are collected
    scene_name: str = "scene"  # of its file, for messages
    driver: str = "uhd"
    bandwidth_hz: float | None = None  # of the filters in both directions
    tx_args: str | None = None
    receive_only: bool = False  # the frames are transmitted by something else
    antennas: int = 1
    aligned: bool = False  # samples must begin with a frame: of a device that was lost

    @classmethod
    def of_scene(cls, scene: Scene, args: str, **settings) -> RadioRequest:
        """The request for a scene, with what it does not state by the names of the attributes."""
        return cls(
            args,
            scene.radio.sample_rate_hz,
            scene.radio.center_frequency_hz,
            scene.sounding,
            antennas=scene.environment.receive_antennas,
            scene_name=str(scene.path or "scene"),
            **settings,
        )

    @property
    def transmitter(self) -> tuple[str, str]:
        """The option that names the device that transmits, and its arguments."""
        return ("--args", self.args) if self.tx_args is None else ("--tx-args", self.tx_args)

    @property
    def frames(self) -> dict:
        """Parameters of the blocks that make and align frames."""
        return {"waveform": self.sounding.waveform_at(self.sample_rate_hz), "item_type": "sc16"}
