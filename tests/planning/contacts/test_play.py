"""Play of parts across their ways in, and the chance to fit, against formulas and drawn positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import Box, Cylinder, Element, shape_of
from planning.contacts.play import ISO_9283, Play, play
from planning.contacts.touching import Lying
from planning.transforms import from_rpy, translation
from tests.planning.contacts.test_interference import bored, thing

DOWN = np.array([0.0, 0.0, -1.0])


def slot(width: float, walls: tuple[str, ...] = ("left", "right")) -> Lying:
    """Return walls of 20 mm beside a slot around the origin."""
    places = {
        "left": (-1.0, 0.0),
        "right": (1.0, 0.0),
        "front": (0.0, -1.0),
        "back": (0.0, 1.0),
    }
    away = 0.5 * width + 0.01
    elements = []
    for name in walls:
        x, y = places[name]
        size = (0.02, 0.06, 0.02) if x else (0.06, 0.02, 0.02)
        elements.append(Element(Box(size), translation(away * x, away * y, 0.0)))
    return thing(shape_of("slot", elements))


@settings(deadline=None, max_examples=20)
@given(
    st.floats(0.0001, 0.001), st.floats(0.0, 0.9), st.floats(0.0, 6.3), st.booleans()
)
def test_a_peg_in_a_bore_can_go_as_far_as_the_circle_of_its_axis_reaches(
    room: float, share: float, turn: float, turned: bool
) -> None:
    at = from_rpy((0.1, 0.2, 0.3), (0.5, 0.4, 0.3)) if turned else np.eye(4)
    block = thing(bored(0.005, 48, 0.02, 0.02), at)
    off = share * room * np.array([math.cos(turn), math.sin(turn), 0.0])
    peg = thing(Cylinder(0.005 - room, 0.03), at @ translation(*off))
    found = play(peg, {"block": block}, at[:3, :3] @ DOWN)
    assert found is not None
    assert found.beside == ("block",)
    assert found.free.max() <= room * (1.0 + share) + 1e-6
    assert found.least == pytest.approx(room * (1.0 - share), abs=0.03 * room + 1e-6)
    # All around together they are the diameter, whichever way through the centre.
    chord = found.free + np.roll(found.free, 16)
    assert chord.max() <= 2.0 * room + 1e-6
    assert chord.min() >= 2.0 * room * math.sqrt(1.0 - share * share) - 1e-6


def test_play_is_that_between_walls_and_words_say_which() -> None:
    key = thing(Box((0.02, 0.02, 0.02)))
    for walls, words in (
        (("left", "right"), "0.40 mm from side to side"),
        (("left", "right", "front", "back"), "0.20 mm on all sides"),
    ):
        found = play(key, {"slot": slot(0.0204, walls)}, DOWN)
        assert found is not None
        assert found.words == words
    for walls in (("left",), ("left", "front")):
        assert play(key, {"slot": slot(0.0204, walls)}, DOWN) is None
    assert play(key, {"slot": slot(0.0304)}, DOWN) is None


def test_what_it_rests_on_does_not_hold_it_and_a_press_has_no_play() -> None:
    key = thing(Box((0.02, 0.02, 0.02)))
    table = thing(Box((1.0, 1.0, 0.02)), translation(0.0, 0.0, -0.02))
    assert play(key, {"table": table}, DOWN) is None
    found = play(key, {"table": table, "slot": slot(0.01996)}, DOWN)
    assert found is not None
    assert found.words == "pressed in by 0.02 mm"
    assert found.beside == ("slot",)
    assert found.chance(0.0001) is None


@pytest.mark.parametrize("repeatability", [0.0002, 0.0005, 0.002])
def test_the_chance_is_the_share_of_drawn_positions_that_fit(
    repeatability: float,
) -> None:
    """Positions are drawn in space; what is off along the way in does not matter."""
    spread = repeatability / ISO_9283
    drawn = spread * np.random.default_rng(5).standard_normal((200_000, 3))
    away = np.linalg.norm(drawn, axis=1)
    stated = away.mean() + 3.0 * away.std()
    assert stated == pytest.approx(repeatability, rel=0.01)
    room, off = 0.0003, np.array([0.0001, 0.00005])
    peg = thing(Cylinder(0.005 - room, 0.03), translation(*off, 0.0))
    found = play(peg, {"block": thing(bored(0.005, 48, 0.02, 0.02))}, DOWN)
    assert found is not None
    fits = np.linalg.norm(drawn[:, :2] + off, axis=1) <= room
    assert found.chance(repeatability) == pytest.approx(fits.mean(), abs=0.006)


def test_who_repeats_exactly_always_fits() -> None:
    even = Play(np.full(32, 1e-4), ("block",))
    assert even.chance(0.0) == 1.0
    closer = [even.chance(r) for r in (1e-3, 1e-4, 1e-5)]
    assert closer == sorted(closer)  # type: ignore[type-var]
    assert closer[-1] == pytest.approx(1.0, abs=1e-9)
