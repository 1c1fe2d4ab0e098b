# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene with packets, fitted to the packets that were received."""

from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...estimation.groups import Groups
from ...estimation.packet_groups import PacketGroups
from ...estimation.separation import EndSeparator
from ...signal.packets import packet_waveform
from ...signal.timed_weights import TimedTable
from ..plan import Plan

# Clutter bands that are tried, how far they may come to a clock, and by which factor a band must
# reduce the noise: 0.1 dB.
_BANDS_HZ = (2.0, 5.0, 10.0, 20.0, 40.0, 60.0)
_HIGHEST_BAND, _WORTH_A_BAND = 0.8, 0.977
# Probability of two standard deviations being exceeded.
_EXCEEDED = 0.05
# Groups of the reference that are looked at: for the tags, and for each band.
_MOST_GROUPS, _BAND_GROUPS = 32, 6
# Groups with fewer packets than this share of the mean are no typical ones.
_FEW = 0.5


def fitted_plan(
    plan: Plan, subcarrier_hz: np.ndarray, time_s: np.ndarray, channel: np.ndarray
) -> Plan:
    """Fit a plan to the times and channels of packets.

    Returns Plan: designed for the group of the untouched reference with the median number of
    packets.

    Parameters
    ----------
    plan : Plan
        Of a scene with packets.
    subcarrier_hz : ndarray, shape (K,)
        Against the carrier.
    time_s : ndarray, shape (n,)
        Since the first packet, rising, in s.
    channel : ndarray of complex, shape (n, C K)
        C channels of each subcarrier, without an oscillator's phase.

    Raises
    ------
    InputError
        When the reference holds too few packets to read the tags.
    """
    scene = plan.require_scene()
    period_s = scene.group_period_s
    groups = int(scene.reference_s / period_s)
    bounds = np.searchsorted(time_s, np.arange(groups + 1) * period_s)
    counts = np.diff(bounds)
    usual = np.flatnonzero(counts >= _FEW * max(counts.mean(), 1))
    order = usual[np.argsort(counts[usual], kind="stable")]
    if not order.size:
        raise InputError("time_s", "must hold packets in reference_s, the untouched reference")
    typical = int(order[len(order) // 2])
    rows = slice(bounds[typical], bounds[typical + 1])
    times_s = time_s[rows] - (typical + 0.5) * period_s
    waveform = packet_waveform(
        period_s / len(times_s),
        plan.waveform.averaging_s,
        subcarrier_hz,
        channels=channel.shape[1] // len(subcarrier_hz),
    )
    changed = replace(plan, waveform=waveform, group_length=len(times_s), times_s=times_s)
    changed = changed.with_clocks(plan.clocks)
    if scene.environment.moving_clutter_hz is not None:
        return changed
    return _with_band(changed, time_s, channel)


def tag_ratios(plan: Plan, source: PacketGroups, antennas: int) -> tuple[float, ...]:
    """Amplitude of each tag in the sum of all antennas that packets are divided by.

    Returns tuple of float: of each tag; empty where a tag was not found.

    Parameters
    ----------
    plan : Plan
        Fitted to the packets.
    source : PacketGroups
        Groups of the packets, whose channels are in units of the static paths.
    antennas : int
        At least 2.

    Notes
    -----
    What the static paths' direction holds of the tag cannot be measured: it is what common phase
    and gain of a packet are. Of A directions with independent Rayleigh fading it holds t times the
    mean power of the A - 1 others or more with a probability of (1 + t / (A - 1))^(1 - A). The
    result is half the amplitude that is exceeded in 5 %, so that two standard deviations hold it.
    """
    groups = _separated(plan, source)
    known = groups.locked.all(axis=1) if len(groups) else np.zeros(0, bool)
    if not known.any():
        return ()
    ends, gain = groups.ends[known], groups.gain[known]
    noise = gain * groups.noise[known].mean(axis=1)[:, None]
    power = np.median(np.mean(np.abs(ends) ** 2, axis=2) - noise, axis=0)
    power = np.maximum(power, np.median(noise, axis=0)).reshape(-1, 2).max(axis=1)
    others = antennas - 1
    exceeded = others * (_EXCEEDED ** (-1 / others) - 1)
    return tuple((np.sqrt(exceeded * power) / 2).tolist())


def _with_band(plan: Plan, time_s: np.ndarray, channel: np.ndarray) -> Plan:
    """The plan with the clutter band that leaves the least noise in the untouched reference."""
    best, least = plan, _tone_noise(plan, time_s, channel)
    for band_hz in _BANDS_HZ:
        if band_hz > _HIGHEST_BAND * min(plan.clocks_hz):
            break
        trial = replace(plan, clutter_hz=band_hz)
        if not trial.separable:
            break
        noise = _tone_noise(trial, time_s, channel)
        if noise < _WORTH_A_BAND * least:
            best, least = trial, noise
    return best


def _tone_noise(plan: Plan, time_s: np.ndarray, channel: np.ndarray) -> float:
    """Variance of the tones by the residual of some groups of the reference."""
    table = plan.table
    assert isinstance(table, TimedTable)
    found = []
    for group in range(min(plan.reference_groups, _BAND_GROUPS)):
        bounds = np.searchsorted(time_s, np.array([group, group + 1]) * table.group_period_s)
        rows = slice(*bounds)
        times_s = time_s[rows] - (group + 0.5) * table.group_period_s
        weights = table.at(times_s)
        if weights is not None:
            gain = np.mean(np.sum(np.abs(weights.weights) ** 2, axis=1))
            found.append(gain * table.residual(times_s, channel[rows]))
    return float(np.median(found)) if found else np.inf


def _separated(plan: Plan, source: PacketGroups) -> Groups:
    """Groups of the untouched reference with their ends."""
    separator = EndSeparator(plan.table, plan.clocks, plan.waveform, derotated=False)
    groups = source.read(0, min(plan.reference_groups, _MOST_GROUPS))
    return Groups.concatenate([separator.process(groups), separator.flush()])
