# SPDX-License-Identifier: GPL-3.0-or-later
"""Survey of the room: what the spectrum of the snapshots holds besides the tags' own lines.

The static channel and everything slow lie around zero, the tags' lines at multiples of their
clocks. Lamps, tags that the scene does not list, other readers and fast movers show up in between,
long before they disturb a reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...signal.lines import RoomNoise, aliased_hz
from ...signal.switching import line_envelope
from ...signal.waveform import Waveform
from ...wiforce_kernels import chi_squared_limit
from ..clocks.tracked_tag import TagClock
from ..groups import Array
from .clock_lines import ClockLine, find_clocks, vertex
from .sources import RoomLine, Source, identify

# Terms of the window, and its equivalent noise bandwidth in bins, n sum w^2 / (sum w)^2.
_TERMS = (0.35875, -0.48829, 0.14128, -0.01168)
ENBW = (_TERMS[0] ** 2 + sum(a**2 for a in _TERMS[1:]) / 2) / _TERMS[0] ** 2
# Half width of the window's main lobe, in bins; its side lobes are at -92 dB.
LOBE_BINS = 4.5
# A line whose surroundings hold this many times its power is not a line.
_BROAD = 1.6


def blackman_harris(count: int) -> Array:
    """The window, (count,)."""
    phase = 2 * np.pi * (np.arange(count) + 0.5) / count
    window: Array = sum(a * np.cos(i * phase) for i, a in enumerate(_TERMS))
    return window


def take_lines(frequency_hz: Array, spectrum: Array, excess: Array, count: int) -> list[RoomLine]:
    """Take lines, not broader than the window, out of a spectrum's ``excess``, strongest first."""
    lines = []
    reach = int(LOBE_BINS)
    for best in np.argsort(excess)[::-1]:
        if excess[best] <= 0 or not 0 < best < len(excess) - 1:
            continue
        if spectrum[best] < max(spectrum[best - 1], spectrum[best + 1]):
            continue  # the slope of a broader one
        lobe = slice(max(best - reach, 0), best + reach + 1)
        offset, top = vertex(spectrum, best)
        power = (top - 1) * ENBW / count
        if excess[lobe].sum() > _BROAD * power:
            continue
        frequency = (best + offset) * float(frequency_hz[1])
        lines.append(RoomLine(float(frequency), float(power)))
        excess[lobe] = 0
    return lines


# Length of the survey: 0.5 s resolve 8 Hz, longer ones smear what wanders.
LONGEST_S = 0.6
SHORTEST_S = 0.1
# A floor below this part of the static power is that of rounding and not noise: 16-bit samples
# round at 1e-10 of full scale, single precision at 1e-15.
_ROUNDING = 1e-20
# Power over the floor that noise does not reach: the mean over 62 subcarriers and both signs has a
# standard deviation of 9 %. Where the noise of subcarriers is not independent, this many standard
# deviations of a chi-squared variable.
_SIGNIFICANT = 1.6
_SIGNIFICANT_STDS = 5.6
# Lines of a tag that are expected below this part of the floor need not be masked.
_INVISIBLE = 0.1
# Side lobes of the window, and how much stronger a tag's lines may be than ideal switches make
# them.
_SIDE_LOBES = 10**-9.2
_OWN_MARGIN = 4.0
_MOST_HARMONICS = 2000
# How far a line may move after the survey, at least.
_LINE_WIDTH_HZ = 0.5


@dataclass(frozen=True, eq=False)
class Survey:
    """Doppler spectrum of a room without its static part: powers over the white noise."""

    frequency_hz: Array = field(repr=False)  # (F,), from 0 to half the snapshot rate
    spectrum: Array = field(repr=False)  # (F,), mean over the subcarriers and both signs
    # (F,), height above the floor that lines of the scene's tags may have, aliased ones too
    own: Array = field(repr=False)
    excess: Array = field(repr=False)  # (F,), per bin, what is neither noise nor one of these lines
    # What the excess outside the clutter around zero consists of, as far as it is lines.
    sources: list[Source]
    clocks: tuple[ClockLine, ...]  # line 1 of each of the scene's tags
    snapshot_period_s: float  # T
    static_power: float = 0.0  # of the static channel
    significant: float = _SIGNIFICANT  # power over the floor that noise does not reach
    subcarriers: int = 1  # K

    @property
    def line_power(self) -> Array:
        """Power of line 1 of each tag in the units of ``excess``, (S,); 0 where none stands out."""
        heights = np.array([line.height for line in self.clocks])
        return heights * ENBW / len(self.frequency_hz) / 2

    @property
    def least_power(self) -> float:
        """Power of a line from which on it stands out of the noise, in the same units."""
        return (self.significant - 1) * ENBW / len(self.frequency_hz) / 2

    @property
    def snr_db(self) -> tuple[float, ...]:
        """SNR of line 1 of each tag in a snapshot, in dB; -inf where none stands out."""
        power = self.line_power
        levels = 10 * np.log10(np.maximum(power, 1e-300))
        return tuple(np.where(power > 0, levels, -np.inf).tolist())

    @property
    def resolution_hz(self) -> float:
        """Half width of a line in the spectrum, in Hz."""
        return float(LOBE_BINS * (self.frequency_hz[1] - self.frequency_hz[0]))

    def noise(
        self,
        group_length: int,
        clutter_hz: float,
        without: Sequence[Source] = (),
        averaged: bool = True,
    ) -> RoomNoise:
        """Noise of the room beyond clutter, ``without`` some sources; ``averaged`` by weight."""
        rows = (self.excess > 0) & (self.frequency_hz > clutter_hz + self.resolution_hz)
        lines = [
            (
                line.frequency_hz,
                line.power * (self.weight(source, group_length) if averaged else 1),
                source.width_share,
            )
            for source in self.sources
            if source not in without
            for line in (*source.lines, *source.masked)
            if line.frequency_hz > clutter_hz
        ]
        frequency_hz, power, share = np.array(lines).reshape(-1, 3).T
        width_hz = np.maximum(_LINE_WIDTH_HZ, share * frequency_hz)
        return RoomNoise(
            np.concatenate(
                [self.frequency_hz[rows], frequency_hz - width_hz, frequency_hz + width_hz]
            ),
            np.concatenate([self.excess[rows], power / 2, power / 2]),
            group_length,
            self.snapshot_period_s,
        )

    def weight(self, source: Source, group_length: int) -> int:
        """How often the power of a source counts, that of white noise counting once.

        K for lamps beside the lines of the tags: their light is nearly alike on all subcarriers, so
        that the average over K leaves it. 1 otherwise: other lines may be the noise of the tag's
        own clock, and lamps on its lines fall with them.
        """
        if source.kind != "lamps":
            return 1
        clocks_hz = [line.clock_hz for line in self.clocks]
        met = source.meets(clocks_hz, group_length * self.snapshot_period_s)
        return 1 if met.any() else self.subcarriers

    def moving_hz(self) -> float:
        """Highest frequency up to which the spectrum stays above noise from zero on, in Hz."""
        above = self.spectrum - 1 > self.significant - 1 + _OWN_MARGIN * self.own
        known = np.arange(len(above)) >= int(2 * LOBE_BINS)  # behind the rest of the static part
        for source in self.sources:
            if source.kind == "line":
                continue  # perhaps of something that moves
            for line in source.lines:
                middle = round(line.frequency_hz / self.frequency_hz[1])
                known[max(0, middle - int(LOBE_BINS)) : middle + int(LOBE_BINS) + 1] = False
        above, frequency_hz = above[known], self.frequency_hz[known]
        # A gap as wide as a line ends the band.
        width = max(1, int(2 * LOBE_BINS))
        if not above[:width].any():
            return 0.0
        run = np.convolve(above, np.ones(width), "full")[: len(above)]
        gaps = np.flatnonzero(run[width - 1 :] == 0)
        return float(frequency_hz[gaps[0] if len(gaps) else -1])


def survey_channel(
    channel: Array,
    waveform: Waveform,
    clocks: Sequence[TagClock],
    mains_hz: Sequence[float],
) -> Survey | None:
    """Survey the room from the channel (n, K) of consecutive snapshots in which nothing is touched.

    Periodogram with a Blackman-Harris window (F. Harris, Proc. IEEE 66, 1978), each subcarrier over
    its own floor. None below 0.1 s, for values that are not finite, and without noise.
    """
    period_s = waveform.snapshot_period_s
    count = len(channel)
    if count * period_s < SHORTEST_S or not np.all(np.isfinite(channel)):
        return None
    window = blackman_harris(count)
    still = window @ channel / window.sum()
    # A row per subcarrier: medians of columns would take three times as long.
    changes = np.subtract(channel.T, still[:, None], order="C")
    changes *= window
    spectra = np.fft.fft(changes)
    parts = np.square(spectra.view(float), out=spectra.view(float))
    power = parts[:, ::2] + parts[:, 1::2]
    power /= np.sum(window**2)
    floor = np.median(power, axis=1) / np.log(2)
    if not np.all(floor > _ROUNDING * np.mean(np.abs(still) ** 2)) or not np.all(floor > 0):
        return None
    # Where lines fill many bins they raise the median: the floor is that of the others.
    mean = (1 / floor) @ power / len(floor)
    quiet = mean < _SIGNIFICANT * np.median(mean)
    floor = np.median(power.compress(quiet, axis=1), axis=1, overwrite_input=True) / np.log(2)
    mean = (1 / floor) @ power / len(floor)
    half = (count - 1) // 2
    spectrum = mean[: half + 1].copy()
    spectrum[1:] = (mean[1 : half + 1] + mean[: -half - 1 : -1]) / 2
    frequency_hz = np.arange(half + 1) / (count * period_s)
    found = find_clocks(frequency_hz, spectrum, clocks)
    own = _own_lines(frequency_hz, found, waveform)
    significant = _significant(spectrum, channel.shape[1])
    above = spectrum - 1 > significant - 1 + _OWN_MARGIN * own
    excess = np.where(above, spectrum - 1, 0) / count
    excess[: int(2 * LOBE_BINS)] = 0
    lines = take_lines(frequency_hz, spectrum, excess, count)
    least = (significant - 1 + _OWN_MARGIN * own) * ENBW / count
    sources = identify(lines, float(frequency_hz[1]), least, waveform, mains_hz)
    static_power = float(np.mean((still.real**2 + still.imag**2) / floor))
    return Survey(
        frequency_hz,
        spectrum,
        own,
        excess,
        sources,
        found,
        period_s,
        static_power,
        significant,
        channel.shape[1],
    )


def _significant(spectrum: Array, subcarriers: int) -> float:
    """Power over the floor that noise does not reach, by the lower half of the spectrum."""
    low, middle = np.quantile(spectrum, (0.159, 0.5))
    looks = (middle / max(middle - low, 1e-9)) ** 2
    if looks > subcarriers:
        return _SIGNIFICANT
    return max(_SIGNIFICANT, float(chi_squared_limit(looks, _SIGNIFICANT_STDS)))


def _own_lines(frequency_hz: Array, clocks: Sequence[ClockLine], waveform: Waveform) -> Array:
    """Expected height (F,) of the tags' lines above the floor."""
    step_hz = float(frequency_hz[1])
    rate = 1 / waveform.snapshot_period_s
    own = np.zeros(len(frequency_hz))
    for line in clocks:
        clock_hz, error_hz, peak = line.clock_hz, line.error_hz, line.height
        orders = np.arange(1, _MOST_HARMONICS)
        heights = peak * line_envelope(orders, clock_hz, waveform)
        visible = (heights >= _INVISIBLE) | (orders <= 4)
        orders, heights = orders[visible], heights[visible]
        center = np.abs(aliased_hz(orders * clock_hz, rate)) / step_hz
        reach = orders * error_hz / step_hz
        low = np.maximum(0, (center - reach - 3 * LOBE_BINS).astype(int))
        end = np.minimum((center + reach + 3 * LOBE_BINS).astype(int) + 1, len(own))
        # All lines in one array: short ones would take ten times as long.
        count = np.maximum(end - low, 0)
        of = np.repeat(np.arange(len(orders)), count)
        bins = np.arange(len(of)) + (low - np.cumsum(count) + count)[of]
        apart = np.maximum(np.abs(bins - center[of]) - reach[of], 0)
        shape = np.maximum(10 ** (-0.33 * apart**2), _SIDE_LOBES)
        own += np.bincount(bins, heights[of] * shape, len(own))
    return own
