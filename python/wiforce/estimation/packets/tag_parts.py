# SPDX-License-Identifier: GPL-3.0-or-later
"""The tags' own part in what packets are divided by, solved from what all antennas show.

A packet is divided by what it holds along the static paths, x (1 + r U). An end that is closed is
therefore measured as r W / (1 + r U), with W in the combinations without a static path. r turns
with every press, and U shows in every packet: the magnitude along the static paths is larger by
|1 + r U| while the end is closed.
"""

from __future__ import annotations

import numpy as np

from ...signal.switching import switch_averages
from ...signal.weights import TimedTable, clutter_at
from ..clocks.tracked_tag import TagClock
from ..groups import Array, Groups
from .antenna_states import LEAST_STEP
from .packet_channels import LARGEST, AntennaCombination, DividedPackets, TagParts

# Rounds in which U is solved for at most, the change of U that ends them, a tenth of a degree of a
# tag as strong as the static paths, and halvings of a step that does not fit better.
_ROUNDS, _SOLVED, _HALVINGS = 40, 1e-3, 8
# Rounds in which the reflections are found that a U leads to: each leaves a third of an error for a
# tag 20 dB below the direct path. Change by which derivatives are measured.
_SETTLING, _SMALL = 4, 1e-4
# Probability with which two standard deviations of U are exceeded before anything is measured.
_EXCEEDED = 0.05
# Phases by which clocks and the times of packets may err together: none, and half of the shortest
# time that an end is closed, either way. Time stamps that err by more do not show that end.
_ASIDE = np.array([0.0, -1.0, 1.0]) * np.pi / 8


def solve_tags(
    groups: Groups,
    packets: DividedPackets,
    table: TimedTable,
    clocks: tuple[TagClock, ...],
    window_s: float,
    reference_groups: int,
    combination: AntennaCombination,
    precision: Array | None,
) -> TagParts:
    """Solve for the tags' parts along the static paths.

    ``precision`` (C, C) is the inverse covariance of the noise, None for that of ``groups``. Tags
    are untouched in the first groups.
    """
    count, number = len(clocks), len(packets.time_s)
    direct = np.zeros((count, packets.level.shape[1]), np.complex64)
    combined = np.zeros((count, packets.combined.shape[1]), np.complex64)
    reflection = np.zeros((len(_ASIDE), number, count), np.complex64)
    closed = np.zeros((len(_ASIDE), number, 2 * count))
    unknown = np.ones((number, count))
    uncertain: list[float] = []
    if len(groups):
        measured = groups.gain, groups.noise, groups.ends
        finite = [np.isfinite(each).reshape(len(groups), -1).all(axis=1) for each in measured]
        groups = groups[groups.locked.all(axis=1) & np.all(finite, axis=0)]
    found = [_Group(row, packets, table, clocks, window_s) for row in groups]
    for tag in range(count if len(groups) else 0):
        own = slice(2 * tag, 2 * tag + 2)
        solved = _Solution(groups, found, own, combination, reference_groups, precision)
        direct[tag], combined[tag] = solved.direct, solved.combined
        uncertain.append(solved.uncertain)
        changes = _changes(groups.index, solved.reflection)
        for each, values, change in zip(found, solved.reflection, changes, strict=True):
            reflection[:, each.rows, tag] = each.closed[:, :, own] @ values
            closed[:, each.rows, own] = each.closed[:, :, own]
            unknown[each.rows, tag] = change
    size = np.sqrt(np.mean(np.abs(direct) ** 2, axis=1) + np.mean(np.abs(combined) ** 2, axis=1))
    known_packets = unknown @ size < LEAST_STEP / 2
    snr = len(groups) * float(np.median(10 ** (groups.snr_db / 10))) if len(groups) else 0.0
    return TagParts(reflection, closed, direct, combined, known_packets, tuple(uncertain), snr)


def _changes(index: Array, reflection: Array) -> Array:
    """By how much groups differ from the more alike of their neighbours, 1 without one."""
    change = np.ones(len(index))
    step = np.abs(np.diff(reflection, axis=0)).max(axis=1)
    step[np.diff(index) > 1] = 1.0
    change[1:] = np.minimum(change[1:], step)
    change[:-1] = np.minimum(change[:-1], step)
    return change


class _Group:
    """Magnitudes along the static paths in a group, by the switches that are closed."""

    def __init__(
        self,
        group: Groups,
        packets: DividedPackets,
        table: TimedTable,
        clocks: tuple[TagClock, ...],
        window_s: float,
    ) -> None:
        period_s, index = table.group_period_s, int(group.index[0])
        ((self.rows, times_s),) = packets.groups(index, index + 1, period_s)
        closed = []
        for tag, clock in enumerate(clocks):
            rate = 2 * np.pi * clock.stated_hz * (1 + 1e-6 * group.clock_offset_ppm[0, tag])
            phase = group.clock_phase[0, tag] + rate * times_s + _ASIDE[:, None]
            closed.append(switch_averages(phase, rate * window_s / 2, group.clock2_delay[0, tag]))
        self.closed = np.concatenate(closed, axis=2)
        own = packets.state[self.rows] >= 0
        states = np.eye(packets.state.max() + 2)[packets.state[self.rows[own]]]
        slow = clutter_at(times_s[own], period_s, table.clutter_hz)[:, 1:]
        columns = np.hstack([self.closed[0, own], states, slow])
        level = packets.level[self.rows[own]]
        inverse = np.linalg.pinv(columns, rcond=1e-6)
        fit = inverse @ level
        residual = level - columns @ fit
        freedom = max(len(columns) - np.linalg.matrix_rank(columns, tol=1e-6), 1)
        gain = np.sum(inverse**2, axis=1)
        count = self.closed.shape[2]
        self.rise = fit[:count]
        self.variance = np.multiply.outer(gain[:count], np.sum(residual**2, axis=0) / freedom)
        # What is common to all subcarriers is noise of the receiver's gain.
        self.common = gain[:count] * np.sum(residual.mean(axis=1) ** 2) / freedom


class _Solution:
    """U, W and the reflections of a tag in G groups."""

    def __init__(
        self,
        groups: Groups,
        found: list[_Group],
        own: slice,
        combination: AntennaCombination,
        reference_groups: int,
        precision: Array | None,
    ) -> None:
        self._hidden, self._response = combination.hidden, combination.response
        self._index, self._ends = groups.index, groups.ends[:, own]
        rises, variance, self._common = (
            np.array([values[own] for values in each])
            for each in zip(*((g.rise, g.variance, g.common) for g in found), strict=True)
        )
        self._rises, self._precise = rises, 1 / np.maximum(variance, 1e-300)
        if precision is None:
            precision = np.diag(1 / groups.noise.mean(axis=0))
        self._precision = precision
        self._noise = np.median(groups.gain[:, own] * groups.noise.mean(axis=1)[:, None], axis=0)
        untouched = groups.index < reference_groups
        self._untouched = untouched if untouched.any() else np.arange(len(untouched)) == 0
        self._wide = self._ends.shape[2] // rises.shape[2]
        self.reflection = np.ones(rises.shape[:2], complex)
        self.direct = np.zeros(rises.shape[2], complex)
        # By how much the response on each subcarrier follows U on every other one.
        each = np.eye(rises.shape[2]) * _SMALL
        self._follows: Array = (self._response(each) - 1) / _SMALL
        for _ in range(_ROUNDS):
            self._straighten()
            self._compare()
            step = self._step()
            if not self._go(step) or np.abs(step).max() < _SOLVED:
                break
        self.uncertain = self._uncertain()

    def _straighten(self) -> None:
        """W and the reflections, from the ends as they are measured, with the U known so far."""
        for _ in range(_SETTLING):
            part = self._part()
            bend = self._response(part.reshape(-1, part.shape[2])).reshape(part.shape)
            straight = self._ends * np.repeat(bend, self._wide, axis=2)
            self.combined = straight[self._untouched, 0].mean(axis=0)
            weights = self._precision @ self.combined.conj()
            energy = max(float((self.combined @ weights).real), 1e-300)
            self._share = self.combined * weights / energy
            self.reflection = straight @ (weights / energy)

    def _compare(self) -> None:
        """Groups that a press does not change, and the power to expect of U."""
        size = np.mean(np.abs(self.direct) ** 2) + np.mean(np.abs(self.combined) ** 2)
        # A press that changes inside a group leaves no single reflection to compare with.
        steady = _changes(self._index, self.reflection) * np.sqrt(size) < LEAST_STEP / 2
        self._steady = steady if np.count_nonzero(steady) > 1 else np.ones(len(steady), bool)
        power = float(np.mean(np.abs(self.combined) ** 2) - self._noise[0])
        self._power = self._hidden * max(power, float(self._noise.max()))

    def _prior(self, value: Array) -> Array:
        """Variance whose Gaussian touches the prior at a value, (1 + |U|^2 / (n P))^-(n + 1)."""
        return np.asarray((self._wide * self._power + np.abs(value) ** 2) / (self._wide + 1))

    def _go(self, step: Array) -> bool:
        """Take a step of U, or as much of it as fits better; False where nothing does."""
        start, cost, mean = self.direct, self._cost(self.direct), np.mean(self.direct)
        for halving in range(_HALVINGS):
            self.direct = start + step / 2**halving
            self._straighten()
            if self._cost(self.direct - np.mean(self.direct) + mean) <= cost:
                return True
        self.direct = start
        self._straighten()
        return False

    def _missing(self) -> tuple[Array, Array]:
        """Steady magnitudes that U does not explain: (G, 2, K), and in common (G, 2)."""
        missing = (self._rises - np.log(np.abs(1 + self._part())))[self._steady]
        precise = self._precise[self._steady]
        return missing, np.sum(precise * missing, axis=2) / np.sum(precise, axis=2)

    def _cost(self, own: Array) -> float:
        """Negative logarithm of the posterior of U, by the prior of its mean and of ``own``."""
        missing, each = self._missing()
        cost = np.sum(self._precise[self._steady] * (missing - each[..., None]) ** 2)
        cost += np.sum(each**2 / np.maximum(self._common[self._steady], 1e-300))
        fades = np.sum(np.log(self._prior(own))) + np.log(self._prior(np.mean(self.direct)))
        return float(cost / 2 + (self._wide + 1) * fades)

    def _slopes(self) -> tuple[Array, Array, Array]:
        """``own``, ``by``, ``turns`` (G, 2, K): magnitudes gain Re(own dU + by sum(turns dU))."""
        reflection, part = self.reflection[self._steady][:, :, None], self._part()[self._steady]
        share = self._share.reshape(-1, self._wide).sum(axis=1)
        # Of the ratio v = R b(1) / b(R) that is measured, with the response b(R) = 1 + R M U.
        along = self.direct @ self._follows
        touched, untouched = share / (1 + reflection * along), share / (1 + along)
        turns = (reflection**2 * touched - reflection * untouched) @ self._follows.T
        turns /= touched.sum(axis=2, keepdims=True)
        return reflection / (1 + part), self.direct / (1 + part), turns

    def _step(self) -> Array:
        """Gauss-Newton step of U (K,), from the magnitudes along the static paths."""
        own, by, turns = (values.reshape(-1, self._rises.shape[2]) for values in self._slopes())
        missing, each = (values.reshape(len(own), -1) for values in self._missing())
        precise, common = self._precise[self._steady].reshape(own.shape), self._common
        total, common = precise.sum(axis=1), common[self._steady].reshape(-1)
        # The inverse covariance of a group is diag(p) + excess p p^T.
        excess = 1 / (total**2 * np.maximum(common, 1e-300)) - 1 / total
        # Real derivatives by the real and by the imaginary part of U: of what each subcarrier has
        # to itself, and of both parts of the sum that all share.
        parts, by = (np.stack([each.real, -each.imag]) for each in (own, by))
        turns = np.stack(
            [np.hstack([turns.real, -turns.imag]), np.hstack([turns.imag, turns.real])]
        )
        by_p = precise * by
        count = own.shape[1]
        diagonal = np.einsum("gk,xgk,ygk->xyk", precise, parts, parts)
        normal = np.einsum("xyk,kl->xkyl", diagonal, np.eye(count)).reshape(2 * count, -1)
        mixed = np.einsum("xgk,ygk,ygm->xgm", by_p, by, turns, optimize=True)
        normal += np.tensordot(turns, mixed, ([0, 1], [0, 1]))
        beside = np.stack([np.hstack(each * parts) for each in by_p])
        cross = np.tensordot(turns, beside, ([0, 1], [0, 1]))
        sums = np.hstack(precise * parts) + np.einsum("xg,xgm->gm", by_p.sum(axis=2), turns)
        normal += cross + cross.T + (sums * excess[:, None]).T @ sums
        weighted = precise * (missing + excess[:, None] * total[:, None] * each)
        right = np.hstack(weighted * parts).sum(axis=0)
        right += np.tensordot(np.sum(by * weighted, axis=2), turns, 2)
        # The prior is one of the mean, and one of every difference from it.
        center = np.eye(count) - 1 / count
        fades = center @ np.diag(2 / self._prior(self.direct)) @ center
        fades += 2 / self._prior(np.mean(self.direct)) / count**2
        normal += np.kron(np.eye(2), fades)
        pull = np.concatenate([fades @ self.direct.real, fades @ self.direct.imag])
        step = np.linalg.solve(normal, right - pull)
        return np.asarray(step[:count] + 1j * step[count:])

    def _uncertain(self) -> float:
        """See :class:`TagParts`: by the noise of the gain, and by what remains of the fit."""
        own, by, turns = self._slopes()
        slope = np.mean(own + by * turns.sum(axis=2, keepdims=True), axis=2)
        common, error = self._common[self._steady], self._missing()[1]
        raised = max(1.0, float(np.mean(error**2 / np.maximum(common, 1e-300))))
        precise = 1 / np.maximum(raised * common, 1e-300)
        jacobian = np.stack([slope.real, -slope.imag], axis=-1)
        normal = np.einsum("gi,gix,giy->xy", precise, jacobian, jacobian)
        # While nothing is measured, two standard deviations hold 95 % of the prior.
        prior = self._power * self._wide * (_EXCEEDED ** (-1 / self._wide) - 1) / 4
        normal = normal + np.eye(2) * 2 / prior
        return float(np.sqrt(2 / np.linalg.eigvalsh(normal)[0]))

    def _part(self) -> Array:
        """r U of every group and end, limited to what a tag can be."""
        part = self.reflection[:, :, None] * self.direct
        return np.asarray(part * np.minimum(1, LARGEST / np.maximum(np.abs(part), 1e-300)))
