# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as streams of the Lab Streaming Layer (LSL), one per sensor."""

import math
import socket
import time
from collections.abc import Iterable, Mapping
from typing import Any

from ..optional import optional_module
from ..outputs import Output
from ..readings import flag_bits, parsed_utc

# Name, unit and kind of each channel; XDF and LabRecorder have no rules for either of the latter.
CHANNELS = (
    ("force_n", "N", "Force"),
    ("force_std_n", "N", "StandardDeviation"),
    ("location_mm", "mm", "Location"),
    ("location_std_mm", "mm", "StandardDeviation"),
    ("phase1_deg", "degrees", "Phase"),
    ("phase2_deg", "degrees", "Phase"),
    ("snr_db", "dB", "SNR"),
    ("interference", "normalized", "Interference"),
    ("touch", "none", "Touch"),
    ("flags", "none", "Flags"),
    ("group", "none", "Index"),
)
# Behind these, of a surface, whose location is x.
SURFACE_CHANNELS = (
    ("y_mm", "mm", "Location"),
    ("y_std_mm", "mm", "StandardDeviation"),
    ("cov_force_x", "N mm", "Covariance"),
    ("cov_force_y", "N mm", "Covariance"),
    ("cov_x_y", "mm^2", "Covariance"),
)
# Behind all others: the group's centre in the run, and in seconds since 1970.
TIME_CHANNELS = (("time_s", "s", "Time"), ("time_utc", "s", "Time"))
# Without this, liblsl offers its streams on all networks of the machine, and logs on standard
# error what it does.
_THIS_MACHINE = """\
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
[log]
level = -2
"""
_LINGER_S = 0.2


class LslOutlets(Output):
    """An LSL stream for each sensor: channels of 64-bit floats, NaN where unknown.

    LSL's clock is that of this machine since its start. A sample has the time of its reading's
    centre on that clock, by UTC: both clocks of the machine are compared for each reading.
    ``network`` offers the streams to other machines as well, by liblsl's own settings; ``details``
    are stored in the description of each stream; those of surfaces have more channels.
    """

    def __init__(
        self,
        sensors: Iterable[str],
        period_s: float,
        network: bool = False,
        details: Mapping[str, str] | None = None,
        surfaces: Iterable[str] = (),
    ) -> None:
        self._pylsl = optional_module("pylsl", "--lsl")
        if not network:
            self._pylsl.set_config_content(_THIS_MACHINE)
        self._channels: dict[str, tuple[tuple[str, str, str], ...]] = {
            **dict.fromkeys(sensors, CHANNELS + TIME_CHANNELS),
            **dict.fromkeys(surfaces, CHANNELS + SURFACE_CHANNELS + TIME_CHANNELS),
        }
        self._outlets = {
            name: self._outlet(name, period_s, details or {}) for name in self._channels
        }

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Send readings; the time of this call counts where ``time_utc`` is empty."""
        for row in rows:
            utc_s = parsed_utc(row["time_utc"]).timestamp() if row.get("time_utc") else None
            values = {**row, "flags": flag_bits(tuple(row["flags"].split())), "time_utc": utc_s}
            known = [values[name] for name, *_ in self._channels[row["sensor"]]]
            lsl_s = self._pylsl.local_clock()
            if utc_s is not None:
                lsl_s += utc_s - time.time()
            sample = [math.nan if value is None else float(value) for value in known]
            self._outlets[row["sensor"]].push_sample(sample, lsl_s)

    def close(self) -> None:
        """End the streams; what was just sent still has a moment to leave."""
        if any(outlet.have_consumers() for outlet in self._outlets.values()):
            time.sleep(_LINGER_S)
        self._outlets.clear()

    def _outlet(self, sensor: str, period_s: float, details: Mapping[str, str]) -> Any:
        lsl, channels = self._pylsl, self._channels[sensor]
        info = lsl.StreamInfo(
            f"gr-wiforce {sensor}",
            "Force",
            len(channels),
            1 / period_s,
            lsl.cf_double64,
            # The same after a restart, so that a recorder continues with the new stream.
            f"gr-wiforce:{socket.gethostname()}:{sensor}",
        )
        labels, units, kinds = zip(*channels, strict=True)
        info.set_channel_labels(labels)
        info.set_channel_units(units)
        info.set_channel_types(kinds)
        acquisition = info.desc().append_child("acquisition")
        for key, value in {"sensor": sensor, **details}.items():
            acquisition.append_child_value(key, value)
        return lsl.StreamOutlet(info)
