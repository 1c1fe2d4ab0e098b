# SPDX-License-Identifier: GPL-3.0-or-later
"""The type of value that names a sounding waveform."""

from dataclasses import dataclass
from typing import Any

from ..io.text.values import KeyPath, Scope, ValueType
from ..signal.waveform import WAVEFORMS

_SUFFIX = ".npy"
_LONGEST = 255


@dataclass(frozen=True, kw_only=True)
class WaveformName(ValueType):
    """The name of a shipped waveform, or the path of a ``.npy`` file with a symbol.

    Parameters
    ----------
    optional : bool
        Whether ``null`` is allowed.
    """

    @property
    def allowed(self) -> str:
        return f"{', '.join(map(repr, WAVEFORMS))} or a path that ends in {_SUFFIX}"

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> str:
        if isinstance(value, str) and value in WAVEFORMS:
            return value
        is_file = isinstance(value, str) and value.isprintable() and len(value) <= _LONGEST
        if not is_file or not value.lower().endswith(_SUFFIX):
            raise where.error(self.rule, value)
        return str(value)

    def _json_schema(self) -> dict[str, Any]:
        path = {
            "type": "string",
            "pattern": r"\.[nN][pP][yY]$",
            "not": {"type": "string", "pattern": r"[\x00-\x1f\x7f]"},
            "maxLength": _LONGEST,
        }
        return {"anyOf": [{"enum": list(WAVEFORMS)}, path]}
