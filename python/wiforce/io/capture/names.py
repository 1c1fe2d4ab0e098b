# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the two files of a capture, and the captures that a folder or a pattern names."""

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import InputError

SUFFIXES = (".sigmf-data", ".sigmf-meta")
_META = SUFFIXES[1]
SNAPSHOTS_SUFFIX = ".npz"


def stem_of(name: str | Path) -> str:
    """The path of a capture by that of one of its files, or its own."""
    return os.fspath(name).removesuffix(SUFFIXES[0]).removesuffix(SUFFIXES[1])


def recording_stem(name: str | Path, where: str) -> str:
    """The path of a capture to be written, without suffix; refuses one that files cannot have."""
    text, stem = os.fspath(name), stem_of(name)
    path = Path(stem)
    rule = "must be the name of a capture, to which the suffixes of its files are added"
    if os.path.basename(stem) in ("", ".", "..") or not text.isprintable():
        raise InputError(where, rule, text)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(where, f"{rule}, not that of a device", text)
    return stem


def second_antenna(name: str | Path) -> str:
    """Path of the second antenna's capture, both without suffix."""
    return f"{name}.antenna2"


def files_of(data: Path) -> tuple[Path, ...]:
    """All files of a capture that exist: samples, metadata, truth, those of a second antenna."""
    stem, suffixes = stem_of(data), (*SUFFIXES, ".truth.csv")
    names = [f"{name}{suffix}" for name in (stem, second_antenna(stem)) for suffix in suffixes]
    others = [path for path in map(Path, names) if path.exists() and path != data]
    return (data, *others)


def is_snapshots(path: str | Path) -> bool:
    """Whether a file is one of channel snapshots, by its name."""
    return Path(path).suffix.lower() == SNAPSHOTS_SUFFIX


class NamedCapture(NamedTuple):
    """A capture, and what its readings are called."""

    name: str  # path from the folder in which it was found, or its file's name; without suffix
    path: str  # as it is opened


def find_captures(given: Iterable[str], datatype: str | None = None) -> list[NamedCapture]:
    """The captures that names, patterns and folders mean, each once, in the order given.

    Folders are searched with subfolders for SigMF metadata, unless a ``datatype`` is given. Refuses
    a pattern or folder without any, and two captures of one name.
    """
    found: dict[str, NamedCapture] = {}
    for argument in given:
        if not argument:
            raise InputError(argument, "is not the name of a capture")
        for capture in _meant_by(argument, datatype):
            other = found.setdefault(capture.name, capture)
            if os.path.realpath(other.path) != os.path.realpath(capture.path):
                rule = f"has the same name as {other.path}; give the folder that contains both"
                raise InputError(capture.path, rule)
    return list(found.values())


def is_one(given: Sequence[str]) -> bool:
    """Whether one capture is named, and not a folder or a pattern."""
    return len(given) == 1 and not _is_folder(given[0]) and not _is_pattern(given[0])


def _meant_by(argument: str, datatype: str | None) -> list[NamedCapture]:
    if _is_pattern(argument):
        found = [_named(match, datatype) for match in _matches(argument) if not _is_folder(match)]
        captures = _without_second_antennas(
            each
            for each in dict.fromkeys(found)
            if datatype or is_snapshots(each.path) or Path(each.path + _META).exists()
        )
    elif _is_folder(argument):
        if datatype is not None:
            rule = "is a folder; name the files of raw samples, for example with a pattern"
            raise InputError(argument, rule)
        folder = Path(argument)
        named = []
        for file in sorted(_files_in(folder)):
            stem = file.with_name(file.name.removesuffix(_META).removesuffix(SNAPSHOTS_SUFFIX))
            path = file if is_snapshots(file) else stem
            named.append(NamedCapture(stem.relative_to(folder).as_posix(), str(path)))
        captures = _without_second_antennas(named)
    else:
        return [_named(argument, datatype)]
    if not captures:
        raise InputError(argument, "contains no captures: no .sigmf-meta or .npz files")
    return captures


def _matches(pattern: str) -> list[str]:
    """Paths that match as by :func:`glob.glob`, but `**` follows no links, which may be endless."""
    own = Path(pattern).parts
    if "**" not in own:
        return sorted(glob.glob(pattern))
    root = Path(pattern).anchor
    below = [*own[bool(root) :], *(["*"] if own[-1] == "**" else [])]
    return sorted(
        str(path)
        for path in Path(root).glob("/".join(below))
        if not any(part.startswith(".") and part not in own for part in path.parts)
    )


def _files_in(folder: Path) -> Iterator[Path]:
    """Metadata and channel snapshots below a folder, all of which must be readable."""

    def refuse(error: OSError) -> None:
        raise InputError(error.filename, f"cannot be searched ({error.strerror})") from error

    for place, _, names in os.walk(folder, onerror=refuse):
        yield from (
            Path(place) / name for name in names if name.endswith((_META, SNAPSHOTS_SUFFIX))
        )


def _named(path: str, datatype: str | None) -> NamedCapture:
    if datatype is None and is_snapshots(path):
        return NamedCapture(Path(path).stem, path)
    stem = path if datatype is not None else stem_of(path)
    return NamedCapture(Path(stem).name, stem)


def _without_second_antennas(named: Iterable[NamedCapture]) -> list[NamedCapture]:
    """Leave out the recordings that are read together with those of a first antenna."""
    captures = list(named)
    beside = {second_antenna(capture.path) for capture in captures}
    return [capture for capture in captures if capture.path not in beside]


def _is_folder(argument: str) -> bool:
    # A capture may have the name of a folder beside it.
    return Path(argument).is_dir() and not Path(f"{argument.rstrip('/')}{_META}").exists()


def _is_pattern(argument: str) -> bool:
    return glob.has_magic(argument) and not any(
        Path(argument + suffix).exists() for suffix in ("", *SUFFIXES)
    )
