# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of readings as text: ISO 8601 in UTC, to the microsecond."""

import re
from datetime import datetime, timezone


def written_utc(utc_s: float | None) -> str:
    """Write a time.

    Returns str: empty for an unknown time.

    Parameters
    ----------
    utc_s : float or None
        Seconds since 1970.
    """
    if utc_s is None:
        return ""
    return datetime.fromtimestamp(utc_s, timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def parsed_utc(text: str) -> datetime:
    """Parse a time that :func:`written_utc`, or another program, has written.

    Parameters
    ----------
    text : str
        With any number of decimals of the second.

    Raises
    ------
    ValueError
        When it is no time.
    """
    # Python 3.10 accepts neither Z nor other decimals than three or six.
    decimals = re.sub(r"\.(\d+)", lambda found: f".{found[1]:0<6.6}", text)
    return datetime.fromisoformat(decimals.replace("Z", "+00:00"))
