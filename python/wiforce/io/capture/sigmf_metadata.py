# SPDX-License-Identifier: GPL-3.0-or-later
"""Metadata of SigMF captures, written as SigMF 1.2 defines them; what is read of them is checked.

The package ``sigmf`` writes the same, but no Debian release has it. The tests compare with it.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError
from ..text.textfile import read_bytes

SPECIFICATION = "1.2.6"
MAX_METADATA_BYTES = 8_000_000
_CHUNK_BYTES = 1 << 20
_SECTIONS = ("global", "captures", "annotations")
# Integers of SigMF's schema fit into 64 bits with a sign; Python reads any number of digits.
_LARGEST = 2**63 - 1


class _Rule(NamedTuple):
    """What SigMF's schema asks of one key."""

    kind: str
    lowest: float = 0


_TEXT = _Rule("string")
_COUNT = _Rule("integer")
_GLOBAL = {
    "core:datatype": _TEXT,
    "core:sample_rate": _Rule("number", 5e-324),  # above 0
    "core:num_channels": _Rule("integer", 1),
    "core:sha512": _TEXT,
    "core:dataset": _TEXT,
    "core:trailing_bytes": _COUNT,
    "wiforce:samples": _COUNT,
}
_CAPTURE = {
    "core:sample_start": _COUNT,
    "core:frequency": _Rule("number", -_LARGEST),
    "core:global_index": _COUNT,
    "core:header_bytes": _COUNT,
    "wiforce:retuned": _Rule("boolean"),
}
_TYPES: dict[str, tuple[type, ...]] = {
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "object": (dict,),
    "array": (list,),
    "boolean": (bool,),
}


def read_metadata(path: Path) -> tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]:
    """The ``global`` and the ``captures`` of a metadata file; InputError names a key."""
    try:
        parsed = json.loads(read_bytes(path, MAX_METADATA_BYTES), object_pairs_hook=_unique)
    except InputError:
        raise
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise InputError(path, f"is not valid SigMF ({str(error)[:120]})") from error
    if not isinstance(parsed, dict):
        raise InputError(path, "must hold a SigMF object", type(parsed).__name__)
    for name in ("global", "captures"):
        if name not in parsed:
            raise InputError(path, f"is not valid SigMF (key '{name}' is missing)")
    whole, captures = parsed["global"], parsed["captures"]
    _check_object(path, "global: ", whole, _GLOBAL, "core:datatype")
    _check_value(path, "captures: ", captures, _Rule("array"))
    for index, capture in enumerate(captures):
        _check_object(path, f"captures: {index}: ", capture, _CAPTURE, "core:sample_start")
    starts = [capture["core:sample_start"] for capture in captures]
    if starts != sorted(starts):
        rule = "core:sample_start must not decrease from item to item"
        raise InputError(path, f"captures: is not valid SigMF ({rule})")
    return whole, captures


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, of which Python would keep the last of equal keys without a word."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in found if keys.count(key) > 1)
        raise ValueError(f"key {_shown(twice)} is given more than once")
    return found


def _check_object(
    path: Path, where: str, values: Any, rules: Mapping[str, _Rule], required: str
) -> None:
    _check_value(path, where, values, _Rule("object"))
    if required not in values:
        raise InputError(path, f"{where}is not valid SigMF (key '{required}' is missing)")
    for key in rules.keys() & values.keys():
        _check_value(path, f"{where}{key}: ", values[key], rules[key])


def _check_value(path: Path, where: str, value: Any, rule: _Rule) -> None:
    # To Python, true and false are integers.
    valid = isinstance(value, _TYPES[rule.kind])
    valid &= isinstance(value, bool) == (rule.kind == "boolean")
    asked = f"of type '{rule.kind}'"
    if valid and rule.kind in ("integer", "number"):
        # NaN, which JSON does not have but Python reads, is outside of every range.
        valid = rule.lowest <= value <= _LARGEST
        asked = f"a number from {rule.lowest:g} to {_LARGEST:g}"
    if not valid:
        raise InputError(path, f"{where}is not valid SigMF ({_shown(value)} is not {asked})")


def _shown(value: Any) -> str:
    """A value in a message; one that holds others may be nested too deeply to print."""
    return type(value).__name__ if isinstance(value, dict | list) else repr(value)[:40]


def sha512_of(path: Path) -> str:
    """The checksum of samples, in hexadecimal digits."""
    checksum = hashlib.sha512()
    with open(path, "rb") as samples:
        while chunk := samples.read(_CHUNK_BYTES):
            checksum.update(chunk)
    return checksum.hexdigest()


def write_metadata(
    path: Path,
    data: Path,
    fields: Mapping[str, Any],
    captures: Sequence[Mapping[str, Any]],
) -> None:
    """Write the metadata of complete samples with version and checksum, or raise OSError."""
    added = {"core:version": SPECIFICATION, "core:sha512": sha512_of(data)}
    whole = {"global": {**fields, **added}, "captures": list(captures), "annotations": []}
    # Keys are sorted, but the sections keep their order.
    in_order = {name: json.loads(json.dumps(whole[name], sort_keys=True)) for name in _SECTIONS}
    with open(path, "w", encoding="utf-8") as stream:
        json.dump(in_order, stream, indent=4, separators=(",", ": "))
