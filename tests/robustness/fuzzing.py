# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of input, the command that each is given to, and broken inputs in one process.

    python3 fuzzing.py SEED FINDS KIND=COUNT... [--explore]

works in a folder that `prepare` has filled, prints what is wrong, a line each, and keeps what it
finds in the folder FINDS. With `--explore`, inputs that reach new code are broken further, which
pays for many of them: every line that runs is watched. Each kind has a process of its own, which
does not remember other kinds.
``corpus/`` holds inputs that once broke a command, or that reach code which the original does not;
their names begin with their kind. ``originals/`` holds the sound inputs that no command writes;
radio.txt names no radio, but a device without channels, which every SoapySDR has.
"""

import contextlib
import hashlib
import io
import os
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from gnuradio.wiforce import sensor as sensors
from gnuradio.wiforce.io import csi_tools
from mutations import mutated, mutated_arrays, mutated_samples
from wiforce_app.main import main

LIMIT_S = 20
# csiread never ends with some damaged files, which are waited for as long as an old machine starts.
csi_tools._START_S = LIMIT_S / 2
LIMIT_BYTES = 1 << 30
CORPUS, ORIGINALS = (Path(__file__).parent / name for name in ("corpus", "originals"))


class Hang(BaseException):
    """The command took longer than LIMIT_S; no `except Exception` may catch this."""


class Kind:
    """One kind of input: its sound original, and what to call with a broken version of it.

    ``file``: name under which a broken version is put into the working folder; ``original``: file
    in the working folder; ``arguments``: of the ``gr-wiforce`` command, run in the working folder.
    """

    def __init__(self, file, original, *arguments):
        self.file, self.arguments = Path(file), arguments
        self.original = Path(original).read_bytes()

    def broken(self, rng, of=None):
        """A broken version of the original, or of another input."""
        mutate = mutated_samples if self.file.suffix == ".bin" else mutated
        # A damaged archive is refused as a whole: mostly, the arrays in it are broken.
        if self.file.suffix in (".npy", ".npz") and rng.random() < 0.8:
            return mutated_arrays(self.original, rng)
        return mutate(self.original if of is None else of, rng)

    def put(self, data):
        """Put a version where the command finds it; returns the arguments of the command."""
        self.file.write_bytes(data)
        return self.arguments

    def fault_in(self, shown):
        """What is wrong with the output of a command that succeeded, None when nothing is."""


class OptionsKind(Kind):
    """Options of a command, a line each, in the place of a file.

    What is read behind NUL or is no UTF-8 cannot be an argument, and is replaced.
    """

    def put(self, data):
        words = data.decode(errors="replace").replace("\0", "").splitlines()
        return (*self.arguments, *words)


class ToolKind(Kind):
    """A file of a CSI tool that was cut at either end, or some bytes of which were changed."""

    def broken(self, rng, of=None):
        data = bytearray(self.original if of is None else of)
        what = rng.integers(4)
        if what != 0:
            for at in rng.integers(len(data), size=int(rng.choice([1, 3, 10]))):
                data[at] = int(rng.integers(256))
        if what != 1:
            del data[: int(rng.integers(5000))]
        if what == 2:  # some records are left, by which the tool is recognised
            del data[int(rng.integers(5000, len(data))) :]
        return bytes(data)

    def fault_in(self, shown):
        return "checked as samples" if ": samples, " in shown else None


_READ = ("read", "-o", "out.csv", "--scene", "scene.yaml")
_CALIBRATE = ("calibrate", "-o", "out.yaml", "--form", "cubic", "--length-mm", "10")
_TOUCHSTONE = (*_CALIBRATE, "--frequency-hz", "900e6")
_SKIN = ("calibrate", "--surface", "surface.yaml", "--readings", "shown.csv", "-o", "o.yaml")
_CHECK = ("check", "--scene", "scene.yaml", "--driver", "soapy")
_INVERT = ("invert", "-o", "out.jsonl", "--sensor")


# By name: the class and its arguments.
KINDS = {
    "scene": (Kind, "x.yaml", "scene.yaml", "plan", "x.yaml"),
    "sensor": (Kind, "y.yaml", "arm.yaml", *_INVERT, "y.yaml", "phases.csv"),
    "vna": (Kind, "x.csv", "vna.csv", *_CALIBRATE, "x.csv"),
    "index": (Kind, "i.csv", "index.csv", *_TOUCHSTONE, "i.csv"),
    "touchstone": (Kind, "00.s2p", "first.s2p", *_TOUCHSTONE, "index.csv"),
    "phases": (Kind, "p.csv", "phases.csv", *_INVERT, "wiforce-900mhz", "p.csv"),
    "metadata": (Kind, "x.sigmf-meta", "capture.sigmf-meta", *_READ, "x"),
    "samples": (Kind, "x.bin", "capture.sigmf-data", *_READ, "x.bin", "--datatype", "ci16_le"),
    "snapshots": (Kind, "x.npz", "packets.npz", "read", "-o", "out.csv", "x.npz"),
    "surface": (Kind, "w.yaml", "surface.yaml", "plan", "w.yaml"),
    "spreading": (Kind, "skin.yaml", "law.yaml", "plan", "surface.yaml"),
    "taps": (Kind, "t.csv", "taps.csv", *_SKIN, "t.csv"),
    "symbol": (Kind, "own.npy", "chirp.npy", "plan", "symbol.yaml"),
    "radio": (OptionsKind, "options.txt", "radio.txt", *_CHECK),
}
TOOLS = ("intel", "atheros", "nexmon", "esp32", "picoscenes")
KINDS |= {tool: (ToolKind, "x.dat", f"{tool}.dat", "check", "x.dat") for tool in TOOLS}


def kind_of(name):
    """A kind by its name; works in a folder that was prepared."""
    kind, *arguments = KINDS[name]
    return kind(*arguments)


def prepare(folder):
    """Puts the original of every kind into a folder, and what the commands need beside it."""
    import csi_files  # of the tests, whose folders a process that only breaks files does not know

    folder = Path(folder)
    shutil.copytree(ORIGINALS, folder, dirs_exist_ok=True)
    shutil.copy(folder / "law.yaml", folder / "skin.yaml")
    for scene, name in (("scene.yaml", "capture"), ("packets.yaml", "packets")):
        assert main(["simulate", str(folder / scene), str(folder / name)]) == 0
    for tool, content in {
        "intel": csi_files.intel_file(csi_files.values_of(30, 3, 100)),
        "atheros": csi_files.atheros_file(csi_files.values_of(56, 2, 400)),
        "nexmon": csi_files.nexmon_file(csi_files.values_of(64, 2, 2000)),
        "esp32": "".join(csi_files.esp32_lines(csi_files.values_of(64, 1, 100))).encode(),
        "picoscenes": csi_files.picoscenes_file(),
    }.items():
        (folder / f"{tool}.dat").write_bytes(content)
    symbol = np.exp(1j * np.pi * np.arange(64) ** 2 / 64)
    for name in ("chirp.npy", "own.npy"):
        np.save(folder / name, symbol)
    (folder / "x.sigmf-data").symlink_to("capture.sigmf-data")
    # A short line: the tables of its model are small, and soon built.
    line = replace(sensors.load_sensor("line-900mhz"), length_mm=10.0)
    table = sensors.measure_vna(line, [4.0, 5.0, 6.0], np.linspace(2, 3, 5), 0.2)
    sensors.write_vna_csv(table, folder / "vna.csv")
    sensors.write_sensor(sensors.calibrate(table, "arm", 10.0, "cubic"), folder / "arm.yaml")
    _touchstone(table, folder)


def _touchstone(table, folder):
    """An index of Touchstone files of a table's presses, the first of them twice."""
    presses = sorted({(f, str(p)) for f, p in zip(table.force_n, table.location_mm, strict=True)})
    index = ["file,force_n,location_mm"]
    for number, (force, place) in enumerate(presses):
        here = (table.force_n == force) & (table.location_mm.astype(str) == place)
        angles = [table.phase_deg[here & (table.port == port)][0] for port in (1, 2)]
        cells = " ".join(f"0.9 {a:.3f} 0.01 0 0.01 0 0.9 {b:.3f}" for a, b in [angles])
        lines = [f"{f} {cells}" for f in (800, 900, 1000)]
        (folder / f"{number:02d}.s2p").write_text("# MHz S MA R 50\n" + "\n".join(lines) + "\n")
        index.append(f"{number:02d}.s2p,{force:g},{'' if place == 'nan' else place}")
    (folder / "index.csv").write_text("\n".join(index) + "\n")
    (folder / "first.s2p").write_bytes((folder / "00.s2p").read_bytes())


def call(arguments):
    """The command's entry function with a deadline: exit status, standard error and output."""

    def expired(signum, frame):
        raise Hang(f"{arguments}: still running after {LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, expired)
    remaining_s = signal.alarm(LIMIT_S)
    said, shown = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(said):
            status = main(list(arguments))
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.alarm(remaining_s)
    return status, said.getvalue(), shown.getvalue()


def fault_of(status, said):
    """What is wrong with how a command ended, None when nothing is."""
    if status not in (0, 2):
        return f"exit {status}: {said.strip()[-300:]}"
    if "Traceback" in said:
        return f"traceback: {said.strip()[-300:]}"
    complaints = [
        line
        for line in said.splitlines()
        if "warning" not in line and "first frame begins" not in line
    ]
    if status == 2 and len(complaints) != 1:
        return f"not one line: {said[:300]!r}"
    return None


def check(kind, data):
    """What is wrong with how a kind's command takes this input, None when nothing is.

    A busy machine may stop us for as long as LIMIT_S: what hangs must do so twice.
    """
    arguments = kind.put(data)
    for last in (False, True):
        try:
            status, said, shown = call(arguments)
            return fault_of(status, said) or (kind.fault_in(shown) if status == 0 else None)
        except Hang as hang:
            if last:
                return str(hang)


class Reached:
    """Tells inputs that reach code which none has reached before, by lines of our own Python."""

    def __init__(self, explores):
        self._explores, self._known, self._now = explores, set(), set()

    def __enter__(self):
        self._now = set()
        if self._explores:
            sys.settrace(self._called)

    def __exit__(self, *_):
        sys.settrace(None)

    def anything_new(self):
        """Whether the last input did."""
        fresh = not self._now <= self._known
        self._known |= self._now
        return fresh

    def _called(self, frame, event, _):
        if "wiforce" not in frame.f_code.co_filename:
            return None
        self._now.add((frame.f_code, frame.f_lineno))
        return self._called


def peak_memory():
    """Most resident memory that this process has held, in bytes.

    getrusage would count that of the process which started this one as well: what a process held
    before it became another program is counted to it.
    """
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line for line in status.splitlines() if "VmHWM" in line).split()[1])


def run(name, count, seed, finds, explores):
    """Gives a command its sound input, those of the corpus, and so many broken ones.

    What is broken is the sound input or, where it ``explores``, one that reached code which none
    before had. Prints what is wrong, and keeps such inputs in the folder ``finds``: ``fault-...``
    and, of those that reached further, ``KIND-...``.
    """
    kind, rng, reached = kind_of(name), np.random.default_rng(seed), Reached(explores)
    pool = [kind.original]
    known = [kind.original, *(path.read_bytes() for path in sorted(CORPUS.glob(f"{name}-*")))]
    for number in range(len(known) + count):
        fresh = number >= len(known)
        data = kind.broken(rng, pool[rng.integers(len(pool))]) if fresh else known[number]
        with reached:
            fault = check(kind, data)
        if fault:
            (finds / f"fault-{name}-{seed}-{number}").write_bytes(data)
            print(f"{name} {seed} {number}: {' '.join(fault.split())}", flush=True)
        elif reached.anything_new():
            pool.append(data)
            if fresh:
                (finds / f"{name}-{hashlib.sha1(data).hexdigest()[:8]}").write_bytes(data)
    peak = peak_memory()
    if peak > LIMIT_BYTES:
        print(f"{name}: took {peak >> 20} MB of memory")


if __name__ == "__main__":
    for name, _, count in (word.partition("=") for word in sys.argv[3:] if "=" in word):
        # Forked, it does not import the package again.
        if (child := os.fork()) == 0:
            run(name, int(count), int(sys.argv[1]), Path(sys.argv[2]), "--explore" in sys.argv)
            sys.exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status:
            print(f"{name}: exit {status}", flush=True)
