"""Candidates for the assignment of parts: each step with its robots and grips (APEX-MR App. B)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import Grip, PartAssembly, moves_on
from planning.parts.balance import kept_as_said, stand_of_all
from planning.parts.joints import require_joints
from planning.parts.part_skills import PartSkills, process_targets
from planning.parts.part_steps import (
    KnownStep,
    MachineStep,
    PartStep,
    WorkStep,
    far_first,
    part_steps,
    require_ways,
)
from planning.parts.relays import find_relays
from planning.parts.step_paths import (
    NOBODY,
    Holders,
    StepPaths,
    pair_kept,
)
from planning.parts.tool_grips import beyond_part, overload, own_grips, why_no_grip
from planning.statics.build_order import Stand, Waits
from planning.steps.handovers import CandidateCollector
from planning.steps.skill import Obstruction, SkillPath, joint_distance
from planning.steps.tool_changes import (
    ToolChanges,
    find_tool_changes,
    mounted_tool,
    with_each_tool,
    with_tools,
)
from planning.tasks.assignment import (
    NO_TOOLS,
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
    Tools,
)

_MOST_HOLDS = 8
"""Ways to hold a part that are kept for each robot."""

_ENOUGH = 4
"""So many pairs of a robot's ways to do a step and another's ways to hold are looked for."""


@dataclass(frozen=True)
class PartCandidates:
    """The assignment problem of an assembly of parts, and the paths behind it.

    Attributes:
        cell: its objects are the parts, and tools that are changed.
        changes: how robots change their tools.
        frame: name of the tool frame that grips.
        steps: what is done, with the surroundings.
        problem: what the solver needs.
        paths: of all candidates; the numbers of those in which the part changes hands in between
            follow those of the grips.
        blockers: what was in the way of tries of a step, most often first.
        balance: pairs of steps from 0: what the second does to the structure waits for the first,
            so that it always stands.
    """

    cell: Workcell
    changes: ToolChanges
    frame: str
    steps: tuple[KnownStep, ...]
    problem: AssignmentProblem
    paths: StepPaths = field(repr=False)
    blockers: Mapping[int, tuple[str, ...]] = field(repr=False)
    balance: Waits = frozenset()

    @property
    def impossible(self) -> tuple[int, ...]:
        """The steps that nobody can do, or not beside anyone who holds what is to be held."""
        alone, problem = set(self.problem.impossible), self.problem
        for step, held in enumerate(problem.needs_support, start=1):
            pairs = product(
                problem.primaries_of.get(step, ()), problem.supports_of.get(step, ())
            )
            if held and not any(problem.compatible(p, s) for p, s in pairs):
                alone.add(step)
        return tuple(sorted(alone))


def names_by_count(counts: Counter[str]) -> tuple[str, ...]:
    """Return names, those that were counted most often first."""
    return tuple(sorted(counts, key=lambda name: (-counts[name], name)))


def find_candidates(cell: Workcell, assembly: PartAssembly) -> PartCandidates:
    """Find every robot and grip or turn that can do a step, with its cost.

    All skills are reachable in one posture each and free of contacts among the parts as they
    are at that step, with all other robots at HOME, or holding a part; who carries a part can
    stand at HOME with it. Costs are L1 joint distances: HOME to pick plus HOME to place, HOME to
    where a process is done, HOME to where a part is held. Robots that change their tools are tried
    with each of them; others then have all that they may have.

    Args:
        cell: its objects are the parts, and tools that are changed.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, goes where something is or through it,
            is joined to something far from it, or something would fall.
    """
    changes = find_tool_changes(cell, assembly.goals)
    around = with_tools(cell, NO_TOOLS)
    require_joints(around, assembly)
    steps = part_steps(around, assembly)
    stand = Stand(frozenset(), kept_as_said(steps))
    if assembly.balance is not None:
        leaves = assembly.supply.leaves.keys()
        stand = stand_of_all(around, steps, assembly.balance, leaves)
    require_ways(around, assembly, steps)
    keeps = {k + 1: last + 1 for k, last in sorted(stand.keeps.items())}
    collector = PartCollector(cell, assembly, steps, keeps)
    for k, step in enumerate(steps, start=1):
        collector.add(k, step)
    pair_kept(collector.paths, collector)
    problem = collector.problem(
        [step.words for step in assembly.steps],
        [step.hold is not None for step in assembly.steps],
        unlimited=frozenset(moves_on(assembly.steps)),
        mounted=changes.mounted,
        changes=changes.costs,
        kept=keeps,
    )
    return PartCandidates(
        cell,
        changes,
        assembly.grips.frame,
        steps,
        problem,
        collector.paths,
        {step: names_by_count(own) for step, own in collector.blockers.items()},
        stand.waits,
    )


class PartCollector(CandidateCollector):
    """Gathers the candidates of an assembly of parts."""

    def __init__(
        self,
        cell: Workcell,
        assembly: PartAssembly,
        steps: Sequence[KnownStep],
        keeps: Mapping[int, int],
    ) -> None:
        super().__init__(cell.robots)
        self._cell, self._assembly = cell, assembly
        self.paths = StepPaths(self._skills, steps, keeps=keeps)
        self._robots = tuple(with_each_tool(cell.robots))
        self._known: dict[Tools, PartSkills] = {}

    def _skills(self, tools: Tools) -> PartSkills:
        """Return the skills of robots that have certain tools on them."""
        if tools not in self._known:
            cell = with_tools(self._cell, tools)
            self._known[tools] = PartSkills(cell, self._assembly)
        return self._known[tools]

    def add(self, number: int, step: KnownStep) -> None:
        """Add the candidates of a step, counted from 1."""
        if isinstance(step, MachineStep):
            self._add_machine(number, step)
            return
        first, held_first = len(self.primaries), len(self.supports)
        for robot in self._robots:
            if not step.step.done_by(robot.name):
                only = ", ".join(step.step.robots or ())
                self.reject(number, f"{robot.name} does it", f"it is for {only} only")
            elif isinstance(step, PartStep):
                self._add_places(number, step, robot)
            else:
                self._add_works(number, step, robot)
        if isinstance(step, PartStep) and len(self.primaries) == first:
            self._add_relays(number, step)
        if step.held is not None:
            for robot in self._robots:
                self._add_holds(number, step, robot)
            self._pair(
                range(first, len(self.primaries)),
                range(held_first, len(self.supports)),
            )

    def _add_places(self, number: int, step: PartStep, robot: PlacedRobot) -> None:
        part, name, tools = step.part.name, robot.name, mounted_tool(robot)
        if (heavy := overload(robot, step.part)) is not None:
            self.reject(number, f"{name} lifts {part}", heavy)
            return
        skills = self._skills(tools)
        own = list(own_grips(robot, step.grips))
        if not own:
            rules = self._assembly.handling(part).grips
            reason = why_no_grip(robot, step.part.shape, rules)
            self.reject(number, f"{name} grips {part}", reason)
        for k, grip in own:
            words = grip.words
            if wrong := skills.misfit(robot, step.part, grip):
                self.reject(number, f"{name} grips, {words}", wrong)
            elif isinstance(place := skills.place(robot, step, grip.pose), Obstruction):
                place = self._too_deep(place, step, robot, grip)
                self.reject(number, f"{name} places, {words}", place)
            elif isinstance(pick := skills.pick(robot, step, grip.pose), Obstruction):
                pick = self._too_deep(pick, step, robot, grip)
                self.reject(number, f"{name} picks, {words}", pick)
            elif wrong := skills.carried_home(robot, step, grip.pose):
                self.reject(number, f"{name} at HOME, {words}", wrong)
            else:
                cost = self.cost(pick, place)
                item = PrimaryCandidate(number, name, part, k, cost, tools=tools)
                self._add(item, pick, place)

    def _add(self, item: PrimaryCandidate, *paths: SkillPath) -> None:
        self.paths.alone[item] = paths
        self.primaries.append(item)

    def _too_deep(
        self, found: Obstruction, step: PartStep, robot: PlacedRobot, grip: Grip
    ) -> Obstruction:
        """Return an obstruction that says so where the tool reaches beyond the part into something."""
        by_robot = "/" in (found.by or "/")
        if by_robot or not found.words.startswith(f"{robot.name}/tool"):
            return found
        frame = self._assembly.handling(step.part.name).grips.frame
        why = beyond_part(robot, step.part.shape, grip, frame)
        return replace(found, words=found.words + why)

    def _add_relays(self, number: int, step: PartStep) -> None:
        """Add ways with the part laid down in between, or handed over in the air."""
        found = find_relays(self._cell, self._skills, step)
        for k, (relay, tools) in enumerate(found, start=len(step.grips)):
            other = None if relay.giver == relay.receiver else relay.giver
            about = number, relay.receiver, step.part.name, k, relay.cost, other
            item = PrimaryCandidate(*about, tools=tools)
            self.paths.relays[item] = relay
            self._add(item, *relay.paths)
        if not found:
            reason = "robots reach no place in common, to lie or to be handed over"
            self.reject(number, f"{step.part.name} changes hands", reason)

    def _add_machine(self, number: int, step: MachineStep) -> None:
        """Add the machine, which has no choice."""
        work = step.step
        if work.door is not None:
            name = self._skills(NO_TOOLS).in_door(work.door)
            if name is not None:
                raise InfeasibleStepError(
                    f"step {number} ({work.words}): {name} stands in the door of {work.machine}"
                    " when it is at HOME"
                )
        thing = f"{work.words}, step {number}"
        self.primaries.append(PrimaryCandidate(number, work.machine, thing, 0, 0.0))

    def _add_works(self, number: int, step: WorkStep, robot: PlacedRobot) -> None:
        process, name, tools = step.step.process, robot.name, mounted_tool(robot)
        frames = ("flange", *robot.model.frames)
        if process.frame not in frames:
            reason = f"it has no frame {process.frame!r} (valid: {', '.join(frames)})"
            self.reject(number, f"{name} does it", reason)
            return
        if process.tool not in (None, robot.tool):
            has = "none is named" if robot.tool is None else f"it has {robot.tool}"
            reason = f"the tool must be {process.tool}: {has}"
            self.reject(number, f"{name} does it", reason)
            return
        for k, turn in enumerate(process.turns):
            what = f"{name} turned by {np.degrees(turn):.0f} deg"
            tried = self._skills(tools).work(robot, step, turn)
            found = self.accept(number, what, tried)
            if found is None:
                continue
            # What is worked at can be worked at again: each process is a thing of its own.
            thing = f"{step.step.words}, step {number}"
            at = process_targets(process, step.place, turn).first
            cost = joint_distance(robot.home, [*found.lead, *found.path][at])
            item = PrimaryCandidate(number, name, thing, k, cost, tools=tools)
            self._add(item, found)

    def _add_holds(
        self, number: int, step: PartStep | WorkStep, robot: PlacedRobot
    ) -> None:
        held = step.held
        assert held is not None
        tools = mounted_tool(robot)
        skills = self._skills(tools)
        own = dict(own_grips(robot, held.grips))
        rules = self._assembly.handling(held.part.name).grips
        if not own:
            reason = why_no_grip(robot, held.part.shape, rules)
            self.reject(number, f"{robot.name} holds {held.part.name}", reason)
        count = 0
        for k in far_first(step):
            if k not in own:
                continue
            if count == _MOST_HOLDS:
                break
            grip = held.grips[k]
            what = f"{robot.name} holds {held.part.name}, {grip.words}"
            misfit = skills.misfit(robot, held.part, grip)
            found = misfit or skills.hold(robot, step, held, grip.pose)
            path = self.accept(number, what, found)
            if path is None:
                continue
            count += 1
            cost = joint_distance(robot.home, path.path[-1])
            item = SupportCandidate(number, robot.name, k, cost, tools)
            self.paths.holds[item] = path
            self.supports.append(item)

    def _pair(self, primaries: range, supports: range) -> None:
        """Find ways to do a step beside ways to hold; what is not found cannot go together."""
        found: dict[tuple[str, str], int] = {}
        # The cheaper ways to do the step first.
        cheap = sorted(primaries, key=lambda p: (self.primaries[p].cost, p))
        for s, p in product(supports, cheap):
            first, second = self.primaries[p], self.supports[s]
            robots = first.robot, second.robot
            if robots[0] == robots[1]:
                continue
            if found.get(robots, 0) >= _ENOUGH:
                self.incompatible.add((p, s))
                continue
            at = {second.robot: self.paths.holds[second].path[-1]}
            supporting = Holders(at, second.tools)
            what = f"{first.robot} beside {second.robot} that holds"
            paths = self.paths.among(first, NOBODY, supporting)
            if self.accept(first.step, what, paths) is None:
                self.incompatible.add((p, s))
            else:
                found[robots] = found.get(robots, 0) + 1
