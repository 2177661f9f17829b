"""What the audit is told of a scenario: places, what holds objects, and fingers."""

from pathlib import Path

import numpy as np
import pytest

from planning.transforms import rotation
from twin.audit.wanted import Wanted
from twin.planning.kind import assembly_kind
from twin.scenario.manifest import load_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios"


def wanted(name: str) -> Wanted:
    scenario = load_scenario(SCENARIOS / name)
    return assembly_kind(scenario.assembly).wanted(scenario.cell)


@pytest.mark.parametrize(
    "path", sorted(SCENARIOS.glob("*/*.yaml")), ids=lambda p: str(p.stem)
)
def test_every_step_has_its_place(path: Path) -> None:
    scenario = load_scenario(path)
    kind = assembly_kind(scenario.assembly)
    places = kind.wanted(scenario.cell).places
    # Some robots only move, and what lines make leaves the cell.
    nothing = path.stem in ("multi_goal", "kitting", "machine_tending")
    processes = kind.wanted(scenario.cell).processes
    assert len(places) + len(processes) == (0 if nothing else kind.steps())
    spots = {tuple(np.round(place.pose[:3, 3], 6)) for place in places}
    assert len(spots) == len(places)


def test_places_of_bricks() -> None:
    """By hand: the plate has 48 x 48 studs of 8 mm, its middle at (0.44, 0, 1.1145)."""
    found = wanted("lego/cliff.yaml")
    assert found.hold == "studs"
    assert (found.touch_m, found.opening_m) == (0.002, 0.0)
    first, last = found.places[0], found.places[-1]
    assert (first.words, first.kind, first.object) == (
        "step 1: 2x6 at [23, 14, 1]",
        "2x6",
        None,
    )
    assert first.pose[:3, 3] == pytest.approx([0.44, -0.056, 1.1145 + 0.0048])
    assert first.pose[:3, :3] == pytest.approx(np.eye(3))
    assert last.pose[:3, 3] == pytest.approx([0.44, 0.008, 1.1145 + 8.5 * 0.0096])
    assert [place.held for place in found.places] == [False] * 8 + [True] * 3


def test_places_of_parts() -> None:
    found = wanted("multi_arm/rearrangement.yaml")
    assert (found.hold, found.opening_m) == ("weight", 0.04)
    first = found.places[0]
    assert first.object == "rod_west"
    assert first.pose[:3, 3] == pytest.approx([-0.1, 0.0, 0.1825])
    assert first.pose[:3, :3] == pytest.approx(rotation("z", np.pi / 2)[:3, :3])


def test_places_of_a_model() -> None:
    found = wanted("construction/tower.yaml")
    assert (found.hold, found.touch_m) == ("joints", 0.03)
    heights = [place.pose[2, 3] for place in found.places]
    assert np.diff(heights) == pytest.approx(np.diff(heights)[0])
    assert all(place.object for place in found.places)
