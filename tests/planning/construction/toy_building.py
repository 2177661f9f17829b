"""Flyers that pick boxes up, put them down and hand them over, planned leg by leg in space-time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import Attachment, Workcell
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.problem.problem import RrtSettings
from planning.construction.world.fixed_world import FixedWorld, PlannedTask
from planning.tasks.task import TRANSIT, Handling
from planning.transforms import Array, inverse, translation
from tests.planning.construction.toy_tasks import PLAIN, find_path, state_at, with_task

ABOVE = np.array([0.0, 0.0, 0.05])
SKILL_S = 1.0


@dataclass
class Builder:
    """Plans task after task, each among all that are planned already."""

    cell: Workcell
    settings: RrtSettings = PLAIN
    tasks: tuple[PlannedTask, ...] = ()
    seed: int = 0
    world: FixedWorld = field(init=False)
    way_outs: dict[str, PlannedTask] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.world = FixedWorld(self.cell)

    def add(self, task: PlannedTask, *, way_out: bool = False) -> None:
        self.world = with_task(self.world, task, work=not way_out)
        self.tasks = (*self.tasks, task)
        if way_out:
            self.way_outs[task.robot] = task

    def free(self, robot: str) -> None:
        """Drop the robot's way out: it gets new work."""
        self.world = self.world.without_way_out(robot)
        out = self.way_outs.pop(robot, None)
        self.tasks = tuple(task for task in self.tasks if task is not out)

    def go(
        self,
        robot: str,
        goal: Array,
        step: int,
        *,
        touching: frozenset[frozenset[str]] = frozenset(),
        windows: Array | None = None,
        stay: float = 0.0,
        way_out: bool = False,
        not_before: float = 0.0,
    ) -> float:
        """Move a robot; return the arrival time."""
        held = state_at(self.world, 1e9).attachments.items()
        touching |= {
            frozenset((f"{robot}/tool", name))
            for name, at in held
            if at.holder == robot
        }
        checker = SpaceTimeChecker(self.world, (robot,), allowed=touching)
        found = find_path(
            checker,
            goal,
            stay=stay,
            not_before=not_before,
            windows=None if windows is None else [windows],
            settings=self.settings,
            seed=self.seed,
        )
        assert found is not None, f"{robot} cannot get to {goal}"
        label = f"{robot} goes"
        self.add(
            PlannedTask(
                robot,
                TRANSIT,
                found.time,
                found.path,
                step,
                label,
                touching=touching,
            ),
            way_out=way_out,
        )
        return found.arrival

    def park(self, robot: str, step: int, touched: str | None = None) -> None:
        pairs = frozenset([frozenset((f"{robot}/tool", touched))] if touched else [])
        home = self.cell.robot(robot).home
        self.go(robot, home, step, stay=np.inf, way_out=True, touching=pairs)

    def pick(self, robot: str, item: str, step: int, along: float = 0.0) -> None:
        """Go above an object, down and up again with it, held so far along x of its middle."""
        found = state_at(self.world, 1e9).attachments[item]
        assert found.holder is None
        height = float(self.cell.object(item).size[2])
        touch = found.pose[:3, 3] + np.array([along, 0.0, height / 2])
        held = Attachment(robot, inverse(translation(*touch)) @ found.pose)
        above = touch + ABOVE
        touching = frozenset(
            frozenset((item, other))
            for other in (f"{robot}/tool", *self.neighbours(item))
        )
        bare = SpaceTimeChecker(self.world, (robot,), allowed=touching)
        holding = SpaceTimeChecker(
            self.world, (robot,), allowed=touching, held={item: held}
        )
        windows = arrival_windows(
            [(bare, np.array([above, touch])), (holding, np.array([touch, above]))],
            SKILL_S,
            bare.start,
        )
        at = self.go(robot, above, step, windows=windows)
        handling = Handling(item, 1, robot, held.pose)
        self.skill(robot, "pick", at, [above, touch, above], step, handling, touching)

    def place(self, robot: str, item: str, goal: Array, step: int) -> None:
        """Bring a held object to its goal pose, and go up again without it."""
        held = state_at(self.world, 1e9).attachments[item]
        assert held.holder == robot
        touch = (goal @ inverse(held.pose))[:3, 3]
        above = touch + ABOVE
        touching = frozenset(
            frozenset((item, other))
            for other in (f"{robot}/tool", *self.neighbours(item))
        )
        holding = SpaceTimeChecker(self.world, (robot,), allowed=touching)
        line = self.world.robots[robot]
        # As if it were put down now: that is what stands around on the way up.
        down = self.world.with_object(
            self.world.objects[item].then(line.end, None, goal)
        )
        bare = SpaceTimeChecker(down, (robot,), allowed=touching)
        windows = arrival_windows(
            [(holding, np.array([above, touch])), (bare, np.array([touch, above]))],
            SKILL_S,
            holding.start,
        )
        at = self.go(robot, above, step, windows=windows)
        handling = Handling(item, 1, None, goal)
        self.skill(
            robot, "place-down", at, [above, touch, above], step, handling, touching
        )
        self.park(robot, step)

    def hand_over(
        self, giver: str, taker: str, item: str, at: Array, step: int
    ) -> None:
        """Hand a held object over where the giver's cup is at ``at``: the taker comes to it."""
        held = state_at(self.world, 1e9).attachments[item]
        assert held.holder == giver
        both = (f"{giver}/tool", f"{taker}/tool")
        touching = frozenset(frozenset((item, tool)) for tool in both)
        self.go(giver, at, step, stay=np.inf)
        centre = translation(*at) @ held.pose
        # The taker touches the other end of the object.
        beside = centre[:3, 3] * 2 - at
        beside[2] = at[2]
        self.free(taker)
        above = beside + 2 * ABOVE
        # It touches the object only once that is held still.
        still = self.world.robots[giver].end
        self.go(taker, above, step, not_before=still)
        there = self.go(taker, beside, step, touching=touching, stay=np.inf)
        pose = inverse(translation(*beside)) @ centre
        # Held until then, and then left where it is.
        giver_end = self.world.robots[giver].path[-1]
        task = PlannedTask(
            giver,
            "handover",
            np.array([there, there + SKILL_S]),
            np.array([giver_end, giver_end]),
            step,
            f"hand over {item}",
            item,
            (Handling(item, 1, taker, pose),),
            touching,
        )
        self.add(task)
        away = at + 2 * ABOVE
        gone = self.go(giver, away, step, touching=touching, stay=np.inf)
        # The taker stays until the giver has let go and is gone.
        line = self.world.robots[taker]
        self.add(
            PlannedTask(
                taker,
                TRANSIT,
                np.array([line.end, gone]),
                np.array([line.path[-1], line.path[-1]]),
                step,
                f"{taker} waits",
                touching=touching,
            )
        )
        self.park(giver, step)

    def skill(
        self,
        robot: str,
        kind: str,
        at: float,
        path: list[Array],
        step: int,
        handling: Handling,
        touching: frozenset[frozenset[str]],
    ) -> None:
        self.add(
            PlannedTask(
                robot,
                kind,
                at + SKILL_S * np.array([0.0, 0.5, 1.0]),
                np.array(path),
                step,
                f"{kind} {handling.object}",
                handling.object,
                (handling,),
                touching,
            )
        )

    def neighbours(self, item: str) -> list[str]:
        """What a handled object may touch: everything that is no robot."""
        names = [f.name for f in self.cell.fixtures]
        return names + [o.name for o in self.cell.objects if o.name != item]
