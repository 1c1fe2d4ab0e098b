# SPDX-License-Identifier: GPL-3.0-or-later
"""Advice on a scene with packets: what may go wrong, and the clocks that suit their times."""

from collections.abc import Iterator

from ...errors import InputError
from ...signal.lines import STRONG_LINES, lamp_distances_hz
from ..clocks.mains import lamp_multiples, lines_lie
from ..clocks.proposals import clocks_for
from ..expected import phase_std_deg
from ..plan import Plan
from ..plan import plan as plan_of

# Distance of strong lines from those of lamps, in bins of a group, up to which they interfere.
_NEAR_BINS = 2.0
# SNR of a tag's first line beyond which it is unlikely: channel estimates of cards have 9 to 35 dB,
# and a tag that is half a metre away is 35 dB or more below the direct path (docs/wifi.md).
_HIGHEST_SNR_DB = 0.0


def packet_warnings(plan: Plan) -> Iterator[str]:
    """What the times of packets, lamps and the static paths may do to readings.

    Yields str: a sentence each.

    Parameters
    ----------
    plan : Plan
        Of a scene with packets.
    """
    scene = plan.require_scene()
    mains_hz = scene.environment.possible_mains_hz
    near_hz = _NEAR_BINS / plan.group_period_s
    for clock, name in zip(plan.clocks, scene.sensor_names, strict=True):
        apart = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = [line for line, hz in zip(STRONG_LINES, apart.tolist(), strict=True) if hz < near_hz]
        if near:
            yield (
                f"mains: {lines_lie(near, name)} within {near_hz:.3g} Hz of "
                f"{lamp_multiples(mains_hz)}: where a lamp modulates what it reflects, this tag is "
                "disturbed"
            )
    yield from _alias_warnings(plan)
    snr_db = scene.simulation.snr_db
    if scene.environment.reader_clock == "free" and snr_db > _HIGHEST_SNR_DB:
        yield (
            f"simulation.snr_db: {snr_db:g} dB is more than channel estimates of a Wi-Fi card "
            "allow, unless the tag is next to an antenna, so the errors above are too small; a tag "
            "40 dB below a direct path of 30 dB has -10 dB"
        )


def _alias_warnings(plan: Plan) -> Iterator[str]:
    scene = plan.require_scene()
    lines = plan.table.tones
    for tag, name in enumerate(scene.sensor_names):
        own = [tone.owners for tone in lines if (tag, 1) in tone.owners or (tag, 4) in tone.owners]
        if any(len(owners) > 1 for owners in own) or len(own) < 2:
            yield (
                f"aliases: packets at these times do not separate the lines of '{name}' from each "
                "other or from those of another tag; use another clock, or less regular packets"
            )


def recommendation(plan: Plan) -> str | None:
    """The clocks recommended for a scene with packets, as a sentence.

    Returns str or None: None for a scene of samples, and where no clock is usable.
    """
    scene = plan.require_scene()
    if scene.packets is None:
        return None
    try:
        found = clocks_for(scene, len(scene.sensors))
        std = phase_std_deg(plan_of(scene.with_clocks(dict(enumerate(found.clocks_hz)))))
    except InputError:
        return None
    clocks = [f"sensors[{i}].clock_hz: {hz:g}" for i, hz in enumerate(found.clocks_hz)]
    reason = f"suits packets every {1e3 * scene.snapshot_period_s:.3g} ms"
    if found.lamp_distances_hz is not None:
        lamps = lamp_multiples(scene.environment.possible_mains_hz)
        reason += f", strong lines {min(found.lamp_distances_hz):g} Hz or more from {lamps}"
    noise = "/".join(f"{worst:.3g}" for worst in std.max(axis=0))
    return (
        f"recommended clocks: {', '.join(clocks)} ({reason}); noise {noise} deg rms at snr_db "
        f"{scene.simulation.snr_db:g}"
    )
