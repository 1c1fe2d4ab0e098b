# SPDX-License-Identifier: GPL-3.0-or-later
"""What real rooms and radios add to a simulated scene: one optional mapping per effect.

Only the simulator and the software device use it; a reader is told none of it.
"""

from ..io.schema import declared, key
from ..io.values import Integer, Number, Scope

_LEVEL = Number(unit="dB", low=-100, high=100)
_SHARE = Number(low=0, above=True, high=0.95)
_BURST = Number(unit="s", low=20e-6, high=10)


def _not_below_shortest(longest_s: float, scope: Scope) -> str | None:
    shortest_s = scope["shortest_s"]
    return None if longest_s >= shortest_s else f"must not be below shortest_s ({shortest_s:g})"


@declared
class Bursts:
    """Bursts of other transmitters, such as Wi-Fi frames, over the whole band.

    Examples
    --------
    >>> Bursts(share=0.4).longest_s
    0.002
    """

    share: float = key(_SHARE, default=0.2, doc="Share of the time in which a burst is on the air.")
    shortest_s: float = key(_BURST, default=0.3e-3, doc="Shortest burst.")
    longest_s: float = key(
        _BURST,
        default=2e-3,
        doc="Longest burst. Durations are spread evenly, the pauses between bursts exponentially.",
        check=_not_below_shortest,
    )
    level_db: float = key(
        _LEVEL, default=25.0, doc="Power of a burst relative to the receiver's noise."
    )


@declared
class Hopper:
    """A narrow-band transmitter that hops, such as Bluetooth.

    Examples
    --------
    >>> Hopper().subcarriers
    8
    """

    subcarriers: int = key(
        Integer(low=1, high=64),
        default=8,
        doc="Bandwidth in subcarriers, of which the sample rate holds 64. The centre of each "
        "visit is drawn at random so that the transmission lies within the band.",
    )
    share: float = key(_SHARE, default=0.5, doc="Share of the time in which it transmits.")
    shortest_s: float = key(_BURST, default=5e-3, doc="Shortest visit to a channel.")
    longest_s: float = key(
        _BURST,
        default=20e-3,
        doc="Longest visit to a channel.",
        check=_not_below_shortest,
    )
    level_db: float = key(
        _LEVEL,
        default=30.0,
        doc="Power in a subcarrier that it covers relative to the receiver's noise there.",
    )
