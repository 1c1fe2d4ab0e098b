# SPDX-License-Identifier: GPL-3.0-or-later
"""Which switching clocks keep every end readable: frequencies, duty cycles, lines, collisions.

A switch is given by its *pulses*: on-intervals in cycles of the tag's clock fs. An end is readable
when its switching waveform, as snapshots see it, cannot be made up of the other ends' waveforms
and of what moves slowly; how well, says its information q in the Cramer-Rao bound var(phi) =
1 / (2 gamma K N q).
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..errors import InputError
from ..estimation.likelihood import PHASE_MARGIN, phase_margin
from ..signal.weights import clutter_basis

# An end that loses more than this to its neighbours, or to aliases, is not readable.
WORST_LOSS_DB = 3.0
# Lines weaker than this against the strongest of their end are not listed.
_WEAKEST_LINE_DB = -20.0
_HIGHEST_HARMONIC = 64
# Clock phases that are tried; clocks that are multiples of each other hide one another at few.
_TRIES = 48
_CANDIDATES = 60


def double_rate_pulses(duty1=0.25, duty2=0.25):
    """Clock 2 at twice the frequency, its pulses midway between those of clock 1 (the paper's).

    Parameters
    ----------
    duty1, duty2 : float
        Duty cycles of clock 1 at fs and clock 2 at 2 fs, in (0, 1).

    Returns
    -------
    tuple
        On-intervals of switch 1 and 2, in cycles of fs.

    Raises
    ------
    InputError
        For a duty cycle out of range, or pulses that overlap: both switches on together.
    """
    _check_duties(duty1, duty2)
    if duty1 / 2 + duty2 / 4 > 1 / 4:
        rule = "2 duty1 + duty2 must be at most 1: the two switches are never on together"
        raise InputError("duty2", rule, duty2)
    return (_pulse(0.0, duty1),), (_pulse(0.25, duty2 / 2), _pulse(0.75, duty2 / 2))


def one_rate_pulses(duty1=0.25, duty2=0.25, delay=0.5):
    """Both clocks at fs, clock 2 later by ``delay`` cycles.

    All lines are shared; the ends differ in how the lines' phases go with their number.

    Raises
    ------
    InputError
        As :func:`double_rate_pulses`.
    """
    _check_duties(duty1, duty2)
    if not 0 < delay < 1:
        raise InputError("delay", "must lie between 0 and 1 cycle", delay)
    if min(delay, 1 - delay) < (duty1 + duty2) / 2:
        rule = "must be (duty1 + duty2) / 2 or more: the two switches are never on together"
        raise InputError("delay", rule, delay)
    return (_pulse(0.0, duty1),), (_pulse(delay, duty2),)


def _check_duties(*duties):
    for i, duty in enumerate(duties):
        if not 0 < duty < 1:
            raise InputError(f"duty{i + 1}", "must lie between 0 and 1", duty)


def _pulse(center, width):
    return center - width / 2, center + width / 2


def line_coefficients(pulses, m, averaging_cycles=0.0):
    """Fourier coefficients of one switch at harmonics of fs.

    Parameters
    ----------
    pulses : sequence of (on, off)
        In cycles.
    m : array_like of int
    averaging_cycles : float
        fs Ta: what a snapshot averages over.

    Returns
    -------
    ndarray of complex, shape of ``m``
        c[m] = sum over pulses of width sinc(m width) exp(-j 2 pi m center), times sinc(m fs Ta).
    """
    m = np.asarray(m)
    total = np.zeros(m.shape, complex)
    for on, off in pulses:
        total += (off - on) * np.sinc(m * (off - on)) * np.exp(-1j * np.pi * m * (on + off))
    return total * np.sinc(m * averaging_cycles)


def switch_waveform(pulses, cycles, window_cycles):
    """How much of each window a switch is on.

    Parameters
    ----------
    pulses : sequence of (on, off)
    cycles : ndarray, shape (n,)
        Clock at the windows' centres.
    window_cycles : float

    Returns
    -------
    ndarray, shape (n,)
        In 0..1.
    """
    cycles = np.asarray(cycles, float)
    total = np.zeros(cycles.shape)
    for on, off in pulses:
        bounds = [_on_time(cycles + side * window_cycles / 2 - on, off - on) for side in (-1, 1)]
        total += bounds[1] - bounds[0]
    return total / window_cycles


def _on_time(cycles, width):
    """How long a pulse that begins each cycle has been on since cycle 0."""
    whole = np.floor(cycles)
    return whole * width + np.minimum(cycles - whole, width)


@dataclass(frozen=True)
class Line:
    """A line of an end's spectrum.

    ``frequency_hz`` is that on the air, ``seen_hz`` where snapshots show it (folded at half the
    snapshot rate), ``level_db`` counts from the strongest line of the end, ``shared_with`` lists
    (tag, end, harmonic) of the lines of other ends that a phase group cannot resolve from it.
    """

    harmonic: int
    frequency_hz: float
    seen_hz: float
    level_db: float
    shared_with: tuple = ()


@dataclass(frozen=True)
class End:
    """An end of a tag: its lines, its information q, and what the others cost it.

    ``information`` is the worst over relative clock phases and clock errors within tolerance;
    ``loss_db`` is against the same switch alone, not aliased, with nothing moving.
    """

    tag: int
    end: int
    information: float
    loss_db: float
    lines: tuple

    @property
    def alone(self):
        """Lines that no other end shares."""
        return tuple(line for line in self.lines if not line.shared_with)


@dataclass(frozen=True)
class ClockReport:
    """What a set of switching clocks gives.

    Attributes
    ----------
    ends : tuple of End
        Two per tag.
    phase_margins : tuple of float
        Per tag: the part of its signal that tells the right clock phase from the wrong one that
        resembles it most; 0 when the ends could be swapped.
    """

    ends: tuple
    phase_margins: tuple

    @property
    def worst_loss_db(self):
        return max(end.loss_db for end in self.ends)

    @property
    def collisions(self):
        """Lines of different tags that fall together: (tag, m, other tag, other m), tag first."""
        found = {
            (end.tag, line.harmonic, tag, harmonic)
            for end in self.ends
            for line in end.lines
            for tag, _, harmonic in line.shared_with
            if tag > end.tag
        }
        return tuple(sorted(found))

    @property
    def problems(self):
        """Why an end cannot be read, a sentence each; empty when all can."""
        found = [
            f"tag {end.tag + 1}, end {end.end}: {end.loss_db:.1f} dB of its signal cannot be told "
            "from other ends, aliases or clutter"
            for end in self.ends
            if end.loss_db > WORST_LOSS_DB
        ]
        found += [
            f"tag {tag + 1}: two phases of its clock look alike, so that its ends could be swapped"
            for tag, margin in enumerate(self.phase_margins)
            if margin < PHASE_MARGIN
        ]
        return tuple(found)

    @property
    def readable(self):
        """Whether every end of every tag can be read."""
        return not self.problems


def assess_clocks(
    clocks_hz,
    waveform,
    group_length,
    pulses=None,
    tolerance_ppm=100.0,
    clutter_hz=0.0,
):
    """How well the ends of tags with given clocks can be told apart.

    Parameters
    ----------
    clocks_hz : sequence of float
        fs of each tag.
    waveform : Waveform
        Gives snapshot period and averaging time.
    group_length : int
        Snapshots per phase group.
    pulses : tuple, optional
        On-intervals of the two switches; by default the paper's, :func:`double_rate_pulses`.
    tolerance_ppm : float
        How far each clock may be off.
    clutter_hz : float
        Bandwidth of what moves.

    Returns
    -------
    ClockReport
    """
    pulses = double_rate_pulses() if pulses is None else pulses
    lines = _lines(clocks_hz, waveform, group_length, pulses, tolerance_ppm)
    information = _worst_information(
        clocks_hz, waveform, group_length, pulses, tolerance_ppm, clutter_hz
    )
    ends = []
    for (tag, end), q in zip(product(range(len(clocks_hz)), (1, 2)), information, strict=True):
        ideal = _ideal_information(pulses[end - 1], clocks_hz[tag] * waveform.averaging_s)
        loss_db = 10 * np.log10(ideal / max(q, 1e-12))
        ends.append(End(tag, end, float(q), float(loss_db), lines[tag, end]))
    margins = tuple(_phase_margin(pulses, f * waveform.averaging_s) for f in clocks_hz)
    return ClockReport(tuple(ends), margins)


def _lines(clocks_hz, waveform, group_length, pulses, tolerance_ppm):
    """(tag, end) to its lines at positive harmonics, with whom they are shared."""
    rate = 1 / waveform.snapshot_period_s
    resolution_hz = rate / group_length
    found = {}
    for tag, clock_hz in enumerate(clocks_hz):
        m = np.arange(1, _HIGHEST_HARMONIC + 1)
        for end in (1, 2):
            level = np.abs(line_coefficients(pulses[end - 1], m, clock_hz * waveform.averaging_s))
            level_db = 20 * np.log10(np.maximum(level / level.max(), 1e-9))
            for i in np.flatnonzero(level_db >= _WEAKEST_LINE_DB):
                frequency = float(m[i] * clock_hz)
                seen = abs((frequency + rate / 2) % rate - rate / 2)
                line = Line(int(m[i]), frequency, seen, float(level_db[i]))
                found.setdefault((tag, end), []).append(line)

    def together(one, other):
        wander = 1e-6 * tolerance_ppm * (one.frequency_hz + other.frequency_hz)
        return abs(one.seen_hz - other.seen_hz) < resolution_hz + wander

    return {
        key: tuple(
            replace(
                line,
                shared_with=tuple(
                    (*other_key, other.harmonic)
                    for other_key, others in found.items()
                    for other in others
                    if other_key != key and together(line, other)
                ),
            )
            for line in own
        )
        for key, own in found.items()
    }


def _ideal_information(pulses, averaging_cycles):
    """Power of one switch's averaged waveform about its mean."""
    m = np.arange(1, 4 * _HIGHEST_HARMONIC)
    return float(2 * np.sum(np.abs(line_coefficients(pulses, m, averaging_cycles)) ** 2))


def _worst_information(clocks_hz, waveform, group_length, pulses, tolerance_ppm, clutter_hz):
    """q of every end: power per snapshot of what of its waveform no other waveform explains."""
    period_s, averaging_s = waveform.snapshot_period_s, waveform.averaging_s
    times_s = (np.arange(group_length) - (group_length - 1) / 2) * period_s
    clutter = clutter_basis(group_length, period_s, clutter_hz)
    worst = np.full(2 * len(clocks_hz), np.inf)
    phases = np.random.default_rng(0).random((_TRIES, len(clocks_hz)))
    for try_ in range(_TRIES):
        columns = []
        for tag, clock_hz in enumerate(clocks_hz):
            error = tolerance_ppm * 1e-6 * ((try_ + tag) % 3 - 1)
            cycles = clock_hz * (1 + error) * times_s + phases[try_, tag]
            columns += [switch_waveform(p, cycles, clock_hz * averaging_s) for p in pulses]
        waveforms = np.stack(columns, axis=1)
        waveforms -= clutter @ (clutter.T @ waveforms)
        worst = np.minimum(worst, _unexplained(waveforms) / group_length)
    return worst


def _unexplained(waveforms):
    """Energy of what of each column the other columns do not explain; shape (columns,)."""
    scale = np.sqrt(np.maximum(np.sum(waveforms**2, axis=0), 1e-300))
    gram = (waveforms / scale).T @ (waveforms / scale)
    values, vectors = np.linalg.eigh(gram)
    inverse = np.sum(vectors**2 / np.maximum(values, 1e-9), axis=1)
    return scale**2 / inverse


def _phase_margin(pulses, averaging_cycles):
    """``phase_margin`` of all lines of a tag."""
    m = np.r_[-_HIGHEST_HARMONIC:0, 1 : _HIGHEST_HARMONIC + 1]
    spectra = np.stack([line_coefficients(p, m, averaging_cycles) for p in pulses], axis=1)
    return phase_margin(spectra, m)


def propose_clocks(
    count,
    waveform,
    group_length,
    taken=(),
    pulses=None,
    tolerance_ppm=100.0,
    clutter_hz=0.0,
    highest_line=4,
):
    """Clocks for ``count`` more tags beside those ``taken``, chosen one after the other.

    Each is the candidate that leaves the weakest end of all tags the most information.

    Parameters
    ----------
    count : int
    waveform : Waveform
    group_length : int
    taken : sequence of float
        Clocks of the tags that are there.
    pulses, tolerance_ppm, clutter_hz
        As in :func:`assess_clocks`.
    highest_line : int
        Harmonic that must lie below half the snapshot rate.

    Returns
    -------
    list of float
        Shorter than ``count`` when no more clocks leave every end readable.
    """
    rate = 1 / waveform.snapshot_period_s
    lowest = clutter_hz + 10 * rate / group_length
    candidates = _round_numbers(lowest, rate / 2 / highest_line)
    settings = waveform, group_length, pulses or double_rate_pulses(), tolerance_ppm, clutter_hz
    clocks = list(taken)
    for _ in range(count):
        best = _best_candidate(candidates, clocks, rate / group_length, settings)
        if best is None or not assess_clocks([*clocks, best], *settings).readable:
            break
        clocks.append(best)
    return clocks[len(taken) :]


def _best_candidate(candidates, clocks, resolution_hz, settings):
    """The candidate that leaves the weakest end the most information; None without any."""
    free = [c for c in candidates if not any(_too_near(c, f, resolution_hz) for f in clocks)]
    return max(free, key=lambda c: _worst_information([*clocks, c], *settings).min(), default=None)


def _too_near(one, other, resolution_hz):
    """Whether main lines fall within four times the resolution of each other."""
    return any(
        abs(a * one - b * other) < 4 * resolution_hz
        for a, b in ((1, 1), (1, 2), (2, 1), (1, 4), (4, 1))
    )


def _round_numbers(low, high):
    """Round frequencies from low to below high, at most _CANDIDATES."""
    if high <= low:
        return []
    step = 10 ** np.ceil(np.log10((high - low) / _CANDIDATES))
    step = next(s for s in (step / 5, step / 2, step) if (high - low) / s <= _CANDIDATES)
    return [float(f) for f in np.arange(np.ceil(low / step), np.ceil(high / step)) * step]
