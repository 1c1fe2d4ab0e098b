# SPDX-License-Identifier: GPL-3.0-or-later
"""Which captures are meant by names, patterns and folders."""

import glob
import os
from dataclasses import dataclass
from pathlib import Path

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture_files import (
    SNAPSHOTS_SUFFIX,
    SUFFIXES,
    is_snapshots,
    second_antenna,
)

_META = ".sigmf-meta"


@dataclass(frozen=True)
class NamedCapture:
    """A capture, and what its readings are called.

    Attributes
    ----------
    name : str
        Path from the folder in which it was found, or its file's name; without suffix.
    path : str
        As it is opened.
    """

    name: str
    path: str


def find_captures(given, datatype=None):
    """The captures that are meant by the arguments of a command.

    Parameters
    ----------
    given : sequence of str
        Captures, patterns such as ``day*/press*``, and folders, which are searched with their
        subfolders for SigMF metadata.
    datatype : str, optional
        The captures are files of raw samples of this type, so that folders are not searched.

    Returns
    -------
    list of NamedCapture
        Each once, in the order of the arguments, those of a pattern or folder by name.

    Raises
    ------
    InputError
        When a pattern or folder contains none, or two captures would have the same name.
    """
    found = {}
    for argument in given:
        if not argument:
            raise InputError(argument, "is not the name of a capture")
        for capture in _meant_by(argument, datatype):
            other = found.setdefault(capture.name, capture)
            if os.path.realpath(other.path) != os.path.realpath(capture.path):
                rule = f"has the same name as {other.path}; give the folder that contains both"
                raise InputError(capture.path, rule)
    return list(found.values())


def refuse_scenes(given):
    """Refuse the name of a shipped scene where a capture is meant.

    Parameters
    ----------
    given : sequence of str
        As for :func:`find_captures`.

    Raises
    ------
    InputError
    """
    for name in given:
        if os.path.exists(name) or os.path.exists(name + _META):
            continue
        from gnuradio.wiforce.scene import shipped_scenes  # not for the start of the command

        if name in shipped_scenes():
            raise InputError(name, "is a scene and not a capture; give it by --scene")


def is_one(given):
    """Whether the arguments name one capture, and not a folder or a pattern."""
    return len(given) == 1 and not _is_folder(given[0]) and not _is_pattern(given[0])


def _meant_by(argument, datatype):
    if _is_pattern(argument):
        matches = _matches(argument)
        found = list(
            dict.fromkeys(
                capture
                for match in matches
                for capture in ([] if _is_folder(match) else [_named(match, datatype)])
                if datatype is not None
                or is_snapshots(capture.path)
                or Path(capture.path + _META).exists()
            )
        )
        captures = _without_second_antennas(found)
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


def _matches(pattern):
    """Paths that match, as :func:`glob.glob` finds them, but `**` does not follow links.

    Two links that lead to a folder above them would otherwise be followed forever.
    """
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


def _files_in(folder):
    """Metadata and channel snapshots below a folder, all of which must be readable."""

    def refuse(error):
        raise InputError(error.filename, f"cannot be searched ({error.strerror})") from error

    for place, _, names in os.walk(folder, onerror=refuse):
        yield from (
            Path(place) / name for name in names if name.endswith((_META, SNAPSHOTS_SUFFIX))
        )


def _named(path, datatype):
    stem = path
    if datatype is None:
        for suffix in SUFFIXES:
            stem = stem.removesuffix(suffix)
        if is_snapshots(path):
            return NamedCapture(Path(path).stem, path)
    return NamedCapture(Path(stem).name, stem)


def _without_second_antennas(captures):
    """Leave out the recordings that are read together with those of a first antenna."""
    beside = {second_antenna(capture.path) for capture in captures}
    return [capture for capture in captures if capture.path not in beside]


def _is_folder(argument):
    # A capture may have the name of a folder beside it.
    return Path(argument).is_dir() and not Path(f"{argument.rstrip('/')}{_META}").exists()


def _is_pattern(argument):
    return glob.has_magic(argument) and not any(
        Path(argument + suffix).exists() for suffix in ("", *SUFFIXES)
    )
