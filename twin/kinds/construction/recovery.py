"""Recovery of constructions after failures: replanning of the remaining parts from the current state.

A part that fell or broke is lost. An unplaced part of the same type is used in its place, and the goal with the
fewest dependent goals is abandoned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.construction.continuation import (
    ConstructionResumePoint,
    plan_remaining_construction,
)
from planning.construction.motion_plan_export import motion_plan, placement_order
from planning.construction.problem.models import ModelPart
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.settings import PlannerSettings
from planning.construction.world.fixed_world import BuildState
from planning.errors import ConstructionError, PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import AllowedContact, Task
from planning.worlds.supplied import find_removal
from planning.worlds.world import World
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import active_holds, complete_tasks
from twin.host.progress import StageWatch
from twin.kinds.construction.kind import ConstructionKind
from twin.operations.commitment import (
    CommittedPrefix,
    Draw,
    ReplanTrigger,
    committed_at,
    cut_at,
    executable_lengths,
)
from twin.operations.failure_triage import FailureTriage, request_replacement
from twin.operations.ledger import LedgerDraft, LedgerEntries, OperationLedger
from twin.operations.person import Person
from twin.operations.planner import (
    Extension,
    Planner,
    RecoveryState,
    TaskSeeds,
    append_extension,
    empty_extension,
)
from twin.operations.replanning import graph_from_world
from twin.planning.time_parameterization import time_parameterize
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario

_PUT = "place-down"


@dataclass(frozen=True)
class _Built(RecoveryState):
    """State of the plan of a construction.

    Attributes:
        parts: where each belongs by now.
        step_of: step that puts it there, by its name.
        kept: parts that would fall and are held, see ``ConstructionResumePoint``.
    """

    parts: tuple[ModelPart, ...]
    step_of: Mapping[str, int]
    kept: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def exchanged(self, one: str, other: str) -> _Built:
        """Return the state with the goals of two parts exchanged."""
        if one == other:
            return self
        goals = {part.name: part.goal for part in self.parts}
        goals |= {one: goals[other], other: goals[one]}
        steps = {**self.step_of, one: self.step_of[other], other: self.step_of[one]}
        parts = tuple(replace(part, goal=goals[part.name]) for part in self.parts)
        return replace(self, parts=parts, step_of=steps)


@dataclass
class ConstructionRecovery(Planner[_Built]):
    """Replans the rest of a construction after failures.

    Args:
        scenario: scenario with its recovery section.
        motions: base motions of the first plan.
        tpg: the first plan, or its executed part.
        draw: times of new nodes.
        person: answers questions before a step is abandoned.
        gone: parts that are lost already.
        steps: whether robots bring their steps to an end before the cut; their tasks only otherwise.
    """

    scenario: Scenario
    motions: PlannedMotions
    tpg: TemporalPlanGraph
    draw: Draw
    person: Person
    gone: frozenset[str] = frozenset()
    steps: bool = True
    _made: dict[object, ConstructionProblem] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Store data of the first plan."""
        building = self.motions.assembly.building
        kind = assembly_kind(self.scenario.assembly)
        assert isinstance(kind, ConstructionKind)
        self.kind, tpg = kind, self.tpg
        steps = {name: k for k, name in enumerate(building.placed, start=1)}
        carriers = self.motions.assembly.problem.graph.carriers
        above = {
            steps[name]: frozenset(steps[k] for k in steps if name in carriers[k])
            for name in steps
        }
        ledger = OperationLedger(above, gone=frozenset(self.gone))
        self.initial = _Built(tpg, TaskSeeds.of(tpg), ledger, kind.parts, steps)

    def begun(self, state: _Built, counts: Sequence[int]) -> set[int]:
        """Return the steps started by given numbers of executed nodes of each chain."""
        complete = complete_tasks(state.tpg, counts)
        done = (state.tpg.tasks[k] for k in complete)
        return {task.step for task in done if task.kind in ("pick", "handover", _PUT)}

    def due(self, _state: _Built, _released: Sequence[int]) -> bool:
        """Return False: all is planned."""
        return False

    def is_short(self, state: _Built) -> bool:
        """Return whether the plan of a state lacks wanted parts."""
        return bool(state.ledger.given_up)

    def end(
        self, state: _Built, trigger: ReplanTrigger, why: str
    ) -> tuple[_Built, Extension]:
        """Return the state with all remaining steps abandoned, and the committed graph alone."""
        tpg, ledger = state.tpg, state.ledger.draft()
        about = self.scenario.execution, ledger, self.person
        triage = FailureTriage(*about).decide(tpg, trigger)
        counts = executable_lengths(tpg, trigger)
        at = committed_at(tpg, counts, trigger, triage)
        complete = (at.committed.tasks[k] for k in at.complete)
        done = {task.step for task in complete if task.kind == _PUT}
        for step in sorted({*state.step_of.values()} - done - ledger.undone):
            ledger.give_up(step, why)
        after = replace(state, ledger=ledger.recorded())
        return after, empty_extension(at, tpg.cell)

    def extend(
        self,
        state: _Built,
        trigger: ReplanTrigger,
        *,
        more_steps: bool = True,
    ) -> tuple[_Built, Extension]:
        """Return the next state and an extended graph, see ``Planner``."""
        tpg, ledger = state.tpg, state.ledger.draft()
        section = self.scenario.execution
        triage = FailureTriage(section, ledger, self.person).decide(tpg, trigger)
        counts = cut_at(tpg, trigger, steps=self.steps)
        at = committed_at(tpg, counts, trigger, triage)
        for step in trigger.unwanted - self.begun(state, counts):
            ledger.drop(step)
        attachments = self._part_attachments(ledger, at)
        ledger.gone |= {
            name for name, own in attachments.items() if own.holder in at.out
        }
        placed = tuple(
            ledger.lost(str(task.object))
            for task in at.committed.tasks
            if task.kind == _PUT and task.index in at.complete
        )
        kept, placed = self._kept(state, ledger, at, placed)
        built = replace(state, kept=kept)
        for name in placed:
            goals = {part.name: part.goal for part in built.parts}
            lies = attachments[name].pose
            (own,) = (k for k in goals if np.allclose(goals[k], lies, atol=1e-6))
            built = built.exchanged(name, own)
        for name in sorted(ledger.gone & built.step_of.keys()):
            built = self._exchanged(built, ledger, name, placed, attachments)
        for name in sorted(ledger.gone & built.step_of.keys() - attachments.keys()):
            if (step := built.step_of[name]) not in ledger.undone:
                about = ledger, self.person, tpg.cell
                request_replacement(*about, step, name, f"{name} is lost")
        attachments = self._part_attachments(ledger, at)
        problem = self._problem(tpg.cell, built, ledger, placed, attachments, at.out)
        names = {part.name for part in problem.parts}
        held = {
            name: own for name, own in attachments.items() if own.holder is not None
        }
        robots = {r.name: at.state.configurations[r.name] for r in tpg.cell.robots}
        complete = frozenset(at.complete)
        before = at.committed.tasks
        now = WorldState(at.state.configurations, attachments)
        world = World(now, complete=complete, out=at.out, tasks=len(before))
        try:
            effort = PlannerSettings().finding(self.motions.settings.paths)
            rest = plan_remaining_construction(
                problem, ConstructionResumePoint(robots, placed, held, kept), effort
            )
            kept = {k: (own.robot, own.last) for k, own in rest.kept.items()}
            built = replace(built, kept=kept)
            self._give_up(built, ledger, rest.placed)
            plan = self._motions(problem, built, rest, world, tpg.cell)
            new = graph_from_world(plan, world, before, StageWatch())
            new = time_parameterize(new, self.scenario, StageWatch())
            waits = self._waits(problem, ledger, rest, plan, at)
            union, new, _ = append_extension(at, new, tpg.cell, ledger, waits)
        except (ConstructionError, PlanInvariantError) as error:
            for name in names - {*placed}:
                why = str(error).partition("\n")[0]
                ledger.given_up.setdefault(built.step_of[name], why)
            self._give_up(built, ledger, placed)
            extension = empty_extension(at, tpg.cell)
            return replace(built, ledger=ledger.recorded()), extension
        return replace(built, ledger=ledger.recorded()), (union, new, at)

    def _part_attachments(
        self, ledger: LedgerEntries, at: CommittedPrefix
    ) -> Mapping[str, Attachment]:
        """Return the poses of parts, by their plan names."""
        pending = ledger.pending(at.committed.tasks)
        return ledger.where(at.state.attachments, pending, at.committed.cell)

    def _kept(
        self,
        state: _Built,
        ledger: LedgerEntries,
        at: CommittedPrefix,
        placed: Sequence[str],
    ) -> tuple[dict[str, tuple[str, str]], tuple[str, ...]]:
        """Return the held parts, and the order of placed parts: held ones before their support, or last."""
        kept, order = {}, list(placed)
        for name, (robot, last) in state.kept.items():
            if name in placed:
                kept[name] = robot, last if last in placed else ""
        pairs = {name: last for name, (_, last) in kept.items()}
        for part, robot, until, left in active_holds(state.tpg, at.complete):
            name, last = ledger.lost(part), ledger.lost(until)
            pairs[name], kept[name] = last, (robot, last)
            if left:
                del kept[name]
        for name, last in pairs.items():
            order.remove(name)
            order.insert(order.index(last) if last else len(order), name)
        return kept, tuple(order)

    def _exchanged(
        self,
        built: _Built,
        ledger: LedgerEntries,
        name: str,
        placed: Sequence[str],
        attachments: Mapping[str, Attachment],
    ) -> _Built:
        """Return the goals of parts after a lost one is replaced by another of its kind."""
        steps = built.step_of
        if steps[name] in ledger.undone:
            return built
        parts = {part.name: part for part in built.parts}
        own = self._alike(parts[name])
        spare = [
            other
            for other in parts
            if other not in {*placed, *ledger.gone}
            and steps[other] not in ledger.undone
            and other in attachments
            and attachments[other].holder is None
            and self._alike(parts[other]) == own
        ]
        # What least rests on is missed least; of these what comes last.
        least = min(
            [name, *spare], key=lambda k: (self._above(ledger, steps[k]), -steps[k])
        )
        return built.exchanged(name, least)

    def _alike(self, part: ModelPart) -> object:
        """Return the key of interchangeable parts."""
        insertions = {own.name: own.insertion for own in self.kind.section.parts}
        about = part.size.tobytes(), part.mass, part.faces
        return *about, insertions.get(part.name)

    def _above(self, ledger: LedgerEntries, step: int) -> int:
        """Return the number of remaining steps that depend on a step."""
        found, todo = set[int](), [step]
        while todo:
            more = ledger.resting.get(todo.pop(), frozenset()) - found - ledger.undone
            found |= more
            todo += more
        return len(found)

    def _problem(
        self,
        cell: Workcell,
        built: _Built,
        ledger: LedgerEntries,
        placed: Sequence[str],
        attachments: Mapping[str, Attachment],
        out: frozenset[str],
    ) -> ConstructionProblem:
        """Return the problem of all placed or remaining parts."""
        wanted = tuple(
            part
            for part in built.parts
            if part.name in placed
            or (
                part.name in attachments
                and part.name not in ledger.gone
                and built.step_of[part.name] not in ledger.undone
            )
        )
        key = (
            tuple((p.name, p.goal.tobytes()) for p in wanted),
            out,
            frozenset(attachments),
        )
        if key not in self._made:
            objects = tuple(
                replace(item, later=item.name not in attachments)
                for item in cell.objects
            )
            now = replace(cell, objects=objects)
            found = self.kind.problem(now, self.motions.settings, wanted)
            self._made[key] = replace(found, idle=out)
        return self._made[key]

    def _give_up(
        self,
        built: _Built,
        ledger: LedgerDraft,
        placed: Mapping[str, float] | Sequence[str],
    ) -> None:
        """Abandon the steps of unplaced parts, with the reason."""
        undone = {k: name for name, k in built.step_of.items() if name not in placed}
        for step, name in sorted(undone.items()):
            if step not in ledger.undone and name in ledger.gone:
                ledger.give_up(step, f"{name} is lost")
        for step, name in sorted(undone.items()):
            if step not in ledger.undone:
                held = (
                    f": {part} would fall without {robot}, which keeps hold of it"
                    for part, (robot, last) in built.kept.items()
                    if not last
                )
                why = next(held, "")
                ledger.give_up(step, f"no way was found to place {name}{why}")

    def _motions(
        self,
        problem: ConstructionProblem,
        built: _Built,
        rest: BuildState,
        world: World,
        cell: Workcell,
    ) -> MotionPlan:
        """Return the motions of the rest, renumbered, with removals by persons at the end."""
        plan, first = motion_plan(problem, rest), world.tasks
        order, steps = list(rest.placed), built.step_of
        tasks = [
            replace(
                task,
                index=task.index + first,
                step=steps[order[task.step - 1]] if task.step <= len(order) else 1,
            )
            for task in plan.tasks
        ]
        allowed = [
            replace(c, tasks=frozenset(k + first for k in c.tasks))
            for c in plan.allowed
        ]
        motions, end = list(plan.motions), rest.world.end
        for name, contacts, task in self._removed(
            rest, world, cell, steps, first + len(tasks)
        ):
            home = cell.robot(name).home
            lasts = self.scenario.execution.recovery.remove_s
            motions.append(
                TaskMotion(np.stack([home, home]), np.array([end, end + lasts]))
            )
            tasks.append(task)
            allowed += contacts
        waits = np.asarray(plan.dependencies, dtype=np.int64).reshape(-1, 2) + first
        return MotionPlan(cell, tuple(tasks), tuple(motions), waits, tuple(allowed))

    def _removed(
        self,
        rest: BuildState,
        world: World,
        cell: Workcell,
        steps: Mapping[str, int],
        first: int,
    ) -> Iterator[tuple[str, Sequence[AllowedContact], Task]]:
        """Yield robots that hold a useless object at HOME, with its removal."""
        for name, own in world.held():
            holder = str(own.holder)
            if own.holder in world.out or name in rest.placed:
                continue
            ends = rest.world.robots[holder].path[-1]
            if np.abs(ends - cell.robot(holder).home).max() < 1e-6:
                step = find_removal(cell, world, holder, name, steps[name], first)
                yield holder, step.allowed, step.tasks[0]
                first += 1

    def _waits(
        self,
        problem: ConstructionProblem,
        ledger: LedgerEntries,
        rest: BuildState,
        plan: MotionPlan,
        at: CommittedPrefix,
    ) -> np.ndarray:
        """Return the edges between new and committed nodes, shape (e, 2)."""
        before = [task for task in at.committed.tasks if task.kind in ("pick", _PUT)]
        name_of = ledger.lost
        put = {name_of(str(t.object)): t.index for t in before if t.kind == _PUT}
        taken = {name_of(str(t.object)): t.index for t in before if t.kind == "pick"}
        needs, covers = placement_order(problem, rest), problem.graph.covers
        pairs = [tuple(pair) for pair in plan.dependencies.tolist()]
        for task in plan.tasks:
            name = str(task.object)
            if task.kind == _PUT:
                pairs += [(put[k], task.index) for k in needs[name] if k in put]
            elif task.kind == "pick":
                own = covers.get(name, ())
                pairs += [(taken[k], task.index) for k in own if k in taken]
            elif name in rest.kept and rest.kept[name].robot == task.robot:
                last = rest.kept[name].last
                pairs += [(put[k], task.index) for k in (last,) if k in put]
        return np.array(sorted(set(pairs)), dtype=np.int64).reshape(-1, 2)
