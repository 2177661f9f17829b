"""Whatever is wrong with a plan of somebody else is found: one fault of each kind, planted in a good plan."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.planted import planted
from tests.twin.judge.judged import Document, filed, judged, yard
from twin.judge.delays import delayed_spans
from twin.judge.judge import JudgedPlan
from twin.judge.open_plan import read_open_plan
from twin.judge.open_plan_execution import planned_spans
from twin.trial.loaded_scenario import load

Motions = list[dict[str, Any]]
Plant = Callable[[Motions, Motions], None]
WORK = {"skill": "pick", "object": "lower"}


def test_the_plan_of_the_reference_is_clean_at_any_delays(tmp_path: Path) -> None:
    found = judged(yard(tmp_path), tmp_path, seeds=5)
    assert found.clean
    assert found.planned_s == 32.0
    assert found.mean_s is not None
    assert found.p95_s is not None
    assert found.planned_s < found.mean_s < found.p95_s


def test_the_same_plan_by_the_clock_is_clean_until_somebody_is_late(
    tmp_path: Path,
) -> None:
    content = yard(tmp_path)
    content["execution"] = "clock"
    for robot in content["robots"].values():
        for motion in robot["motions"]:
            motion.pop("after", None)
    file = filed(content, tmp_path)
    plan = read_open_plan(file)
    case = JudgedPlan(plan, file, load(tmp_path / "yard.yaml"))
    assert case.audit_spans(planned_spans(plan))[0] == ()

    def behind(seed: int) -> float:
        spans = delayed_spans(plan, case.rules.stretch, seed)
        out = plan.motions["west"][-1]
        return spans[out.id].end(out) - spans["east swings in"].begin

    worst = max(range(100), key=behind)
    late = delayed_spans(plan, case.rules.stretch, worst)
    assert behind(worst) > 3.0
    assert case.delayed(worst, late).contacts > 0


def _set(place: str, value: str) -> Plant:
    """Return the fault that another value stands somewhere in a plan."""
    robot, *keys = place.split()
    *displacement, last = (int(key) if key.isdigit() else key for key in keys)

    def plant(west: Motions, east: Motions) -> None:
        found: Any = {"west": west, "east": east}[robot]
        for key in displacement:
            found = found[key]
        found[last] = json.loads(value)

    return plant


def _later(some: Motions, by: float, first: int = 0) -> None:
    for motion in some[first:]:
        motion["t_s"] = [t + by for t in motion["t_s"]]
        for event in motion.get("events", ()):
            event["t_s"] += by


def _takes_what_is_elsewhere(west: Motions, east: Motions) -> None:
    east[1]["events"][0] = {"t_s": 4.6, "take": "lower"}
    west[1]["events"] = []


def _is_not_there_yet(west: Motions, east: Motions) -> None:
    _later(east, -15.0, 2)
    _later(west, 15.0, 2)
    east[2].pop("after")


def _jumps(west: Motions, east: Motions) -> None:
    west[2]["q"][0][0] += 0.2


def _jumps_at_the_start(west: Motions, east: Motions) -> None:
    west[0]["q"][0][1] -= 0.1


def _passes_between_two_rows(west: Motions, east: Motions) -> None:
    q = [[1.5708, 3, 0.5, 0], [-1.5708, 3, 0.5, 0]]
    east.insert(2, {"id": "east sweeps", "t_s": [8, 17], "q": q})
    east[3]["q"][0] = q[1]
    west[3]["q"][0][2] = west[2]["q"][1][2]


def _does_not_wait(west: Motions, east: Motions) -> None:
    east[2].pop("after")
    _later(east, -15.0, 2)


def _swings_low(west: Motions, east: Motions) -> None:
    for row in (west[1]["q"][2], west[2]["q"][0], west[2]["q"][1], west[3]["q"][0]):
        row[2] = 1.24
    west[2]["q"].insert(1, [0.8, 3.2, 1.45, -0.8])
    west[2]["t_s"].insert(1, 9.5)
    west[2]["q"][2][1] = west[3]["q"][0][1] = 3.0


def _places_beside(west: Motions, east: Motions) -> None:
    for row in (west[2]["q"][1], *west[3]["q"], west[4]["q"][0]):
        row[1] -= 0.03


def _places_turned(west: Motions, east: Motions) -> None:
    for row in (east[2]["q"][1], *east[3]["q"]):
        row[3] += 0.1


def _never_comes(west: Motions, east: Motions) -> None:
    del east[2:]


def _begins_before_what_it_waits_for(west: Motions, east: Motions) -> None:
    _later(east, -1.0, 2)


def _picks_too_quickly(west: Motions, east: Motions) -> None:
    west[1]["t_s"] = [2, 3.5, 5]
    west[1]["events"][0]["t_s"] = 3.5


def _calls_its_pick_a_move(west: Motions, east: Motions) -> None:
    _picks_too_quickly(west, east)
    del west[1]["skill"], west[1]["object"]


# One value of a plan that is another one: in a motion of a robot, by keys and indices. The flange
# of a crane is 0.13 m above its pad.
VALUES = planted(r"""
fault                               | motion               | value                                         | kind        | who
part taken before the hand is there | west 1 events 0 t_s  | 2.5                                           | grip        | lower
part let go of in the air           | west 3 events 0 t_s  | 13.0                                          | hanging     | lower
part let go of on the way back      | west 3 events 0 t_s  | 16.0                                          | hanging     | lower
part jumps into its place           | west 3 events 0 pose | {"xyz_m": [0.05, 0.0, 1.1]}                   | jump        | lower
part jumps into the hand            | east 1 events 0 pose | {"xyz_m": [0.1, 0.0, -0.23]}                  | jump        | upper
contact with a fixture              | west 3 q 1 2         | 1.26                                          | contact     | lower
contact with a part                 | east 3 q 1 2         | 1.06                                          | contact     | upper
tool too deep in its part           | west 1 q 1 2         | 1.3                                           | contact     | west/
joint too fast                      | west 2 t_s           | [7, 10]                                       | joint-speed | west
sliding joint too fast              | east 0 t_s           | [0, 1]                                        | joint-speed | east
joint out of its range              | west 4 q 1 2         | -0.1                                          | joint-limit | west
part still in the hand              | east 3 events        | []                                            | place       | upper
part gone                           | east 3 events        | [{"t_s": 29.5, "leave": "upper"}]             | place       | upper
waits in a circle                   | west 2 after         | ["east places"]                               | edge-order  | plan
hands full                          | west 2 events        | [{"t_s": 8.0, "take": "upper"}]               | hand        | west
hands empty                         | west 0 events        | [{"t_s": 1.0, "put": "lower"}]                | hand        | west
part of another's hand              | west 3 events 0      | {"t_s": 14.5, "put": "upper"}                 | hand        | west
part taken twice                    | west 2 events        | [{"t_s": 8.0, "take": "lower"}]               | hand        | west
part there twice                    | west 0 events        | [{"t_s": 1.0, "appear": "upper"}]             | hand        | west
part given over a distance          | west 2 events        | [{"t_s": 9.0, "give": "lower", "to": "east"}] | grip        | lower
""")

PLANTED: dict[str, tuple[Plant, str, str]] = {
    "part taken that lies elsewhere": (_takes_what_is_elsewhere, "grip", "lower"),
    "part placed before what it stands on": (_is_not_there_yet, "hanging", "upper"),
    "precedence broken": (_is_not_there_yet, "process", "upper"),
    "robot jumps between motions": (_jumps, "jump", "west"),
    "robot does not begin at HOME": (_jumps_at_the_start, "jump", "west"),
    "contact between two rows": (_passes_between_two_rows, "contact", "west/arm"),
    "contact for want of a wait": (_does_not_wait, "contact", "west/arm"),
    "part dragged through its stand": (_swings_low, "contact", "lower"),
    "wrong goal, beside": (_places_beside, "place", "lower"),
    "wrong goal, turned": (_places_turned, "place", "upper"),
    "part never placed": (_never_comes, "place", "upper"),
    "wait not kept": (_begins_before_what_it_waits_for, "edge-order", "east"),
    "work too short": (_picks_too_quickly, "duration", "west"),
    "work too short under another name": (_calls_its_pick_a_move, "duration", "west"),
}
PLANTED |= {
    name: (_set(place, value), kind, who)
    for name, (place, value, kind, who) in VALUES.items()
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_found(name: str, tmp_path: Path) -> None:
    plant, kind, who = PLANTED[name]
    content: Document = yard(tmp_path)
    west, east = (content["robots"][robot]["motions"] for robot in ("west", "east"))
    plant(west, east)
    found = judged(content, tmp_path, seeds=int(kind == "edge-order"))
    told = [(v.kind, v.first, v.second) for v in found.findings]
    assert any(k == kind and who in f"{a} {b}" for k, a, b in told), told
    assert not found.clean


@pytest.mark.parametrize("called", ["place-down", "pick", "hold"])
def test_work_takes_as_long_as_what_is_done_in_it_under_any_name(
    called: str, tmp_path: Path
) -> None:
    """Whoever puts a part down in what is called a pick, puts it down."""
    content: Document = yard(tmp_path)
    task = tmp_path / "yard.yaml"
    longer = "place-down: {kind: uniform, low_s: 6.0, high_s: 8.0}"
    task.write_text(re.sub("place-down: {.*}", longer, task.read_text()))
    for robot in content["robots"].values():
        robot["motions"][3]["skill"] = called
    told = [v for v in judged(content, tmp_path).findings if v.kind == "duration"]
    assert [v.first for v in told] == ["west", "east"]
    assert all("place-down" in v.detail for v in told)
