# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench stress``: worst errors at numerical extremes, and their causes."""

import dataclasses
import tempfile
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.planning.clocks import assess_clocks
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.signal.waveform import sounding_waveform

from ..shell.options import IntegerRange
from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from .cases import Case, SnapshotChain, air_of, errors_of, plan_of

WAVEFORM = sounding_waveform()
_NOTHING_DEG = 0.02
PATHS = ("double", "file-fc32", "stream-fc32", "stream-sc16", "block by block", "channel first")


@dataclass(frozen=True)
class Outcome:
    """Touched groups of one run: errors and stated std (n, 2S), and the number without a reading.

    ``not_finite`` counts values that are not finite although they are reported as valid.
    """

    errors_deg: np.ndarray
    std_deg: np.ndarray
    unread: int
    not_finite: int

    @property
    def worst_deg(self):
        """Largest error of what is not flagged weak."""
        errors = np.abs(self.errors_deg)
        return float(np.max(errors[self.std_deg <= WEAK_PHASE_DEG], initial=0.0))

    @property
    def discarded(self):
        """Groups that are not readable or flagged weak."""
        return self.unread + int(np.count_nonzero(np.any(self.std_deg > WEAK_PHASE_DEG, axis=1)))

    @property
    def undetected_deg(self):
        """Largest error beyond four stated standard deviations and 0.02 deg, if unflagged."""
        errors = np.abs(self.errors_deg)
        held = (errors <= 4 * self.std_deg + _NOTHING_DEG) | (self.std_deg > WEAK_PHASE_DEG)
        return float(np.max(errors[~held], initial=0.0))


def read_case(case, path="double", indices=None, scale=None, hurt=None, run=0):
    """One run of a case by one of :data:`PATHS`: its reference groups, then its touched groups.

    ``indices`` are those of the groups, increasing. ``scale`` gives a factor for the samples of
    a numbered group, and ``hurt`` may change its H (N, K).
    """
    air, tags, _ = air_of(case, run)
    settings = plan_of(case, "harmonic")
    count = case.reference_groups + case.groups
    indices = list(range(count)) if indices is None else list(indices)

    def snapshots():
        for number, index in enumerate(indices):
            factor = 1.0 if scale is None else scale(number)
            group = factor * air.group(index, number >= case.reference_groups)
            if hurt is not None:
                hurt(number, group)
            yield group

    chain = SnapshotChain(settings)
    ready = []
    if path == "double":
        for index, group in zip(indices, snapshots(), strict=True):
            ready.append(chain.process(index, group))
    else:
        with tempfile.TemporaryDirectory(prefix="wiforce-stress-") as folder:
            groups, tones, incomplete = _through_blocks(
                path, settings, snapshots(), indices, Path(folder)
            )
        tones = tones[:, :, settings.waveform.bins]
        for row, index in enumerate(groups):
            if index in incomplete:
                ready.append(chain.process(index, *incomplete[index]))
            else:
                ready.append(chain.process_tones(Groups([index], tones[row : row + 1])))
    groups = Groups.concatenate([*ready, chain.flush()])
    touched = groups[groups.index >= indices[case.reference_groups]]
    errors, std, unread = errors_of(case, tags, _numbered(touched, case), "harmonic")
    lost = len(indices) - case.reference_groups - len(touched)
    return Outcome(errors, std, unread + lost, _not_finite(errors, std))


def _numbered(groups, case):
    """Groups with an index in the touched part; infinite std without a reading."""
    unreliable = np.repeat(groups.overlapping | ~groups.locked, 2, axis=1)
    std = np.where(unreliable, np.inf, groups.phase_std_deg)
    index = np.full(len(groups), case.reference_groups)
    return groups.having(index=index, phase_std_deg=std)


def _not_finite(errors, std):
    return int(np.count_nonzero(~np.isfinite(errors)) + np.count_nonzero(~np.isfinite(std)))


def _through_blocks(path, settings, snapshots, indices, folder):
    """Group indices, tones (groups, M, 64), and H and mask of incomplete groups: by C++ blocks."""
    item_type = "sc16" if path.endswith("sc16") else "fc32"
    samples = folder / "samples"
    with open(samples, "wb") as stream:
        for group in snapshots:
            stream.write(_samples(group, item_type))
    flowgraph, sink, messages = _flowgraph(path, item_type, samples, settings, indices)
    flowgraph.run()
    tones = np.array(sink.data(), np.complex64).reshape(
        -1, len(settings.table.tones), WAVEFORM.symbol_length
    )
    return _group_indices(sink, len(tones)), tones, _incomplete(messages)


def _incomplete(messages):
    """H (N, K) and mask (N,) of the groups for which a message was sent."""
    import pmt

    found = {}
    for i in range(messages.num_messages()):
        message = messages.get_message(i)
        meta = pmt.to_python(pmt.car(message))
        mask = np.asarray(meta["mask"], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        channel = (
            np.fft.fft(folded.reshape(len(mask), WAVEFORM.symbol_length)) * WAVEFORM.equalizer()
        )
        found[int(meta["group"])] = channel[:, WAVEFORM.bins], mask
    return found


def _samples(snapshots, item_type):
    """Frames whose fold and FFT give H (N, K)."""
    spectrum = np.zeros((len(snapshots), WAVEFORM.symbol_length), complex)
    spectrum[:, WAVEFORM.bins] = snapshots / WAVEFORM.equalizer()[WAVEFORM.bins]
    symbol = np.fft.ifft(spectrum, axis=1)
    frames = np.zeros((len(snapshots), WAVEFORM.frame_length), complex)
    frames[:, :320] = np.tile(symbol, 5)
    if item_type == "fc32":
        return frames.astype(np.complex64).tobytes()
    codes = np.stack([frames.real, frames.imag], axis=-1) * _FULL_SCALE / np.abs(frames).max()
    return np.clip(np.rint(codes), -32768, 32767).astype("<i2").tobytes()


_FULL_SCALE = 23000  # -3 dB


def _flowgraph(path, item_type, samples, settings, indices):
    from gnuradio import blocks, gr, wiforce

    from .chains import kernel_blocks

    rows, folded = len(settings.table.tones), path == "file-fc32"
    top = gr.top_block("stress", catch_exceptions=False)
    if folded:
        segments = _segments(indices, settings.group_length * WAVEFORM.frame_length)
        source = wiforce.recording_source(str(samples), "cf32_le", segments, WAVEFORM.frame_length)
    else:
        source = blocks.file_source(4 if item_type == "sc16" else 8, str(samples), False)
    order = path if path in ("block by block", "channel first") else "tones first"
    kernels = kernel_blocks(
        order, settings.table.weights, settings.group_length, WAVEFORM, item_type, folded
    )
    chain = [source, *kernels]
    sink = blocks.vector_sink_c(rows * WAVEFORM.symbol_length)
    top.connect(*chain, sink)
    messages = blocks.message_debug(False)
    sender = next(block for block in chain if _has_incomplete_port(block))
    top.msg_connect(sender, "incomplete", messages, "store")
    return top, sink, messages


def _has_incomplete_port(block):
    import pmt

    ports = block.to_basic_block().message_ports_out()
    return "incomplete" in pmt.to_python(ports)


def _segments(indices, group_samples):
    """(file sample, global index, length) of every run of groups without a gap."""
    starts = [0] + [i for i in range(1, len(indices)) if indices[i] != indices[i - 1] + 1]
    stops = [*starts[1:], len(indices)]
    return [
        (a * group_samples, (indices[a] - indices[0]) * group_samples, (b - a) * group_samples)
        for a, b in zip(starts, stops, strict=True)
    ]


def _group_indices(sink, count):
    import pmt

    indices = {
        tag.offset: pmt.to_uint64(tag.value)
        for tag in sink.tags()
        if pmt.symbol_to_string(tag.key) == "group"
    }
    return [indices[offset] for offset in range(count)]


# gamma with negligible noise, so that systematic errors remain; even less noise for clutter.
_QUIET_DB, _SILENT_DB = 60.0, 140.0
_KNOWN_DEG = 0.02
_WEEK_GROUPS = int(7 * 86400 / 0.036)
_BLOCKS = ("file-fc32", "stream-fc32", "block by block", "channel first")


# The worst error of one kind of stress on one path: the largest phase error in degrees or in stated
# standard deviations, of what is not flagged weak; or per cent of unflagged readings beyond three
# standard deviations. Undetected is the largest error that neither the stated standard deviation
# nor a flag indicates; not finite are values that are reported as valid.
COLUMNS = (
    Column("stress", "stress"),
    Column("path", "path"),
    Column("worst", "worst", ".2g"),
    Column("", "unit"),
    Column("limit", "limit", "g"),
    Column("undetected", "undetected", ".2g"),
    Column("discarded", "discarded"),
    Column("NaN", "not_finite"),
    Column("", "good", lambda good: "" if good else "BAD"),
    Column("main cause", "cause"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--search", default=60, type=IntegerRange(1), help="Trials of each search.")
@click.option("--only", default="", help="Run only stresses whose name contains this.")
@click.option("--seed", type=IntegerRange(0), default=1, show_default=True)
def stress(as_json, search, only, seed):
    """Worst errors under strong clutter, extreme levels and nearly singular equations.

    Every path from samples to phases, in single and in double precision. Noise is 60 dB below the
    tag, or 140 dB for clutter, so that systematic errors remain visible.
    """
    from gnuradio import gr

    gr.logging().set_default_level(gr.log_levels.off)
    tasks = [task for task in tasks_of(search, seed) if only in task[0]]
    if not tasks:
        raise click.BadParameter(
            f"no stress has a name that contains {only!r}", param_hint="--only"
        )
    rows = []
    with progress("stressing", len(tasks)) as step:
        for name, function, arguments in tasks:
            rows.append(function(name, *arguments))
            step(1)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def tasks_of(search, seed):
    """(name, function, arguments) of every row."""
    tasks = []
    for clutter_db, limit in ((40.0, 0.02), (60.0, 0.02), (80.0, 0.02), (100.0, 0.2)):
        name = f"static clutter +{clutter_db:g} dB"
        tasks += [(name, _clutter, (path, clutter_db, limit)) for path in ("double", *_BLOCKS)]
    tasks += [("16 bits, static clutter +40 dB", _clutter, ("stream-sc16", 40.0, None))]
    for path in ("double", "file-fc32"):
        tasks += [
            ("a week between reference and touch", _week_gap, (path,)),
            ("level 10^4 times up and down", _levels, (path, 1e4)),
            ("all samples near 1e-36", _scaled, (path, 1e-36)),
            ("all samples denormal, 1e-40", _scaled, (path, 1e-40)),
            ("all samples near 1e15", _scaled, (path, 1e15)),
        ]
    tasks += [("samples that are not finite", _not_finite_samples, (path,)) for path in _BLOCKS[:3]]
    tasks += [
        ("a week from the first sample", _week_on, ("double",)),
        ("clocks nearly equal", _near_clocks, ("double", search, seed, True)),
        ("clocks that the plan warns of", _near_clocks, ("double", search, seed, False)),
        ("random permitted settings", _any_setting, ("double", search, seed)),
    ]
    for name in ("paper-900mhz", "paper-2400mhz", "wiforce-900mhz", "line-2400mhz"):
        tasks.append((f"inversion, {name}", _inversion, ("table", name, seed)))
    return tasks


def _case(name, **changes):
    base = Case(name, _QUIET_DB, static_db=60.0, groups=8, drift_ppm_per_s=0.0,
                estimators=("harmonic",))  # fmt: skip
    return dataclasses.replace(base, **changes)


def _row(name, path, outcome, limit, cause):
    values = outcome.worst_deg, "deg", limit, outcome.undetected_deg, outcome.discarded
    return _limited(name, path, *values, outcome.not_finite, cause)


_KEYS = ("worst", "unit", "limit", "undetected", "discarded", "not_finite", "cause")


def _limited(stress, path, *values):
    """A row, and whether it is within its limit and hides nothing."""
    row = {"stress": stress, "path": path, **dict(zip(_KEYS, values, strict=True))}
    within = row["limit"] is None or row["worst"] <= row["limit"]
    return {**row, "good": within and row["undetected"] == 0 and row["not_finite"] == 0}


def _clutter(name, path, clutter_db, limit):
    cause = {
        "double": "remaining noise and the fit of the clock",
        "channel first": "rounding in the FFT of each snapshot, before clutter is removed",
        "stream-sc16": "quantisation to 16 bits, without dither",
    }.get(path, "rounding of the samples to single precision")
    case = _case(name, gamma_db=_SILENT_DB, static_db=clutter_db)
    return _row(name, path, read_case(case, path), limit, cause)


def _week_gap(name, path):
    case = _case(name, groups=40)
    first = list(range(case.reference_groups))
    indices = first + [_WEEK_GROUPS + i for i in range(case.groups)]
    outcome = read_case(case, path, indices)
    # In the first groups after the gap the clock rate is uncertain, as their std states.
    known = np.all(outcome.std_deg < _KNOWN_DEG, axis=1)
    kept = dataclasses.replace(
        outcome,
        errors_deg=outcome.errors_deg[known],
        std_deg=outcome.std_deg[known],
        unread=outcome.unread + int(np.count_nonzero(~known)),
    )
    return _row(name, path, kept, 0.01, "noise; the first groups state a larger std")


def _week_on(name, path):
    case = _case(name)
    count = case.reference_groups + case.groups
    outcome = read_case(case, path, [_WEEK_GROUPS + i for i in range(count)])
    return _row(name, path, outcome, 0.01, "double precision of time: 0.1 ns after a week")


def _levels(name, path, factor):
    case = _case(name, groups=12)

    def scale(number):
        step = (number - case.reference_groups) // 3
        return (1.0, factor, 1.0, 1 / factor)[step % 4] if step >= 0 else 1.0

    outcome = read_case(case, path, scale=scale)
    cause = "the clock tracker assumes a constant level; weak until the clock is acquired again"
    return _row(name, path, outcome, 0.1, cause)


def _scaled(name, path, factor):
    outcome = read_case(_case(name, static_db=20.0), path, scale=lambda number: factor)
    cause = "none: phases do not depend on the level"
    if path != "double" and factor < 1e-30:
        cause = "single precision loses digits below 1e-38"
    return _row(name, path, outcome, 0.02, cause)


def _not_finite_samples(name, path):
    rng = np.random.default_rng(1)

    def hurt(number, snapshots):
        rows = rng.choice(len(snapshots), 30, replace=False)
        snapshots[rows[:10]] = np.nan
        snapshots[rows[10:20]] = np.inf
        snapshots[rows[20:]] = -1j * np.inf
        if number == 15:
            snapshots[:] = np.nan

    outcome = read_case(_case(name), path, hurt=hurt)
    return _row(name, path, outcome, 0.02, "such frames count as missing")


# searches


def _near_clocks(name, path, search, seed, readable):
    """Two tags whose clocks, or some of whose lines, nearly coincide.

    ``readable`` selects pairs that the planner accepts, or those that it warns of.
    """
    rng = np.random.default_rng(seed)
    ratios = (1.0, 1.25, 4 / 3, 1.5, 2.0, 0.5, 0.8)

    def trial():
        second = None
        while second is None or assess_clocks((1000.0, second), WAVEFORM, 625).readable != readable:
            second = 1000.0 * rng.choice(ratios) + rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1.7)
        return _case(name, clocks_hz=(1000.0, float(second)), levels_db=(0.0, 0.0), groups=4,
                     gamma_db=30.0)  # fmt: skip

    def label(case):
        return f"clocks 1000 and {case.clocks_hz[1]:.2f} Hz"

    return _searched(name, path, search, trial, label)


def _any_setting(name, path, search, seed):
    """Random settings from the whole permitted range of a scene."""
    rng = np.random.default_rng(seed)

    def trial():
        off = rng.choice([0.0, 0.3])
        return _case(
            name,
            gamma_db=float(rng.uniform(-10, 60)),
            group_length=int(rng.choice([63, 100, 125, 250, 400, 625, 800])),
            clocks_hz=(float(rng.uniform(400, 2000)),),
            static_db=float(rng.uniform(0, 80)),
            clutter_hz=float(rng.choice([0.0, 100.0, 250.0, 350.0])),
            offset_ppm=float(rng.uniform(0, 100)),
            drift_ppm_per_s=float(rng.uniform(0, 0.5)),
            coherence_hz=float(10 ** rng.uniform(5.5, 7.5)),
            off=float(off),
            lost=float(rng.choice([0.0, 0.1, 0.3])),
            groups=5,
        )

    def label(case):
        return (
            f"clock {case.clocks_hz[0]:.0f} Hz, N_g {case.group_length}, gamma {case.gamma_db:.0f} "
            f"dB, clutter +{case.static_db:.0f} dB in {case.clutter_hz:.0f} Hz"
        )

    return _searched(name, path, search, trial, label)


def _searched(name, path, search, trial, label):
    """Worst of many trials: the largest unflagged error in stated standard deviations."""
    worst, cause, refused, not_finite, discarded = 0.0, "", 0, 0, 0
    for run in range(search):
        case = trial()
        try:
            outcome = read_case(case, path, run=run)
        except InputError:
            refused += 1
            continue
        discarded += outcome.discarded
        not_finite += outcome.not_finite
        ratio = np.abs(outcome.errors_deg) / (outcome.std_deg + 0.005)
        ratio = np.where(outcome.std_deg > WEAK_PHASE_DEG, 0.0, ratio)
        found = float(np.max(ratio, initial=0.0))
        if found > worst:
            worst, cause = found, label(case)
    # Groups of a run share their reference, and ends share their clock.
    undetected = worst if worst > _UNDETECTED_STD else 0.0
    cause += f"; {refused} of {search} refused"
    return _limited(name, path, worst, "std", None, undetected, discarded, not_finite, cause)


# Largest of some hundred Gaussian errors, with a margin of a third.
_UNDETECTED_STD = 6.0


def _inversion(name, path, sensor, seed):
    """Presses over the whole span of a model at any noise; unflagged errors in stated std."""
    model, rng, count = load_sensor(sensor), np.random.default_rng(seed), 4000
    worst, cause, discarded, not_finite = 0.0, "", 0, 0
    for noise_deg in (1e-6, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0):
        force = rng.uniform(*model.force_span_n, count)
        location = rng.uniform(*model.location_span_mm, count)
        inside = model.in_span(force, location) & (force >= model.onset_force_n)
        force, location = force[inside], location[inside]
        phases = model.phases_deg(force, location)
        found = model.invert(phases + noise_deg * rng.standard_normal(phases.shape), noise_deg)
        values = [found.force_n, found.force_std_n, found.location_mm, found.location_std_mm]
        not_finite += int(np.count_nonzero(~np.isfinite(values)))
        clear = np.array([not flags for flags in found.flags])
        discarded += int(np.count_nonzero(~clear))
        error = np.abs(found.force_n - force) / np.hypot(found.force_std_n, _LEAST_N)
        beyond = 100 * float(np.mean(error[clear] > 3)) if clear.any() else 0.0
        if beyond > worst:
            at = int(np.argmax(np.where(clear, error, 0.0)))
            worst = beyond
            cause = (
                f"unflagged, beyond 3 std; the worst at phase noise {noise_deg:g} deg: "
                f"{force[at]:.1f} N at {location[at]:.1f} mm is off by {error[at]:.1f} std"
            )
    return _limited(name, path, worst, "%", _BEYOND_3_STD, 0.0, discarded, not_finite, cause)


# Per cent of unflagged readings that may lie beyond three standard deviations (Gaussian: 0.27).
# Errors below _LEAST_N newtons are ignored.
_BEYOND_3_STD, _LEAST_N = 1.0, 0.02
