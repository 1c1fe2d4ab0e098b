# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench stress``: worst errors at numerical extremes, and their causes."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.signal.waveform import sounding_waveform

from ..shell.log import progress
from ..shell.tables import Column, echo, table
from .accuracy import Case, SnapshotChain, air_of, errors_of, plan_of

WAVEFORM = sounding_waveform()
# Ways to tones: in double precision from snapshots, or by blocks that read a type in an order.
PATHS = {
    "double": None,
    "file-fc32": ("fc32", "recording"),
    "stream-fc32": ("fc32", "tones first"),
    "stream-sc16": ("sc16", "tones first"),
    "block by block": ("fc32", "block by block"),
    "channel first": ("fc32", "channel first"),
}
_BLOCKS = ("file-fc32", "stream-fc32", "block by block", "channel first")
_FULL_SCALE = 23000  # -3 dB
# gamma with negligible noise, so that systematic errors remain; even less noise for clutter.
_QUIET_DB, _SILENT_DB = 60.0, 140.0
_NOTHING_DEG = 0.02
WEEK_GROUPS = int(7 * 86400 / 0.036)

_ROUNDED = "rounding of the samples to single precision"
_ROUNDING = {
    "double": "remaining noise and the fit of the clock",
    "channel first": "rounding in the FFT of each snapshot, before clutter is removed",
}
_TINY = "single precision loses digits below 1e-38"
_SCALES = {"near 1e-36": 1e-36, "denormal, 1e-40": 1e-40, "near 1e15": 1e15}

# The worst error of one kind of stress on one path: the largest phase error of what is not flagged
# weak. Undetected is the largest error that neither the stated standard deviation nor a flag
# indicates; not finite are values that are reported as valid.
COLUMNS = (
    Column("stress", "stress"),
    Column("path", "path"),
    Column("worst (deg)", "worst", ".2g"),
    Column("limit", "limit", "g"),
    Column("undetected", "undetected", ".2g"),
    Column("discarded", "discarded"),
    Column("NaN", "not_finite"),
    Column("", "good", lambda good: "" if good else "BAD"),
    Column("main cause", "cause"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--only", help="Run only stresses whose name contains this.")
def stress(as_json, only):
    """Worst errors under strong clutter, extreme levels and nearly singular equations.

    Every path from samples to phases, in single and in double precision. Noise is 60 dB below the
    tag, or 140 dB for clutter, so that systematic errors remain visible.
    """
    from gnuradio import gr

    gr.logging().set_default_level(gr.log_levels.off)
    wanted = [task for task in tasks() if (only or "") in task.name]
    if not wanted:
        raise click.BadParameter(
            f"no stress has a name that contains {only!r}", param_hint="--only"
        )
    rows = []
    with progress("stressing", len(wanted)) as step:
        for task in wanted:
            rows.append(task.row())
            step(1)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


@dataclass(frozen=True)
class Task:
    """A row: what a case is exposed to on a path, the largest error allowed, and its main cause."""

    case: Case
    path: str
    limit: float | None
    cause: str
    stressed: dict  # of `read_case`

    @property
    def name(self):
        return self.case.name

    def row(self):
        """The values, and whether they are within the limit and hide nothing."""
        values = values_of(*read_case(self.case, self.path, **self.stressed))
        good = self.limit is None or values["worst"] <= self.limit
        good = good and values["undetected"] == 0 and values["not_finite"] == 0
        named = {"stress": self.name, "path": self.path, "limit": self.limit}
        return {**named, **values, "cause": self.cause, "good": good}


def tasks():

    def task(name, path, limit, cause, stressed=None, **changes):
        return Task(quiet_case(name, **changes), path, limit, cause, stressed or {})

    for clutter_db, limit in ((40.0, 0.02), (60.0, 0.02), (80.0, 0.02), (100.0, 0.2)):
        for path in ("double", *_BLOCKS):
            cause, name = _ROUNDING.get(path, _ROUNDED), f"static clutter +{clutter_db:g} dB"
            yield task(name, path, limit, cause, gamma_db=_SILENT_DB, static_db=clutter_db)
    name, cause = "16 bits, static clutter +40 dB", "quantisation to 16 bits, without dither"
    yield task(name, "stream-sc16", None, cause, gamma_db=_SILENT_DB, static_db=40.0)
    for path in ("double", "file-fc32"):
        name, cause = (
            "a week between reference and touch",
            "noise; the first groups state a larger std",
        )
        yield task(name, path, 0.01, cause, {"pause": WEEK_GROUPS, "known_deg": 0.02}, groups=40)
        cause = "the clock tracker assumes a constant level; weak until it is acquired again"
        yield task("level 10^4 times up and down", path, 0.1, cause, {"scale": _steps}, groups=12)
        for level, factor in _SCALES.items():
            lost = path != "double" and factor < 1e-30
            cause = _TINY if lost else "none: phases do not depend on the level"
            scaled = {"scale": lambda _, factor=factor: factor}
            yield task(f"all samples {level}", path, 0.02, cause, scaled, static_db=20.0)
    cause = "such frames count as missing"
    for path in _BLOCKS[:3]:
        yield task("samples that are not finite", path, 0.02, cause, {"hurt": _hurt})
    cause = "double precision of time: 0.1 ns after a week"
    yield task("a week from the first sample", "double", 0.01, cause, {"first": WEEK_GROUPS})


def quiet_case(name, gamma_db=_QUIET_DB, **changes):
    """A case of a few groups without noise or drift."""
    settings = {"static_db": 60.0, "groups": 8, "drift_ppm_per_s": 0.0, **changes}
    return Case(name, gamma_db, estimators=("harmonic",), **settings)


def _steps(touched):
    """Level of a numbered group, 0 for the first touched one: up and down by 10^4."""
    return (1.0, 1e4, 1.0, 1e-4)[touched // 3 % 4] if touched >= 0 else 1.0


def _hurt(touched, snapshots):
    """Some snapshots that are not finite; one group has no other."""
    rows = np.random.default_rng(abs(touched)).choice(len(snapshots), 30, replace=False)
    snapshots[rows] = np.repeat([np.nan, np.inf, -1j * np.inf], 10)[:, None]
    if touched == 3:
        snapshots[:] = np.nan


def values_of(errors_deg, std_deg, unread):
    """Values of a row; errors are undetected beyond four standard deviations and 0.02 deg."""
    errors, weak = np.abs(errors_deg), std_deg > WEAK_PHASE_DEG
    hidden = ~weak & ~(errors <= 4 * std_deg + _NOTHING_DEG)
    return {
        "worst": float(np.max(errors[~weak], initial=0.0)),
        "undetected": float(np.max(errors[hidden], initial=0.0)),
        "discarded": unread + int(np.count_nonzero(np.any(weak, axis=1))),
        "not_finite": int(np.count_nonzero(~np.isfinite([errors_deg, std_deg]))),
    }


def read_case(case, path="double", first=0, pause=0, scale=None, hurt=None, known_deg=np.inf):
    """A run of a case by one of :data:`PATHS`: its reference groups, then its touched groups.

    Errors and stated std (n, 2S) of the touched groups that are read, and how many are not.
    ``pause`` groups are absent between. ``scale`` is a factor of a touched group's samples,
    ``hurt`` changes its H (N, K). What states more than ``known_deg`` counts as unread.
    """
    air, tags, _ = air_of(case, 0)
    settings = plan_of(case, "harmonic")
    touched = np.arange(-case.reference_groups, case.groups)
    indices = first + touched - touched[0] + pause * (touched >= 0)

    def snapshots():
        for number, index in zip(touched.tolist(), indices.tolist(), strict=True):
            group = air.group(index, number >= 0) * (1.0 if scale is None else scale(number))
            if hurt is not None:
                hurt(number, group)
            yield group

    chain = SnapshotChain(settings)
    if path == "double":
        ready = [chain.process(*group) for group in zip(indices, snapshots(), strict=True)]
    else:
        ready = [chain.process_tones(_by_blocks(path, settings, snapshots(), indices))]
    groups = Groups.concatenate([*ready, chain.flush()])
    groups = groups[groups.index >= first + pause + case.reference_groups]
    unreliable = np.repeat(groups.overlapping | ~groups.locked, 2, axis=1)
    std = np.where(unreliable, np.inf, groups.phase_std_deg)
    # By their number in the run, as `errors_of` expects it.
    groups = groups.having(index=np.full(len(groups), case.reference_groups), phase_std_deg=std)
    errors, std, _ = errors_of(case, tags, groups, "harmonic")
    known = np.all(std < known_deg, axis=1)
    return errors[known], std[known], case.groups - int(known.sum())


def _by_blocks(path, settings, snapshots, indices):
    """Groups with these indices, by C++ blocks from a file of their samples."""
    import pmt
    from gnuradio import blocks
    from gnuradio.wiforce.blocks.chain import ToneInput

    from .chains import Recording, planned

    item_type, order = PATHS[path]
    length = settings.group_length * WAVEFORM.frame_length
    # (file sample, global index, length) of every run of groups without a gap.
    segments = [
        (int(run[0]) * length, int(indices[run[0]] - indices[0]) * length, len(run) * length)
        for run in np.split(np.arange(len(indices)), np.flatnonzero(np.diff(indices) > 1) + 1)
    ]
    with tempfile.TemporaryDirectory(prefix="wiforce-stress-") as folder:
        samples = Path(folder) / "samples"
        with open(samples, "wb") as stream:
            stream.writelines(_samples(group, item_type) for group in snapshots)
        recording = Recording(samples, samples, length * len(indices))
        flowgraph = planned(settings, recording, item_type, order, segments)
        messages = blocks.message_debug(False)
        for block in flowgraph.row:
            if "incomplete" in pmt.to_python(block.to_basic_block().message_ports_out()):
                flowgraph.top.msg_connect(block, "incomplete", messages, "store")
        flowgraph.run()
    taken = ToneInput(settings, derotated=False)
    for number in range(messages.num_messages()):
        taken.on_incomplete(messages.get_message(number))
    tags = [{} for _ in flowgraph.tones]
    for tag in flowgraph.sinks[0][0].tags():
        tags[tag.offset][pmt.symbol_to_string(tag.key)] = tag.value
    _, groups = taken.collect(flowgraph.tones.reshape(len(tags), -1), tags)
    return groups


def _samples(snapshots, item_type):
    """Frames whose fold and FFT give H (N, K)."""
    spectrum = np.zeros((len(snapshots), WAVEFORM.symbol_length), complex)
    spectrum[:, WAVEFORM.bins] = snapshots / WAVEFORM.equalizer()[WAVEFORM.bins]
    frames = np.zeros((len(snapshots), WAVEFORM.frame_length), complex)
    frames[:, :320] = np.tile(np.fft.ifft(spectrum, axis=1), 5)
    if item_type == "fc32":
        return frames.astype(np.complex64).tobytes()
    codes = frames.view(float) * _FULL_SCALE / np.abs(frames).max()
    return np.clip(np.rint(codes), -32768, 32767).astype("<i2").tobytes()
