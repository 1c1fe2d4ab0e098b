# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms that nobody described, read with default settings: no confident wrong reading.

``python3 tests/rooms/score.py`` reads all rooms, and any number of mixtures.
"""

from dataclasses import replace

import pytest

from rooms.judge import failures
from rooms.rooms import room_named
from rooms.score import score_capture

# An undisturbed room, and those whose disturbance no other test reads a press in.
ROOMS = ("clean", "walker+30-declared", "near-tag-20ppm", "image-30", "half-frame")
LONG_ROOMS = ("leaky", "faint", "walker+30", "tag-1300-10", "lamps-10", "bursts-20")
# Shorter than the rooms of the score, with both presses, or one in mixtures; the long form reads
# those.
PRESSES = ((0.55, 0.03, 0.36, 3.0, 5.5, 33.0), (1.0, 0.03, 0.36, 6.0, 4.0, 54.0))
MIXTURES, LONG_MIXTURES = (
    tuple(f"mixture-{seed}" for seed in range(1, last + 1)) for last in (2, 10)
)


def pytest_generate_tests(metafunc):
    if "name" in metafunc.fixturenames:
        every = metafunc.config.getoption("--long")
        metafunc.parametrize("name", ROOMS + (LONG_ROOMS + LONG_MIXTURES if every else MIXTURES))


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Sensor models that were calibrated before."""
    return tmp_path_factory.mktemp("models")


def short_room(name):
    if name in ROOMS:
        return replace(room_named(name), presses=PRESSES, duration_s=1.5)
    press = PRESSES[int(name[-1]) % 2]
    return replace(room_named(name), presses=((PRESSES[0][0], *press[1:]),), duration_s=1.05)


def test_undescribed_room_gives_no_confident_wrong_reading(name, cache, tmp_path, long_run):
    """The one thing that the project promises never to give."""
    room = room_named(name) if long_run else short_room(name)
    tally = score_capture(name, 1, tmp_path / "room", cache, room=room)
    assert tally.wrong == 0
    figures = tally.summary()
    assert figures["steady"] >= 8 or room.refusable
    if not name.startswith("mixture"):
        assert "flags" not in failures(room, figures)


def test_presses_suggest_that_ends_are_swapped(cache, tmp_path):
    """On a line that is not symmetric, whole presses show what single readings do not."""
    tally = score_capture("swapped-leaning", 1, tmp_path / "room", cache)
    assert tally.suspected == {"swapped ends": 1}
    # Of the first press only groups that change as no press of this line does.
    assert tally.touches["flagged"][:20].sum() <= 5


@pytest.mark.long
def test_hand_that_comes_with_the_press_enters_the_standard_deviation(cache, tmp_path):
    """Its path cannot be distinguished from force once it touches."""
    tally = score_capture("near-hand-30", 1, tmp_path / "room", cache)
    errors = tally.touches["force_n"].abs() / tally.touches["force_std_n"]
    assert len(errors) > 40 and errors.max() < 3 and not tally.wrong and not tally.suspected
