# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that make up a capture, by name."""

import os
from pathlib import Path

from ...errors import InputError

SUFFIXES = (".sigmf-data", ".sigmf-meta")
SNAPSHOTS_SUFFIX = ".npz"


def recording_stem(name: str | Path, where: str) -> str:
    """The path of a capture to be written, without suffix.

    Parameters
    ----------
    name : str or Path
        With or without ``.sigmf-data`` or ``.sigmf-meta``.
    where : str
        Name of the option or parameter, for the message.

    Returns
    -------
    str

    Raises
    ------
    InputError
        For a name that no pair of files can have: an empty one, a folder, a device.

    Examples
    --------
    >>> recording_stem("runs/press.sigmf-data", "--record")
    'runs/press'
    >>> recording_stem(".", "--record")
    Traceback (most recent call last):
    ...
    gnuradio.wiforce.errors.InputError: --record: must be the name of a capture, to which \
.sigmf-data and .sigmf-meta are added, got '.'
    """
    text = os.fspath(name)
    stem = text.removesuffix(".sigmf-data").removesuffix(".sigmf-meta")
    path = Path(stem)
    rule = "must be the name of a capture, to which .sigmf-data and .sigmf-meta are added"
    if os.path.basename(stem) in ("", ".", "..") or not text.isprintable():
        raise InputError(where, rule, text)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(where, f"{rule}, not that of a device", text)
    return stem


def second_antenna(name: str | Path) -> str:
    """Path of the second antenna's capture.

    Parameters
    ----------
    name : str or Path
        That of the first antenna's, without suffix.

    Returns
    -------
    str
        Without suffix.

    Examples
    --------
    >>> second_antenna("press")
    'press.antenna2'
    """
    return f"{name}.antenna2"


def files_of(data: Path) -> tuple[Path, ...]:
    """All files of a capture that exist.

    Parameters
    ----------
    data : Path
        Its samples.

    Returns
    -------
    tuple of Path
        Samples, and the metadata and the files of a second antenna where there are any.

    Examples
    --------
    >>> files_of(Path("press.sigmf-data"))
    (PosixPath('press.sigmf-data'),)
    """
    stem = data.with_suffix("") if data.suffix in SUFFIXES else data
    names = [f"{name}{suffix}" for name in (stem, second_antenna(stem)) for suffix in SUFFIXES]
    others = [path for path in map(Path, names) if path.exists() and path != data]
    return (data, *others)


def is_snapshots(path: str | Path) -> bool:
    """Whether a file is one of channel snapshots, by its name.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    bool

    Examples
    --------
    >>> is_snapshots("press.npz"), is_snapshots("press.sigmf-data")
    (True, False)
    """
    return Path(path).suffix.lower() == SNAPSHOTS_SUFFIX
