# SPDX-License-Identifier: GPL-3.0-or-later
"""What a sounding waveform demands of the amplifier, and which tag clocks it allows."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..signal.lines import HIGHEST_LINE
from .plan import Plan

# Argument at which sinc^2 is one half.
_HALF_POWER = 0.443
# Loss of that line by averaging from which a slower clock or fewer repetitions are worth it.
_WORTHWHILE_DB = 3.0
# Repetitions whose differences show interference, and longest frames whose timing is monitored
# (lib/kernel/timing/frame_watch.h).
_LEAST_COMPARED = 2
_LONGEST_MONITORED = 131072


@dataclass(frozen=True)
class WaveformLimits:
    """Figures of a waveform.

    Attributes
    ----------
    name : str
    symbol_length : int
        In samples.
    repetitions_averaged : int
    averaging_s : float
        Time over which a snapshot averages, in s.
    subcarriers : int
        Those used.
    used_share : float
        Part of the symbol's energy that lies on them.
    bandwidth_hz : float
        From the lowest to the highest of them.
    peak_to_average_db : float
        PAPR of the analogue signal while the symbol repeats.
    clock_below_hz : float
        Nyquist: 4 fs must lie below half the snapshot rate.
    clock_half_power_hz : float
        fs at which averaging halves the power of the line at 4 fs.
    averaging_loss_db : tuple of tuple of float
        Loss of the lines at fs and 4 fs by averaging, for each sensor.
    """

    name: str
    symbol_length: int
    repetitions_averaged: int
    averaging_s: float
    subcarriers: int
    used_share: float
    bandwidth_hz: float
    peak_to_average_db: float
    clock_below_hz: float
    clock_half_power_hz: float
    averaging_loss_db: tuple[tuple[float, float], ...]


def waveform_limits(plan: Plan) -> WaveformLimits:
    """The figures of a plan's waveform."""
    waveform = plan.waveform
    low, high = waveform.outermost_hz
    return WaveformLimits(
        waveform.name,
        waveform.symbol_length,
        waveform.repetitions,
        waveform.averaging_s,
        len(waveform.subcarriers),
        waveform.used_share,
        high - low,
        waveform.peak_to_average_db,
        0.5 / waveform.snapshot_period_s / HIGHEST_LINE,
        _HALF_POWER / waveform.averaging_s / HIGHEST_LINE,
        tuple(
            (
                _loss_db(clock.clock_hz * waveform.averaging_s),
                _loss_db(HIGHEST_LINE * clock.clock_hz * waveform.averaging_s),
            )
            for clock in plan.clocks
        ),
    )


def waveform_warnings(plan: Plan) -> Iterator[str]:
    """What a plan's waveform costs or cannot do."""
    limits = waveform_limits(plan)
    losses = [tag[1] for tag in limits.averaging_loss_db]
    if losses and max(losses) >= _WORTHWHILE_DB:
        yield (
            f"a snapshot averages over {1e6 * limits.averaging_s:.4g} us, which costs "
            f"{max(losses):.1f} dB of the line at 4 fs; choose clocks below "
            f"{limits.clock_half_power_hz:.4g} Hz, or a smaller sounding.averaged_repetitions"
        )
    if limits.repetitions_averaged < _LEAST_COMPARED:
        yield (
            "only one repetition is averaged: bursts of other transmitters are not recognised, "
            "since this takes the difference of two"
        )
    if plan.waveform.frame_length > _LONGEST_MONITORED:
        yield (
            f"frames of more than {_LONGEST_MONITORED} samples: frame timing that slips without a "
            "report by the device is not recognised"
        )


def _loss_db(cycles: float) -> float:
    amplitude = max(abs(float(np.sinc(cycles))), 1e-5)
    return float(-20 * np.log10(amplitude))
