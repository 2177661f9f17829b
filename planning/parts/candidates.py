"""Candidates for the assignment of parts: each step with its robots and grips (APEX-MR App. B)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.parts.assembly import PartAssembly
from planning.parts.balance import balance_waits
from planning.parts.handovers import Handover, find_handovers
from planning.parts.part_skills import PartSkills
from planning.parts.part_steps import PartStep, WorkStep, part_steps
from planning.parts.relays import Relay, find_relays
from planning.parts.targets import process_targets
from planning.parts.tool_grips import own_grips, why_no_grip
from planning.skills.joint_paths import Obstruction, SkillPath, joint_distance
from planning.statics.build_order import Waits
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    StepChoice,
    SupportCandidate,
)

_MOST_HOLDS = 8
"""Ways to hold a part that are kept for each robot."""

_ENOUGH = 4
"""So many pairs of a robot's ways to do a step and another's ways to hold are looked for."""

_Way = tuple[int, str, int]
"""Step, robot, and number of a grip or of a turn."""


@dataclass(frozen=True)
class PartCandidates:
    """The assignment problem of an assembly of parts, and the paths behind it.

    Attributes:
        cell: its objects are the parts.
        frame: name of the tool frame that grips.
        steps: what is done, with the surroundings.
        problem: what the solver needs.
        paths: pick and place, or a process, by step, robot and number of the grip or turn.
        holds: how a part is held, by step, robot and number of the grip.
        beside: the place or the process of a way beside a way to hold.
        blockers: what was in the way of tries of a step, most often first.
        relays: ways in which the part changes hands in between; their numbers follow those of the grips.
        balance: pairs of steps from 0: what the second does to the structure waits for the first,
            so that it always stands.
    """

    cell: Workcell
    frame: str
    steps: tuple[PartStep | WorkStep, ...]
    problem: AssignmentProblem
    paths: Mapping[_Way, tuple[SkillPath, ...]] = field(repr=False)
    holds: Mapping[_Way, SkillPath] = field(repr=False)
    beside: Mapping[tuple[_Way, _Way], SkillPath] = field(repr=False)
    blockers: Mapping[int, tuple[str, ...]] = field(repr=False)
    relays: Mapping[_Way, Relay | Handover] = field(repr=False)
    balance: Waits = frozenset()

    @property
    def impossible(self) -> tuple[int, ...]:
        """The steps that nobody can do, or not beside anyone who holds what is to be held."""
        alone = set(self.problem.impossible)
        paired = {way[0] for way, _ in self.beside}
        held = {k for k, step in enumerate(self.steps, start=1) if step.held}
        return tuple(sorted(alone | (held - paired)))

    def paths_of(self, choice: StepChoice) -> tuple[SkillPath, ...]:
        """Return pick and place of a choice, or its process, beside what is held."""
        way = (choice.step, choice.robot, choice.grasp)
        paths = self.paths[way]
        if choice.support is None:
            return paths
        last = self.beside[way, _hold_way(choice.support)]
        return (*paths[:-1], last)

    def hold_of(self, choice: StepChoice) -> SkillPath | None:
        """Return how a choice holds a part meanwhile, None if it holds none."""
        if choice.support is None:
            return None
        return self.holds[_hold_way(choice.support)]


def names_by_count(counts: Counter[str]) -> tuple[str, ...]:
    """Return names, those that were counted most often first."""
    return tuple(sorted(counts, key=lambda name: (-counts[name], name)))


def _hold_way(support: SupportCandidate) -> _Way:
    return support.step, support.robot, support.pose


def find_candidates(cell: Workcell, assembly: PartAssembly) -> PartCandidates:
    """Find every robot and grip or turn that can do a step, with its cost.

    All skills are reachable in one posture each and free of contacts among the parts as they
    are at that step, with all other robots at HOME, or holding a part; who carries a part can
    stand at HOME with it. Costs are L1 joint distances: HOME to pick plus HOME to place, HOME to
    where a process is done, HOME to where a part is held.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is, or
            something would fall.
    """
    steps = part_steps(cell, assembly)
    waits: Waits = frozenset()
    if assembly.balance is not None:
        leaves = assembly.supply.leaves.keys()
        waits = balance_waits(cell, steps, assembly.balance, leaves)
    collector = _Collector(cell, PartSkills(cell, assembly))
    for number, step in enumerate(steps, start=1):
        collector.add(number, step)
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(step.words for step in assembly.steps),
        needs_support=tuple(step.hold is not None for step in assembly.steps),
        primaries=tuple(collector.primaries),
        supports=tuple(collector.supports),
        incompatible=frozenset(collector.incompatible),
        rejections=tuple(collector.rejections),
    )
    return PartCandidates(
        cell,
        assembly.grips.frame,
        steps,
        problem,
        collector.paths,
        collector.holds,
        collector.beside,
        {step: names_by_count(own) for step, own in collector.blockers.items()},
        collector.relays,
        waits,
    )


class _Collector:
    """Gathers candidates step by step."""

    def __init__(self, cell: Workcell, skills: PartSkills) -> None:
        self._cell, self._skills, self._assembly = cell, skills, skills.assembly
        self.primaries: list[PrimaryCandidate] = []
        self.supports: list[SupportCandidate] = []
        self.incompatible: set[tuple[int, int]] = set()
        self.rejections: list[Rejection] = []
        self.paths: dict[_Way, tuple[SkillPath, ...]] = {}
        self.holds: dict[_Way, SkillPath] = {}
        self.beside: dict[tuple[_Way, _Way], SkillPath] = {}
        self.blockers: dict[int, Counter[str]] = defaultdict(Counter)
        self.relays: dict[_Way, Relay | Handover] = {}

    def add(self, number: int, step: PartStep | WorkStep) -> None:
        """Add the candidates of a step, counted from 1."""
        first, held_first = len(self.primaries), len(self.supports)
        for robot in self._cell.robots:
            if not step.step.done_by(robot.name):
                only = ", ".join(step.step.robots or ())
                self._reject(number, f"{robot.name} does it", f"it is for {only} only")
            elif isinstance(step, PartStep):
                self._add_places(number, step, robot)
            else:
                self._add_works(number, step, robot)
        if isinstance(step, PartStep) and len(self.primaries) == first:
            self._add_relays(number, step)
        if step.held is not None:
            for robot in self._cell.robots:
                self._add_holds(number, step, robot)
            self._pair(
                step,
                range(first, len(self.primaries)),
                range(held_first, len(self.supports)),
            )

    def _add_places(self, number: int, step: PartStep, robot: PlacedRobot) -> None:
        part, name = step.part.name, robot.name
        own = list(own_grips(robot, step.grips))
        if not own:
            reason = why_no_grip(
                robot, step.part.shape, self._assembly.ways(part).grips
            )
            self._reject(number, f"{name} grips {part}", reason)
        for k, grip in own:
            misfit = self._skills.misfit(robot, step.part, grip)
            if misfit is not None:
                self._block(number, f"{name} grips, {grip.words}", misfit)
                continue
            place = self._skills.place(robot, step, grip.pose)
            if isinstance(place, Obstruction):
                self._block(number, f"{name} places, {grip.words}", place)
                continue
            pick = self._skills.pick(robot, step, grip.pose)
            if isinstance(pick, Obstruction):
                self._block(number, f"{name} picks, {grip.words}", pick)
                continue
            blocked = self._skills.carried_home(robot, step, grip.pose)
            if blocked is not None:
                self._block(number, f"{name} at HOME, {grip.words}", blocked)
                continue
            self.paths[number, name, k] = pick, place
            cost = sum(joint_distance(robot.home, p.contact) for p in (pick, place))
            self.primaries.append(PrimaryCandidate(number, name, part, k, cost))

    def _add_relays(self, number: int, step: PartStep) -> None:
        """Add ways with the part laid down in between, or handed over in the air."""
        about = self._cell, self._assembly, self._skills, step
        found: Sequence[Relay | Handover] = find_relays(*about)
        found = found or find_handovers(*about)
        for k, relay in enumerate(found, start=len(step.grips)):
            way = number, relay.receiver, k
            self.relays[way] = relay
            self.paths[way] = relay.paths
            other = None if relay.giver == relay.receiver else relay.giver
            self.primaries.append(
                PrimaryCandidate(
                    number, relay.receiver, step.part.name, k, relay.cost, other
                )
            )
        if not found:
            reason = "robots reach no place in common, to lie or to be handed over"
            self._reject(number, f"{step.part.name} changes hands", reason)

    def _add_works(self, number: int, step: WorkStep, robot: PlacedRobot) -> None:
        process, name = step.step.process, robot.name
        if process.frame not in {"flange", *robot.model.frames}:
            reason = f"it has no frame {process.frame!r}"
            self._reject(number, f"{name} does it", reason)
            return
        if process.tool not in (None, robot.tool):
            has = "none is named" if robot.tool is None else f"it has {robot.tool}"
            reason = f"the tool must be {process.tool}: {has}"
            self._reject(number, f"{name} does it", reason)
            return
        for k, turn in enumerate(process.turns):
            found = self._skills.work(robot, step, turn)
            if isinstance(found, Obstruction):
                what = f"{name} turned by {np.degrees(turn):.0f} deg"
                self._block(number, what, found)
                continue
            self.paths[number, name, k] = (found,)
            # What is worked at can be worked at again: each process is a thing of its own.
            thing = f"{step.step.words}, step {number}"
            at = process_targets(process, step.place, turn).first
            cost = joint_distance(robot.home, [*found.lead, *found.path][at])
            self.primaries.append(PrimaryCandidate(number, name, thing, k, cost))

    def _add_holds(
        self, number: int, step: PartStep | WorkStep, robot: PlacedRobot
    ) -> None:
        held = step.held
        assert held is not None
        own = dict(own_grips(robot, held.grips))
        rules = self._assembly.ways(held.part.name).grips
        if not own:
            reason = why_no_grip(robot, held.part.shape, rules)
            self._reject(number, f"{robot.name} holds {held.part.name}", reason)
        count = 0
        for k in self._far_first(step):
            if k not in own:
                continue
            if count == _MOST_HOLDS:
                break
            grip = held.grips[k]
            misfit = self._skills.misfit(robot, held.part, grip)
            if misfit is not None:
                what = f"{robot.name} holds {held.part.name}, {grip.words}"
                self._block(number, what, misfit)
                continue
            path = self._skills.hold(robot, step, held, grip.pose)
            if isinstance(path, Obstruction):
                what = f"{robot.name} holds {held.part.name}, {grip.words}"
                self._block(number, what, path)
                continue
            count += 1
            self.holds[number, robot.name, k] = path
            cost = joint_distance(robot.home, path.path[-1])
            self.supports.append(SupportCandidate(number, robot.name, k, cost))

    def _far_first(self, step: PartStep | WorkStep) -> list[int]:
        """Return the grips on what is held, those first that leave most room for the other."""
        assert step.held is not None
        work = (step.goal if isinstance(step, PartStep) else step.place)[:3, 3]

        def near(k: int) -> float:
            assert step.held is not None
            at = (step.held.pose @ step.held.grips[k].pose)[:3, 3]
            return -round(float(np.linalg.norm(at - work)), 6)

        return sorted(range(len(step.held.grips)), key=near)

    def _pair(
        self, step: PartStep | WorkStep, primaries: range, supports: range
    ) -> None:
        """Find ways to do a step beside ways to hold; what is not found cannot go together."""
        found: dict[tuple[str, str], int] = {}
        for p, s in self._pairs(primaries, supports):
            first, second = self.primaries[p], self.supports[s]
            robots = first.robot, second.robot
            if found.get(robots, 0) >= _ENOUGH:
                self.incompatible.add((p, s))
                continue
            way = first.step, first.robot, first.grasp
            by = second.step, second.robot, second.pose
            path = self._beside(step, way, by)
            if isinstance(path, Obstruction):
                self.incompatible.add((p, s))
                what = f"{first.robot} beside {second.robot} that holds"
                self._block(first.step, what, path)
                continue
            self.beside[way, by] = path
            found[robots] = found.get(robots, 0) + 1

    def _pairs(self, primaries: range, supports: range) -> Iterator[tuple[int, int]]:
        """Yield pairs of different robots, the cheaper ways to do the step first."""
        cheap = sorted(primaries, key=lambda p: (self.primaries[p].cost, p))
        for s in supports:
            for p in cheap:
                if self.primaries[p].robot != self.supports[s].robot:
                    yield p, s

    def _beside(
        self, step: PartStep | WorkStep, way: _Way, by: _Way
    ) -> SkillPath | Obstruction:
        """Return the place or process of a way beside a robot that holds."""
        robot, known = self._cell.robot(way[1]), self.paths[way][-1]
        skills = self._skills.beside(by[1], self.holds[by].path[-1])
        if isinstance(step, WorkStep):
            turn = step.step.process.turns[way[2]]
            return skills.work(robot, step, turn, known)
        relay = self.relays.get(way)
        grip = step.grips[way[2]] if relay is None else relay.take
        return skills.place(robot, step, grip.pose, known)

    def _block(self, step: int, what: str, reason: Obstruction) -> None:
        """Note that something is in the way."""
        self._reject(step, what, reason.words)
        if reason.by is not None:
            self.blockers[step][reason.by] += 1

    def _reject(self, step: int, what: str, reason: str) -> None:
        self.rejections.append(Rejection(step, what, reason))
