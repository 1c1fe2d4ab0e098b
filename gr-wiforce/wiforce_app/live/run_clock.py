# SPDX-License-Identifier: GPL-3.0-or-later
"""UTC of the time of a live run."""


class RunClock:
    """UTC of the time of a run, by the latest comparison of the clocks.

    ``uncertainty_s``: of the offset; None before there is one.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self.uncertainty_s: float | None = None

    def take(self, offset_s: float, uncertainty_s: float) -> None:
        """Use another offset of UTC from the device's clock."""
        self._offset_s, self.uncertainty_s = offset_s, uncertainty_s

    def utc_s(self, device_s: float | None) -> float | None:
        """UTC at a device time, in seconds since 1970; None when unknown."""
        if device_s is None or self._offset_s is None:
            return None
        return device_s + self._offset_s
