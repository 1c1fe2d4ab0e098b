# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as they are compared with a force gauge, and their errors."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class TimedForces:
    """Readings of one sensor, as far as they are compared.

    ``time_s`` (n,): centres of the groups, increasing; ``force_n``, ``force_std_n`` (n,): force, 0
    while untouched, and its standard deviation; NaN where it is not known; ``touched``, ``clear``
    (n,) of bool: which groups are touched, and which have no flag.
    """

    time_s: np.ndarray
    force_n: np.ndarray
    force_std_n: np.ndarray
    touched: np.ndarray
    clear: np.ndarray

    @property
    def period_s(self) -> float:
        """Time between two readings, over which each is an average."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else float("nan")


@dataclass(frozen=True)
class GaugeComparison:
    """Errors of readings against a gauge.

    ``offset_s``, ``offset_std_s``: time of the gauge at time 0 of the readings, and its standard
    deviation (jackknife over parts of the recording); the latter 0 where the offset was given;
    ``other_offset_s``: another offset that fits nearly as well, if there is one; ``correlation``:
    of readings and gauge at this offset; ``sign``: -1 for a gauge that shows presses as negative
    forces; ``zero_n``: what the gauge shows while the sensor is untouched, which has been
    subtracted; ``time_s``, ``force_n``, ``force_std_n``, ``gauge_n`` (m,): steady touched readings
    without flag, with the mean force of the gauge over each group; ``flagged``, ``missed``,
    ``false``: steady groups in which the gauge shows a press and the reading is flagged; is clear
    but untouched; and clear touched groups in which the gauge shows none; ``unrecorded``: readings
    without flag in holes of the gauge's record.
    """

    offset_s: float
    offset_std_s: float
    other_offset_s: float | None
    correlation: float
    sign: int
    zero_n: float
    time_s: np.ndarray
    force_n: np.ndarray
    force_std_n: np.ndarray
    gauge_n: np.ndarray
    flagged: int
    missed: int
    false: int
    unrecorded: int

    @property
    def error_n(self) -> np.ndarray:
        """Reading minus gauge, in N."""
        return self.force_n - self.gauge_n

    @property
    def coverage(self) -> float:
        """Share of errors within two of the readings' standard deviations."""
        return float(np.mean(np.abs(self.error_n) <= 2 * self.force_std_n))

    @property
    def gain(self) -> float:
        """Force of the readings per force of the gauge, by least squares through zero."""
        return float(self.force_n @ self.gauge_n / (self.gauge_n @ self.gauge_n))

    def report(self) -> dict[str, Any]:
        """Plain values, rounded to what they mean."""
        error = np.abs(self.error_n)
        return {
            "offset_s": round(self.offset_s, 4),
            "offset_std_s": round(self.offset_std_s, 4),
            "other_offset_s": self.other_offset_s,
            "correlation": round(self.correlation, 4),
            "gauge_sign": self.sign,
            "gauge_zero_n": round(self.zero_n, 4),
            "compared": len(error),
            "median_error_n": round(float(np.median(error)), 4),
            "rms_error_n": round(float(np.sqrt(np.mean(error**2))), 4),
            "p90_error_n": round(float(np.quantile(error, 0.9)), 4),
            "bias_n": round(float(np.mean(self.error_n)), 4),
            "gain": round(self.gain, 4),
            "within_2_std": round(self.coverage, 4),
            "flagged": self.flagged,
            "missed": self.missed,
            "false": self.false,
            "unrecorded": self.unrecorded,
        }

    def __str__(self) -> str:
        r = self.report()
        lines = [
            f"offset          {r['offset_s']:.4f} +- {r['offset_std_s']:.4f} s (time of the "
            f"gauge at time 0 of the readings; correlation {r['correlation']:.3f})",
            f"gauge           zero {r['gauge_zero_n']:.3f} N, subtracted"
            + ("; presses are negative, sign inverted" if r["gauge_sign"] < 0 else ""),
            f"compared        {r['compared']} steady touched readings without flag",
            f"force error     median {r['median_error_n']:.3f} N, rms {r['rms_error_n']:.3f}"
            f" N, 90 % below {r['p90_error_n']:.3f} N, bias {r['bias_n']:+.3f} N",
            f"gain            {r['gain']:.3f} N read per N of the gauge",
            f"within 2 std    {r['within_2_std']:.0%} (95 % expected; the gauge's own error counts"
            " as the reading's)",
            f"not compared    {r['flagged']} flagged, {r['missed']} missed (clear, but read "
            f"as untouched), {r['false']} touched while the gauge shows no press, "
            f"{r['unrecorded']} where the gauge's record has a hole",
        ]
        if r["other_offset_s"] is not None:
            lines.append(
                f"ambiguous       an offset of {r['other_offset_s']:.2f} s fits nearly as well: "
                "the presses repeat; state the right one with --offset"
            )
        return "\n".join(lines)
