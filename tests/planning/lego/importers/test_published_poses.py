"""Our skill subgoals against the joint paths that the authors of APEX-MR ship.

Forward kinematics of every waypoint of the published plans, by the product of their
Denavit-Hartenberg tables, must meet our subgoals: written without our robot models on purpose.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from planning.handling.skill_targets import Subgoal
from planning.lego.bricks.assembly import (
    BrickType,
    Cell,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import press_cell
from planning.lego.bricks.grid import top_pose
from planning.lego.importers.apex_mr.importer import import_apex_mr
from planning.lego.skills.handovers import giver_rest_poses, receive_poses
from planning.lego.skills.support_targets import _contact, support_targets
from planning.lego.skills.targets import (
    BrickGrip,
    handover_targets,
    pick_targets,
    place_targets,
    received_top,
)
from planning.transforms import Array, Transform, from_rpy, translation
from tests.planning.lego.importers.published_form import (
    DATA,
    cell_of,
    needs_data,
    types_of,
)

TASKS = ("cliff", "faucet", "bridge")
ROWS_DOWN, ROWS_UP = 16, 27

pytestmark = needs_data


@dataclass(frozen=True)
class Published:
    """One published step: what it is, who does it, and its rows of joint values."""

    step: dict[str, Any]
    rows: Array
    plate: Plate
    brick: BrickType
    goal: Transform
    stock: Transform
    bases: dict[int, Transform]
    frames: dict[str, Transform]
    up: bool
    main: int
    helper: int
    attack: int
    support: Support

    def grip(self, top: Transform) -> BrickGrip:
        press = Press(self.step["press_side"], self.step["press_offset"])
        return BrickGrip(self.frames, self.brick, top, press)

    def q(self, mode: int, robot: int) -> Array:
        """Return the joint values [rad] of a robot in the row of a mode, counted from 1."""
        first = 8 if robot == 1 else 22
        return np.radians(self.rows[mode - 1, first : first + 6])


def dh_product(table: Array, base: Transform, q: Array) -> Transform:
    """Return T = base * prod Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    out = base
    for (offset, d, a, alpha), angle in zip(table, q, strict=True):
        c, s = np.cos(offset + angle), np.sin(offset + angle)
        ca, sa = np.cos(alpha), np.sin(alpha)
        out = out @ np.array(
            [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )
    return out


def dh_table(frame: str) -> Array:
    """Return the published table of a tool frame."""
    name = "gp4_tool_DH" if frame == "tool" else f"gp4_tool_{frame}_DH"
    name = "gp4_DH" if frame == "flange" else name
    return np.loadtxt(DATA / f"robot_properties/{name}.txt")


def pose(section: dict[str, Any]) -> Transform:
    """Return the transform of an imported pose."""
    return from_rpy(section["xyz_m"], np.radians(section["rpy_deg"]).tolist())


def steps(task: str) -> Iterator[Published]:
    """Read a published plan with the scenario that we import beside it."""
    scenario = import_apex_mr(DATA, task, prescribed_stock=True)
    assembly = scenario["assembly"]
    plate = Plate(pose(assembly["plate"]["pose"]), tuple(assembly["plate"]["studs"]))
    bricks = types_of(assembly)
    stock = {s["name"]: s for s in assembly["stock"]}
    robots = scenario["cell"]["robots"]
    bases = {k: pose(r["base"]) for k, r in enumerate(robots, start=1)}
    frames = {n: pose(f) for n, f in robots[0]["frames"].items()}
    rows = np.loadtxt(DATA / f"steps/{task}_steps.csv", delimiter=",")
    raw = json.loads((DATA / f"steps/{task}_seq.json").read_text())
    at = 1
    for k, ours in enumerate(assembly["steps"], start=1):
        step = raw[str(k)]
        count = ROWS_UP if step["manipulate_type"] else ROWS_DOWN
        brick = bricks[ours["brick"]]
        where = stock[ours["stock"]]
        yield Published(
            step=step,
            rows=rows[at : at + count],
            plate=plate,
            brick=brick,
            goal=top_pose(plate, PlacedBrick("", brick, cell_of(ours))),
            stock=top_pose(plate, PlacedBrick("", brick, cell_of(where))),
            bases=bases,
            frames=frames,
            up=(up := bool(step["manipulate_type"])),
            main=int(step["robot_id"]),
            helper=int(step["sup_robot_id"]),
            attack=int(step.get("attack_dir", 1)),
            support=Support(cell_at(step, "support_"), step["support_ori"], up),
        )
        at += count
    assert at == len(rows)


def cell_at(step: dict[str, Any], prefix: str) -> Cell:
    """Return a cell of a published step; those of supports are not turned."""
    x, y, z, ori = (step[f"{prefix}{k}"] for k in ("x", "y", "z", "ori"))
    return Cell(x, y, z, ori == 1 and prefix != "support_")


def assert_reached(
    published: Published, robot: int, subgoals: Sequence[Subgoal], modes: list[int]
) -> None:
    """Check that the robot's rows of the modes meet the subgoals."""
    shoulder = published.bases[robot] @ translation(0.0, 0.0, 0.33)
    for subgoal, mode in zip(subgoals, modes, strict=True):
        q = published.q(mode, robot)
        reached = dh_product(dh_table(subgoal.frame), shoulder, q)
        off = np.linalg.norm(reached[:3, 3] - subgoal.pose[:3, 3])
        turn = np.linalg.norm(reached[:3, :3] - subgoal.pose[:3, :3]) / np.sqrt(2)
        assert off < 2e-7, f"{subgoal.name}: {off * 1e6:.2f} um off"
        assert turn < 1e-6, f"{subgoal.name}: {turn:.2g} rad off"


@pytest.mark.parametrize("task", TASKS)
def test_picks(task: str) -> None:
    for s in steps(task):
        targets = pick_targets(s.grip(s.stock))
        robot = s.helper if s.up else s.main
        assert_reached(s, robot, targets.subgoals, [1, 2, 3, 4, 5])


@pytest.mark.parametrize("task", TASKS)
def test_place_downs(task: str) -> None:
    for s in steps(task):
        if s.up:
            continue
        targets = place_targets(s.grip(s.goal), up=False, attack=s.attack)
        # Half way through the twist the published rows have no waypoint.
        subgoals = [g for g in targets.subgoals if g.name != "half twist"]
        assert_reached(s, s.main, subgoals, [9, 10, 11, 12, 13])


def _in_world_axes(plate: Plate, support: Support) -> Plate:
    """Return a plate along the world's axes with the same place of a support.

    The published code takes directions from the first robot's base, not from the plate.
    """
    level = Plate(translation(*plate.pose[:3, 3]), plate.studs)
    where = [_contact(p, support, support.cell.z)[:3, 3] for p in (plate, level)]
    return replace(level, pose=translation(*(where[0] - where[1])) @ level.pose)


@pytest.mark.parametrize("task", TASKS)
def test_supports_from_below(task: str) -> None:
    supported = [s for s in steps(task) if s.helper and not s.up]
    assert supported
    for s in supported:
        targets = support_targets(_in_world_axes(s.plate, s.support), s.support)
        assert_reached(s, s.helper, targets[0].subgoals[1:], [8])
        # The published search settles on one of the shifted pre-poses.
        tip = dh_product(
            dh_table("tool"),
            s.bases[s.helper] @ translation(0.0, 0.0, 0.33),
            s.q(7, s.helper),
        )
        nearest = min(
            (way.subgoals[0] for way in targets),
            key=lambda p: float(np.linalg.norm(p.pose[:, 3] - tip[:, 3])),
        )
        assert_reached(s, s.helper, (nearest,), [7])


@pytest.mark.parametrize("task", ["cliff", "faucet"])
def test_handovers_and_place_ups(task: str) -> None:
    raised = [s for s in steps(task) if s.up]
    assert len(raised) == 1
    for s in raised:
        receiver, giver = s.bases[s.main], s.bases[s.helper]
        goal = s.grip(s.goal)
        up = place_targets(goal, up=True, attack=s.attack)
        assert_reached(s, s.main, up.subgoals, [17, 18, 21, 22, 23, 24])
        # The first candidate is the published place of the handover.
        place = receive_poses(receiver, giver)[0]
        assert_reached(s, s.main, place, [7, 9])
        assert_reached(s, s.helper, (giver_rest_poses(giver),), [8])
        give = handover_targets(s.grip(received_top(goal, place[1].pose)))
        assert_reached(s, s.helper, give.subgoals, [10, 11, 12, 13])
        (above,) = support_targets(_in_world_axes(s.plate, s.support), s.support)
        (own,) = support_targets(s.plate, s.support)
        for there, turned in zip(above.subgoals, own.subgoals, strict=True):
            there.pose[:3, :3] = turned.pose[:3, :3]
        assert_reached(s, s.helper, above.subgoals, [19, 20])


@pytest.mark.parametrize("task", TASKS)
def test_contact_cells(task: str) -> None:
    for s in steps(task):
        goal = PlacedBrick("", s.brick, cell_at(s.step, ""))
        press = s.grip(s.goal).press
        assert press_cell(goal, press, up=s.up) == cell_at(s.step, "press_")


def test_home() -> None:
    robots = import_apex_mr(DATA, "cliff")["cell"]["robots"]
    first = np.loadtxt(DATA / "steps/cliff_steps.csv", delimiter=",", max_rows=1)
    for robot, column in zip(robots, (8, 22), strict=True):
        np.testing.assert_allclose(
            robot["home_deg"], first[column : column + 6], atol=1e-5
        )
