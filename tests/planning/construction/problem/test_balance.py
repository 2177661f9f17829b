"""Balance of constructions: every state that robots can come through stands, by another program."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from benchmarks.construction.fine_check.check import check_construction
from planning.cell.workcell import Workcell
from planning.construction.motion_plan_export import motion_plan
from planning.construction.planner import plan_construction
from planning.construction.problem.balance import SiteBalance
from planning.construction.problem.feasibility import require_buildable
from planning.construction.problem.models import ModelPart, pavilion, tower, wall, well
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.site import (
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.construction.problem.supply_layout import Spiral
from planning.errors import ConstructionError
from planning.statics.build_order import UnstableState
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Array
from tests.planning.construction.toy_sites import toy_part, toy_problem

FRICTION = 0.4
_ROUND = np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)


def site(parts: tuple[ModelPart, ...], **rules: object) -> ConstructionProblem:
    """Return a site without robots on which everything must stand."""
    cell = Workcell((), (ground_fixture(),), part_objects(parts, Spiral()))
    statics = StandingRules(friction=FRICTION, **rules)  # type: ignore[arg-type]
    return replace(build_problem(cell, parts), statics=statics)


def corners(part: ModelPart) -> Array:
    """Return the corners of a box where it belongs, shape (8, 3)."""
    signs = np.array(list(product((-0.5, 0.5), repeat=3))) * part.size
    return np.asarray(signs @ part.goal[:3, :3].T + part.goal[:3, 3])


def outline(part: ModelPart) -> Array:
    """Return the outline of an upright box seen from above, counterclockwise, shape (4, 2)."""
    x, y = part.size[:2] / 2
    own = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return np.asarray(own @ part.goal[:2, :2].T + part.goal[:2, 3])


def cut(polygon: list[Array], other: Array) -> list[Array]:
    """Return the part of a polygon within a convex one, by cutting off one side after another."""
    for a, b in zip(other, np.roll(other, -1, axis=0), strict=True):
        side = [(b - a)[0] * (p - a)[1] - (b - a)[1] * (p - a)[0] for p in polygon]
        kept: list[Array] = []
        for k, p in enumerate(polygon):
            q, s, t = polygon[k - 1], side[k], side[k - 1]
            if s * t < 0:
                kept.append(q + (p - q) * t / (t - s))
            if s >= 0:
                kept.append(p)
        polygon = kept
    return polygon


def pushes(parts: Collection[ModelPart]) -> Iterator[tuple[str | None, str, Array]]:
    """Yield lower body (None for the ground), upper body and a corner of where they touch."""
    upright = [p for p in parts if p.goal[2, 2] > 1.0 - 1e-9]
    for part in upright:
        low = part.goal[2, 3] - part.size[2] / 2
        if abs(low) < 1e-6:
            for x, y in outline(part):
                yield None, part.name, np.array([x, y, 0.0])
        for other in upright:
            if abs(other.goal[2, 3] + other.size[2] / 2 - low) < 1e-6:
                for x, y in cut(list(outline(part)), outline(other)):
                    yield other.name, part.name, np.array([x, y, low])


def stands(
    parts: Collection[ModelPart],
    joined: Collection[tuple[str, str]] = (),
    tilts: Collection[tuple[float, float]] = ((0.0, 0.0),),
) -> bool:
    """Tell whether forces in balance exist: a linear program of its own.

    Boxes push up at the corners of horizontal contacts, within a pyramid of four edges; what is
    joined bears everything.
    """
    there = {part.name: part for part in parts}
    number = {name: k for k, name in enumerate(there)}
    columns, bounds = [], []

    def add(
        lower: str | None, upper: str, at: Array, wrench: Array, low: float
    ) -> None:
        column = np.zeros((len(there), 6))
        for name, sign in ((lower, -1.0), (upper, 1.0)):
            if name in number:
                arm = at - there[str(name)].goal[:3, 3]
                force = sign * wrench[:3]
                column[number[str(name)], :3] = force
                column[number[str(name)], 3:] = np.cross(arm, force) + sign * wrench[3:]
        columns.append(column.ravel())
        bounds.append((low, None))

    for lower, upper, at in pushes(parts):
        for angle in _ROUND:
            edge = [FRICTION * np.cos(angle), FRICTION * np.sin(angle), 1.0, 0, 0, 0]
            add(lower, upper, at, np.array(edge), 0.0)
    for pair in joined:
        if {*pair} <= {*there, "ground"}:
            first, second = sorted(pair, key=lambda name: name in there)
            for wrench in np.eye(6):
                at = there[second].goal[:3, 3]
                add(first, second, at, wrench, -np.inf)
    for x, y in tilts:
        weights = np.zeros((len(there), 6))
        for name, part in there.items():
            weights[number[name], :3] = part.mass * 9.81 * np.array([-x, -y, 1.0])
        found = linprog(
            np.zeros(len(columns)),
            A_eq=np.array(columns).T,
            b_eq=weights.ravel(),
            bounds=bounds,
        )
        if found.status != 0:
            return False
    return True


def some_order(balance: SiteBalance, rng: np.random.Generator) -> dict[str, float]:
    """Return parts in an order of planning that is drawn, and when each is in place."""
    placed: dict[str, float] = {}
    while ready := balance.placeable(placed):
        part = ready[int(rng.integers(len(ready)))]
        needed = balance.needs(part, placed)
        assert not isinstance(needed, UnstableState)
        since = max((placed[n] for n in needed), default=0.0)
        placed[part] = since + float(rng.uniform(0.1, 5.0))
    return placed


def needs_of(
    balance: SiteBalance, placed: Mapping[str, float]
) -> dict[str, frozenset[str]]:
    out: dict[str, frozenset[str]] = {}
    before: dict[str, float] = {}
    for name, end in placed.items():
        found = balance.needs(name, before)
        assert not isinstance(found, UnstableState)
        out[name], before[name] = found, end
    return out


def reachable(
    needs: Mapping[str, frozenset[str]], rng: np.random.Generator
) -> Iterator[list[str]]:
    """Yield the states of a run in which robots wait only where they must, in a drawn order."""
    done: list[str] = []
    while len(done) < len(needs):
        ready = [n for n, own in needs.items() if n not in done and own <= {*done}]
        done.append(ready[int(rng.integers(len(ready)))])
        yield list(done)


SHIPPED = {
    "tower": (tower(), {}),
    "well": (well(7, 3), {}),
    "wall": (wall(4), {"joined_within": 0.03}),
    "pavilion": (pavilion((5, 6)), {"joined_within": 0.03}),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_every_state_of_the_models_stands(name: str) -> None:
    parts, rules = SHIPPED[name]
    problem = site(parts, **rules)
    balance, rng = problem.balance, np.random.default_rng(3)
    assert balance.standing is not None
    named = {part.name: part for part in parts}
    joined = [joint.ends for joint in balance.standing.joints]
    placed = some_order(balance, rng)
    assert len(placed) == len(parts)
    needs = needs_of(balance, placed)
    by_time = sorted(placed, key=placed.__getitem__)
    planned = [by_time[:k] for k in range(1, len(parts) + 1)]
    for state in (*planned, *reachable(needs, rng)):
        assert stands([named[n] for n in state], joined), state


def test_the_wall_and_the_pavilion_fall_where_nothing_is_joined() -> None:
    parts = wall(3)
    problem = site(parts)
    with pytest.raises(
        ConstructionError, match="block4_3 would not stand once block4_3"
    ):
        require_buildable(problem)
    ends = [p for p in parts if p.name in ("block1_3", "block2_3")]
    assert not stands(ends)
    with pytest.raises(
        ConstructionError, match=r"cassette1_1 would not stand .* nothing"
    ):
        require_buildable(site(pavilion((5,))))


POST = toy_part("post", (0.3, 0.3, 0.4), (0.0, 0.0, 0.2))
BEAM = toy_part("beam", (0.55, 0.2, 0.1), (0.1, 0.0, 0.45))
WEIGHT = replace(toy_part("weight", (0.2, 0.2, 0.2), (-0.05, 0.0, 0.6)), mass=20.0)
TIP = toy_part("tip", (0.2, 0.2, 0.1), (0.27, 0.0, 0.55))


def test_what_needs_a_counterweight_comes_after_it() -> None:
    problem = site((POST, BEAM, TIP, WEIGHT))
    balance = problem.balance
    placed = {"post": 1.0, "beam": 2.0}
    assert balance.placeable(placed) == ("weight",)
    assert isinstance(balance.needs("tip", placed), UnstableState)
    placed["weight"] = 3.0
    assert balance.needs("tip", placed) == frozenset({"beam", "weight"})
    assert not stands([POST, BEAM, TIP])
    assert stands([POST, BEAM, TIP, WEIGHT])


LONG = toy_part("long", (0.7, 0.2, 0.1), (0.22, 0.0, 0.45))
END = toy_part("end", (0.1, 0.1, 0.1), (0.5, 0.0, 0.55))


def test_what_would_fall_is_kept_hold_of_until_it_stands() -> None:
    """The middle of the long beam is not above the post; the weight on its other end keeps it."""
    parts = {p.name: p for p in (POST, LONG, WEIGHT, END)}
    problem = site(tuple(parts.values()))
    balance, placed = problem.balance, {"post": 1.0}
    assert balance.never_placeable() is None
    assert not stands([POST, LONG])
    assert stands([POST, LONG, WEIGHT])
    assert balance.placeable(placed) == ()
    assert list(balance.held(placed)) == [("long", "weight")]
    placed["long"] = 2.0
    assert balance.placeable(placed) == ("weight",)
    assert balance.needs("weight", placed) == frozenset({"long"})
    placed["weight"] = 3.0
    assert balance.placeable(placed) == ("end",)
    needed = balance.needs("end", placed)
    assert isinstance(needed, frozenset)
    assert needed >= {"long", "weight"}
    # On the far end it would tip, and no later part could hold that.
    falls = site((POST, LONG, END)).balance.never_placeable()
    assert falls is not None
    body, why = falls
    assert body == "long"
    assert why.startswith("long would not stand once long")


def test_two_robots_build_what_falls_while_one_of_them_lets_go() -> None:
    able_alone = toy_problem((POST, LONG, WEIGHT, END), 2)
    problem = replace(able_alone, statics=StandingRules(friction=FRICTION))
    plan = plan_construction(problem)
    ends = plan.building.placed
    assert list(ends) == ["post", "long", "weight", "end"]
    by = {w.object: w.robot for w in plan.building.work if w.kind == "place-down"}
    keeping = plan.building.kept["long"]
    assert (keeping.robot, keeping.last) == (by["long"], "weight")
    assert by["weight"] != by["long"]
    # It stands from the moment at which it puts the beam down until the weight is there.
    line = plan.building.world.robots[keeping.robot]
    held = [line.at(t) for t in np.linspace(ends["long"], ends["weight"], 20)]
    assert np.ptp(held, axis=0).max() < 1e-9
    assert keeping.end >= ends["weight"]
    assert check_construction(plan).faults == ()
    motions = motion_plan(problem, plan.building)
    (let_go,) = (
        task.index
        for task in motions.tasks
        if task.object == "long" and task.robot == by["long"] and not task.handlings
        if motions.motions[task.index].time[0] > ends["long"] - 1e-9
    )
    placed = next(
        t.index for t in motions.tasks if (t.kind, t.object) == ("place-down", "weight")
    )
    assert [placed, let_go] in motions.dependencies.tolist()


def test_joints_that_bear_so_much_keep_the_order_of_planning() -> None:
    weak = (Joint("beam", "tip", force=30.0, torque=10.0),)
    balance = site((POST, BEAM, TIP, WEIGHT), joints=weak).balance
    placed = {"post": 1.0, "beam": 2.0, "weight": 3.0}
    assert balance.needs("tip", placed) == frozenset({"beam", "weight"})


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
@example(4653)
def test_every_reachable_state_of_a_pile_stands(seed: int) -> None:
    rng, touch = np.random.default_rng(seed), StandingRules().touch
    parts: list[ModelPart] = []
    for k in range(3):
        for column in range(3):
            size = (float(rng.uniform(0.2, 0.5)), 0.2, 0.1)
            at = (0.35 * column + float(rng.uniform(-0.1, 0.1)), 0.0, 0.1 * k + 0.05)
            own = toy_part(f"p{k}{column}", size, at)
            beside = [
                (abs(at[0] - p.goal[0, 3]) - 0.5 * (size[0] + p.size[0]), p.goal[2, 3])
                for p in parts
            ]
            # What is nearly touched from the side, at its edge at least, bears something.
            near = any(0.0 <= gap < touch for gap, _ in beside)
            if not near and all(
                gap > 0.0 for gap, z in beside if abs(z - at[2]) < 0.01
            ):
                parts.append(replace(own, mass=float(rng.uniform(0.5, 20.0))))
    problem = site(tuple(parts))
    balance = problem.balance
    named = {part.name: part for part in parts}
    placed = some_order(balance, rng)
    needs = needs_of(balance, placed)
    for _ in range(2):
        for state in reachable(needs, rng):
            assert stands([named[n] for n in state])
    # What may not come would fall: gravity is tilted by a degree at most.
    lean = np.tan(np.radians(1.2))
    tilts = [(lean, 0.0), (-lean, 0.0), (0.0, lean), (0.0, -lean)]
    for part in problem.graph.placeable(placed):
        assert not stands([named[n] for n in (*placed, part)], tilts=tilts)


def test_no_robot_is_asked_to_carry_more_than_it_may() -> None:
    problem = toy_problem((POST, replace(BEAM, mass=30.0)), 2)
    light, strong = problem.cell.robots
    drives = light.model.drives
    assert drives is not None
    weak = replace(light.model, drives=replace(drives, payload=20.0))
    cell = replace(problem.cell, robots=(replace(light, model=weak), strong))
    mixed = replace(problem, cell=cell)
    bounds = require_buildable(mixed)
    assert bounds.able_alone(mixed.part("post")) == ("robot1", "robot2")
    assert bounds.able_alone(mixed.part("beam")) == ("robot2",)
    assert not bounds.may_bring(mixed.part("beam"), ("robot2", "robot1"))
    able_alone = replace(cell, robots=cell.robots[:1])
    with pytest.raises(
        ConstructionError, match=r"beam is too heavy .* robot1: .* 20 kg"
    ):
        require_buildable(replace(problem, cell=able_alone))
