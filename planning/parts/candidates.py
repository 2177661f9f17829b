"""Candidates for the assignment of parts: robots and grips for each step (APEX-MR App. B)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.geometry.robot_bodies import entity_name
from planning.grips.fingers import firm_grips
from planning.grips.grip import Grip
from planning.grips.tool_grips import (
    describe_tool_overhang,
    explain_missing_grip,
    explain_overload,
    own_grips,
)
from planning.handling.tool_changes import (
    ToolChanges,
    find_tool_changes,
    mounted_tool,
    with_each_tool,
    with_tools,
)
from planning.parts.assembly import MachineWork, PartAssembly, PlacePart, Process, Work
from planning.parts.balance import stability_constraints
from planning.parts.part_skills import SkillTry, ToolSkills, process_targets
from planning.parts.part_steps import (
    KnownStep,
    PartStep,
    part_steps,
    require_clear_insertion,
    sort_grips_by_clearance,
    wide_joints,
)
from planning.parts.relays import find_relays
from planning.parts.step_paths import Candidate, Pairing, StepPaths
from planning.statics.build_order import Waits
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, SkillPath, joint_distance
from planning.tasks.assignment import (
    NO_TOOLS,
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
)
from planning.transforms import Transform

_MOST_HOLDS = 8
"""Greatest number of holds of a part per robot."""


@dataclass(frozen=True)
class PartCandidates:
    """The assignment problem of an assembly of parts, and the paths of its candidates.

    Attributes:
        cell: its objects are the parts, and tools that are changed.
        assembly: goals and steps.
        changes: how robots change their tools.
        steps: what is done, with the surroundings.
        balance: pairs of steps from 0: what the second does to the structure waits for the first,
            so that it always stands.
        problem: what the solver needs.
        paths: of all candidates; the numbers of those in which the part changes hands in between
            follow those of the grips.
        blockers: by step, how often each obstacle blocked it.
        count: number of first steps of which there are candidates.
        spares: steps with other parts of the kind in place of their own, by number and part.
    """

    cell: Workcell
    assembly: PartAssembly
    changes: ToolChanges
    steps: tuple[KnownStep, ...]
    balance: Waits
    problem: AssignmentProblem
    paths: StepPaths = field(repr=False)
    blockers: Mapping[int, Counter[str]] = field(repr=False)
    count: int
    spares: Mapping[tuple[int, str], PartStep] = field(default_factory=dict)


def find_candidates(cell: Workcell, assembly: PartAssembly) -> PartCandidates:
    """Find every robot with a grip or tool rotation that can do a step, with its cost.

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
    return LazyCandidates(cell, assembly).first(len(assembly.steps))


class LazyCandidates:
    """Candidates of the steps of an assembly of parts, found on request, in order.

    Steps that are impossible for every robot raise an error immediately; see ``find_candidates``.
    """

    def __init__(self, cell: Workcell, assembly: PartAssembly) -> None:
        self._cell, self._assembly = cell, assembly
        self._changes = find_tool_changes(cell, assembly.goals)
        around = with_tools(cell, NO_TOOLS)
        for joint, words in wide_joints(around, assembly):
            raise InfeasibleStepError(words, thing=joint.second)
        self._steps = part_steps(around, assembly)
        stand = stability_constraints(around, self._steps, assembly)
        require_clear_insertion(around, assembly, self._steps)
        self._waits = stand.waits
        self._keeps = {k + 1: last + 1 for k, last in sorted(stand.keeps.items())}
        self._found = PartCollector(cell, assembly, self._steps, self._keeps)
        self._count = 0

    def first(self, count: int) -> PartCandidates:
        """Return candidates of at least a number of first steps, none of them held for later ones."""
        found, assembly = self._found, self._assembly
        more = range(self._count, count)
        for k in more:
            found.add(k + 1, self._steps[k])
        found.pairing.pair_kept(more)
        self._count = max(self._count, count)
        problem = found.problem(
            [step.words for step in assembly.steps],
            [step.hold is not None for step in assembly.steps],
            unlimited=frozenset(
                step.part
                for step in assembly.steps
                if isinstance(step, PlacePart) and step.stop is not None
            ),
            mounted=self._changes.mounted,
            changes=self._changes.costs,
            returns=assembly.returns,
            kept=self._keeps,
        )
        return PartCandidates(
            self._cell,
            assembly,
            self._changes,
            self._steps,
            self._waits,
            problem,
            found.paths,
            found.blockers,
            self._count,
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
        self._robots = tuple(with_each_tool(cell.robots))
        self._skills = ToolSkills(cell, assembly)
        self.paths = StepPaths(self._skills, steps, keeps)
        self.pairing = Pairing(self.paths, self)

    def add(self, number: int, step: KnownStep) -> None:
        """Add the candidates of a step, counted from 1."""
        if isinstance(step.step, MachineWork):
            self._add_machine(number, step.step)
            return
        first = len(self.primaries)
        for robot in self._robots:
            if not step.step.done_by(robot.name):
                only = ", ".join(step.step.robots or ())
                why = f"it is for {only} only"
                self.reject(number, f"{robot.name} does it", why, robot.name)
            elif isinstance(step, PartStep):
                self.add_places(number, step, robot)
            elif isinstance(step.step, Work):
                self._add_works(number, step, step.step, robot)
        if isinstance(step, PartStep) and len(self.primaries) == first:
            self._add_relays(number, step)
        if step.held is not None:
            for robot in self._robots:
                self._add_holds(number, step, robot)
            self.pairing.pair_held(number)

    def add_places(self, number: int, step: PartStep, robot: PlacedRobot) -> None:
        """Add the candidates of a robot that places the part of a step, counted from 1."""
        part, name, tools = step.part.name, robot.name, mounted_tool(robot)
        if (heavy := explain_overload(robot, step.part)) is not None:
            self.reject(number, f"{name} lifts {part}", heavy, name)
            return
        skills = self._skills(tools)
        own = self._own_grips(
            number,
            f"{name} grips {part}",
            robot,
            step.part,
            step.grips,
            (step.part.start, step.place),
        )
        for k, grip in own.items():
            words = grip.words
            picking = skills.pick(robot, step, grip.pose)
            placing = skills.place(robot, step, grip.pose)
            if wrong := skills.misfit(robot, step.part, grip):
                self.reject(number, f"{name} grips, {words}", wrong, name)
            elif isinstance(place := placing.found(), Obstruction):
                place = self._too_deep(place, step, robot, grip)
                self.reject(number, f"{name} places, {words}", place, name)
            elif isinstance(pick := picking.found(), Obstruction):
                pick = self._too_deep(pick, step, robot, grip)
                self.reject(number, f"{name} picks, {words}", pick, name)
            elif wrong := picking.carried_home():
                self.reject(number, f"{name} at HOME, {words}", wrong, name)
            else:
                cost = self.cost(pick, place)
                item = PrimaryCandidate(number, name, part, k, cost, tools=tools)
                self._add(item, (picking, placing), pick, place)

    def _own_grips(
        self,
        number: int,
        what: str,
        robot: PlacedRobot,
        part: CellObject,
        grips: list[Grip],
        poses: Sequence[Transform],
    ) -> dict[int, Grip]:
        """Return the grips of a robot's tool by number; note the reason if there are none.

        Where friction holds the part at some of them, wherever it is, at these alone.
        """
        own = dict(own_grips(robot, grips))
        if not own:
            rules = self._assembly.handling(part.name).grips
            why = explain_missing_grip(robot, part.shape, rules, poses)
            self.reject(number, what, why, robot.name)
        frame, friction = self._assembly.frame, self._assembly.friction
        return firm_grips(robot, part, own, frame, poses, friction)

    def _add(
        self, item: Candidate, tries: tuple[SkillTry, ...], *paths: SkillPath
    ) -> None:
        self.paths.unpaired[item], self.paths.tries[item] = paths, tries
        if isinstance(item, PrimaryCandidate):
            self.primaries.append(item)
        else:
            self.supports.append(item)

    def _too_deep(
        self, found: Obstruction, step: PartStep, robot: PlacedRobot, grip: Grip
    ) -> Obstruction:
        """Return an obstruction that states where the tool reaches beyond the part into something."""
        by_robot = "/" in (found.by or "/")
        if by_robot or found.moving != entity_name(robot.name, "tool"):
            return found
        why = describe_tool_overhang(robot, step.part.shape, grip, self._assembly.frame)
        return replace(found, words=found.words + why)

    def _add_relays(self, number: int, step: PartStep) -> None:
        """Add candidates with the part laid down in between, or handed over in the air."""
        found = find_relays(self._cell, self._skills, step)
        for k, (relay, tools) in enumerate(found, start=len(step.grips)):
            giver, receiver = relay.robots
            other = None if giver == receiver else giver
            about = number, receiver, step.part.name, k, relay.cost, other
            item = PrimaryCandidate(*about, tools=tools)
            self.paths.relays[item] = relay
            self._add(item, (relay.take.tried,), *relay.paths)
        if not found:
            reason = "robots reach no place in common, to lie or to be handed over"
            self.reject(number, f"{step.part.name} changes hands", reason)

    def _add_machine(self, number: int, work: MachineWork) -> None:
        """Add the machine, as the only candidate."""
        if work.door is not None:
            name = self._skills(NO_TOOLS).in_door(work.door)
            if name is not None:
                raise InfeasibleStepError(
                    f"step {number} ({work.words}): {name} stands in the door of {work.machine}"
                    " when it is at HOME",
                    steps=[number],
                    blocked_by=[name],
                )
        thing = f"{work.words}, step {number}"
        self.primaries.append(PrimaryCandidate(number, work.machine, thing, 0, 0.0))

    def _add_works(
        self, number: int, step: KnownStep, work: Work, robot: PlacedRobot
    ) -> None:
        process, name, tools = work.process, robot.name, mounted_tool(robot)
        if (reason := _unfit(robot, process)) is not None:
            self.reject(number, f"{name} does it", reason, name)
            return
        for k, turn in enumerate(process.turns):
            what = f"{name} turned by {np.degrees(turn):.0f} deg"
            tried = self._skills(tools).work(robot, step, process, turn)
            found = self.accept(number, what, tried.found(), name)
            if found is None:
                continue
            # What is worked at can be worked at again: each process is a thing of its own.
            thing = f"{work.words}, step {number}"
            at = process_targets(process, step.place, turn).first
            cost = joint_distance(robot.home, [*found.lead, *found.path][at])
            item = PrimaryCandidate(number, name, thing, k, cost, tools=tools)
            self._add(item, (tried,), found)

    def _add_holds(self, number: int, step: KnownStep, robot: PlacedRobot) -> None:
        held = step.held
        assert held is not None
        tools, words = mounted_tool(robot), f"{robot.name} holds {held.part.name}"
        lies = (held.pose,)
        own = self._own_grips(number, words, robot, held.part, held.grips, lies)
        skills = self._skills(tools)
        count = 0
        for k in (k for k in sort_grips_by_clearance(step) if k in own):
            if count == _MOST_HOLDS:
                break
            grip = own[k]
            tried = skills.hold(robot, step, grip.pose)
            found = skills.misfit(robot, held.part, grip) or tried.found()
            path = self.accept(number, f"{words}, {grip.words}", found, robot.name)
            if path is not None:
                count += 1
                cost = joint_distance(robot.home, path.path[-1])
                self._add(
                    SupportCandidate(number, robot.name, k, cost, tools), (tried,), path
                )


def _unfit(robot: PlacedRobot, process: Process) -> str | None:
    """Return the reason why a robot cannot do a process by its properties, None where there is none."""
    frames = ("flange", *robot.model.frames)
    if process.frame not in frames:
        return f"it has no frame {process.frame!r} (valid: {', '.join(frames)})"
    if process.tool in (None, robot.tool):
        return None
    has = "none is named" if robot.tool is None else f"it has {robot.tool}"
    return f"the tool must be {process.tool}: {has}"
