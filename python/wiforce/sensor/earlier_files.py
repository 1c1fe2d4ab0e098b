# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor files of versions before 1.0, in the keys of today (docs/install.md)."""

from typing import Any

from ..io.text.values import KeyPath
from .location import SHAPES

# The columns of a row of `interpolation`, which had no names: the shape as its position in SHAPES,
# fade and shift in mm, correlation length and relative variance of the residual.
_COLUMNS = (
    "shape",
    "fade_mm",
    "shift_mm",
    "residual_length_mm",
    "probability",
    "residual_variance",
)


def with_present_keys(content: dict[str, Any], top: KeyPath) -> dict[str, Any]:
    """The content of a sensor file whose keys are those of the present version.

    Rows of numbers under ``interpolation`` become transitions without a spread of their own, which
    is what each row stood for: the readings are those of the earlier version.

    Returns dict: `content` itself if its keys are those of the present version.

    Parameters
    ----------
    content : dict
        Of a file of any version. It is not changed.
    top : KeyPath
        The file, for messages.

    Raises
    ------
    InputError
        For a row that no version wrote.
    """
    carriers = content.get("carriers")
    if not isinstance(carriers, list) or not any(map(_has_rows, carriers)):
        return content
    where = top.key("carriers")
    return content | {
        "carriers": [_with_transitions(each, where.item(i)) for i, each in enumerate(carriers)]
    }


def _has_rows(carrier: Any) -> bool:
    rows = carrier.get("interpolation") if isinstance(carrier, dict) else None
    return isinstance(rows, list) and any(isinstance(row, list) for row in rows)


def _with_transitions(carrier: Any, path: KeyPath) -> Any:
    if not _has_rows(carrier):
        return carrier
    where = path.key("interpolation")
    rows = enumerate(carrier["interpolation"])
    return carrier | {"interpolation": [_transition(row, where.item(i)) for i, row in rows]}


def _transition(row: Any, where: KeyPath) -> dict[str, Any]:
    if not isinstance(row, list) or len(row) != len(_COLUMNS):
        raise where.error(f"must be a row of {len(_COLUMNS)} numbers, as before version 1.0", row)
    values = dict(zip(_COLUMNS, row, strict=True))
    if row[0] not in range(len(SHAPES)):
        rule = f"must begin with the number of a shape, 0 to {len(SHAPES) - 1}"
        raise where.error(rule, row[0])
    shape = SHAPES[int(row[0])]
    return values | {"shape": shape, "fade_relative_std": 0.0, "shift_std_mm": 0.0}
