"""Replanning of the remaining steps of an assembly: begun steps continue, the others are reassigned.

The integer program is that of the whole assembly. Every begun step keeps its choice, and unavailable robots and
objects are excluded. Costs, workload balance and dependencies between choices are therefore the
same as in a plan of the whole assembly.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise, product

import numpy as np

from planning.cell.workcell import Workcell
from planning.geometry.robot_bodies import GROUPS, entity_name
from planning.geometry.scene_checker import SceneChecker
from planning.motion.motion_cache import MotionCache
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import (
    MARGIN,
    Expansion,
    MotionSettings,
    plan_steps_sequentially,
)
from planning.tasks.assembly import Assembly, Disposal
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    StepChoice,
    SupportCandidate,
    TaskPlan,
)
from planning.tasks.highs_solver import assign_steps
from planning.tasks.task import AllowedContact, StepTasks, Task, TaskKind
from planning.transforms import Array, Indices, read_only_copy
from planning.worlds.supplied import (
    RemovalPlan,
    brings_parts,
    find_removal,
    supplied_tasks_by_step,
    without_supplied_tasks,
)
from planning.worlds.world import UnfinishedStep, World, picked_steps, unfinished_steps


@dataclass(frozen=True)
class OnwardPlan:
    """A plan of the remaining work from a given world.

    Attributes:
        motions: of the new tasks, whose indices continue those of the world.
        task_plan: choices of all steps, those that have begun included.
        steps, past: as in ``World``, with the new tasks.
    """

    motions: MotionPlan
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
    past: tuple[StepTasks, ...]


@dataclass(frozen=True)
class ReplanningState:
    """A world, and the status of the plan in it.

    Attributes:
        world: where everything is, what is complete and what is out.
        task_plan: the choices up to now.
        reopened: begun steps that are to be repeated, with the robots that do no more work for them.
        given_up: steps that will not be done.
        evading: robots that make way: they go HOME with what they hold, and return later.
        rejected: rejected parts that have to go, by the number of the given-up step.
        reworked: steps that are done again before a step, one after another, by its number.
    """

    world: World
    task_plan: TaskPlan
    reopened: Mapping[int, frozenset[str]] = field(default_factory=dict)
    given_up: frozenset[int] = frozenset()
    evading: frozenset[str] = frozenset()
    rejected: Mapping[int, Disposal] = field(default_factory=dict)
    reworked: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    @property
    def kept(self) -> dict[int, StepChoice]:
        """Fixed choices by step: of begun steps, and of those given up."""
        begun = self.world.begun().keys() - self.reopened.keys()
        return {
            c.step: c for c in self.task_plan.choices if c.step in begun | self.given_up
        }

    @property
    def taken(self) -> dict[int, str]:
        """Objects taken by steps that are not reopened, by number; a placeholder for given-up steps."""
        nothing = {step: f"nothing, for step {step}" for step in self.given_up}
        own = picked_steps(self.world.begun(), self.world.complete)
        return {**nothing, **{k: t for k, t in own.items() if k not in self.reopened}}

    @property
    def present(self) -> frozenset[str]:
        """Objects that are present."""
        return frozenset(self.world.state.attachments)


def plan_onward(
    cell: Workcell,
    work: Assembly,
    settings: MotionSettings,
    now: ReplanningState,
    known: MotionCache | None = None,
) -> OnwardPlan:
    """Plan the rest of an assembly.

    Args:
        cell: with the objects that have come up.
        work: all candidates, and the tasks that follow from choices.
        settings: how tasks are turned into motions.
        now: where it begins.
        known: cache of paths.

    Raises:
        InfeasibleStepError: a step can no longer be done by anyone; says which and why.
        TransitError: no collision-free path was found, such as for a robot that is shut in.
    """
    world, kept = now.world, now.kept
    left = unfinished_steps(world, now.reopened)
    there = supplied_tasks_by_step(world)
    busy = _busy_until(cell, left, now.reopened)
    problem = fix_choices(work.problem, kept, world.out, busy)
    plan = replace(
        assign_steps(problem),
        taken=now.taken,
        present=now.present,
        tools=_tools_on_robots(problem, world),
        left=frozenset(
            {item.step.step for item in left}
            | ({choice.step for choice in now.task_plan.choices} - kept.keys())
            | set(range(len(now.task_plan.choices) + 1, len(problem.steps) + 1))
        )
        - now.given_up,
    )
    assembly = replace(work, problem=problem)
    items: list[_Item] = [_of_leftover(item, now) for item in left if item.ends]
    gone = {task.robot for item in left if item.ends for task in item.tasks}
    away = (*_idle_robots_away(cell, world, left, gone), *sorted(now.evading))
    for name in away:
        home = cell.robot(name).home
        items.append(_Item(_to(cell, world, name, home, stands=name not in gone)))
    burdens = _unplaceable_loads(world, left)
    for robot, load in burdens.items():
        removal = partial(find_removal, cell, world, robot, *load)
        items.append(_Item(_only_alternative(removal)))
    undone = frozenset(plan[step].object for step in now.given_up if step in kept)
    team = {robot.name for robot in cell.robots} - world.out
    rejected = {
        k: replace(own, robots=frozenset(r for r in team if busy.get(r, 0) < k))
        for k, own in now.rejected.items()
    }
    scrap = RemovalPlan(world, work.passing, undone, rejected)
    continued = {item.step.step: item for item in left if not item.ends}
    evading, stands = set(now.evading), world.state.configurations
    for step in range(1, len(plan.choices) + 1):
        if step in continued:
            item = continued[step]
            back = sorted(evading & {task.robot for task in item.tasks})
            items += [
                _Item(_to(cell, world, name, stands[name]), back=True) for name in back
            ]
            evading -= set(back)
            if step in now.reopened:
                items.append(_of_leftover(item, now))
            else:
                items.append(
                    _Item(
                        partial(_remaining_tasks, assembly, item), step, item.with_done
                    )
                )
        brought = there.get(step, ())
        if step in now.given_up:
            if work.passing or step in rejected:
                alternatives = partial(scrap.of_step, assembly, step, brought)
                items.append(_Item(alternatives, machines=step))
        elif step not in kept:
            items.append(_fresh(assembly, step, brought))
    begun = world.begun()
    steps = {number: begun[number] for number in begun.keys() - now.reopened.keys()}
    done = {number: _done(step, world) for number, step in steps.items()}
    # Tasks of an earlier plan that were never done have the numbers of new ones.
    left_behind = (step for step in world.steps if step.step not in steps)
    past = [_done(step, world) for step in (*world.past, *left_behind)]
    for step in now.given_up & there.keys():
        done[step] = StepTasks(step, there[step], (), ())

    def link(planned: Sequence[StepTasks]) -> Indices:
        for item, tasks in zip(items, planned, strict=True):
            if item.step is None:
                past.append(tasks)
            else:
                steps[item.step] = item.whole(tasks)
                done[item.step] = steps[item.step]
            if item.machines is not None:
                own = (
                    *there.get(item.machines, ()),
                    *filter(brings_parts, tasks.tasks),
                )
                done[item.machines] = StepTasks(item.machines, own, (), ())
        every = (task for step in (*past, *steps.values()) for task in step.tasks)
        waits = work.link([done[number] for number in sorted(done)])
        pairs = zip(items, planned, strict=True)
        machines = [tasks for item, tasks in pairs if item.machines is not None]
        inside = [pair for tasks in machines for pair in tasks.dependencies]
        inside += _back_before(zip(items, planned, strict=True))
        for number, before in now.reworked.items():
            inside += _one_after_another([*before, number], steps)
        more = np.array([*inside, *scrap.waits(every)], dtype=np.int64).reshape(-1, 2)
        links = np.unique(np.concatenate([waits, more]), axis=0)
        # What is complete does not wait for what is done again.
        return links[(links[:, 1] >= world.tasks) | (links[:, 0] < links[:, 1])]

    plan, motions = plan_steps_sequentially(
        cell,
        plan,
        [partial(_without_absent_objects, scrap, item.expand) for item in items],
        link,
        settings,
        known=known,
        # Of all steps, once they are linked.
        windows=lambda _: (
            window
            for window in work.windows([done[number] for number in sorted(done)])
            if not window.due < min(world.tasks, window.done)
        ),
        begins=world.beginning,
    )
    whole = tuple(steps[number] for number in sorted(steps))
    return OnwardPlan(motions, plan, whole, tuple(past))


@dataclass(frozen=True)
class _Item:
    """One item of the remaining work.

    Attributes:
        expand: yields its tasks, alternatives in order of preference.
        step: number of the step that it is, None for what only clears the way.
        whole: returns the tasks of the step, those done before included.
        machines: number of a given-up step for which machines continue.
        back: whether a robot comes back with it to where the next one continues.
    """

    expand: Expansion
    step: int | None = None
    whole: Callable[[StepTasks], StepTasks] = lambda planned: planned
    machines: int | None = None
    back: bool = False


def _back_before(
    planned: Iterable[tuple[_Item, StepTasks]],
) -> Iterator[tuple[int, int]]:
    """Yield dependencies: robots that made way return before others' skills, since those assume it."""
    back: list[Task] = []
    for item, own in planned:
        if item.back:
            back += own.tasks
            continue
        for b, task in product(back, own.tasks):
            if task.kind != TaskKind.TRANSIT and task.robot != b.robot:
                yield b.index, task.index
        back = []


def _one_after_another(
    numbers: Sequence[int], steps: Mapping[int, StepTasks]
) -> Iterator[tuple[int, int]]:
    """Yield dependencies: each step begins its work once that of the one before is done, abandoned ones left out."""
    moves = TaskKind.TRANSIT, TaskKind.STRAIGHT
    for a, b in pairwise(k for k in numbers if k in steps):
        done = [t.index for t in steps[a].tasks if t.kind not in moves]
        begins = [t.index for t in steps[b].tasks if t.kind != TaskKind.TRANSIT]
        yield from ((done[-1], task) for task in begins[:1] if done)


def _without_absent_objects(
    scrap: RemovalPlan, expand: Expansion, plan: TaskPlan, first: int
) -> Iterator[tuple[TaskPlan, StepTasks]]:
    """Yield the expansions of a step in which only present objects leave the cell."""
    for chosen, planned in expand(plan, first):
        yield chosen, scrap.without_absent_objects(planned)


def _fresh(assembly: Assembly, step: int, brought: tuple[Task, ...]) -> _Item:
    """Return a step that is done from its beginning, without repeating its deliveries."""

    def alternatives(
        plan: TaskPlan, first: int
    ) -> Iterator[tuple[TaskPlan, StepTasks]]:
        for chosen, planned in assembly.alternatives(step, plan, first):
            yield chosen, without_supplied_tasks(planned, brought)

    def whole(planned: StepTasks) -> StepTasks:
        return replace(planned, tasks=(*brought, *planned.tasks))

    return _Item(alternatives, step, whole)


def _tools_on_robots(problem: AssignmentProblem, world: World) -> dict[str, str | None]:
    """Return the tool on each robot that changes tools, None for a bare flange."""
    # Not those of the cell: that of a saved plan does not say which tools a robot has.
    found: dict[str, str | None] = dict.fromkeys(problem.mounted)
    held = {(at.holder, name) for name, at in world.held()}
    found.update((k, tool) for k, tool, _ in problem.changes if (k, tool) in held)
    return found


def _remaining_tasks(
    assembly: Assembly, left: UnfinishedStep, plan: TaskPlan, first: int
) -> Iterator[tuple[TaskPlan, StepTasks]]:
    """Yield the rest of a step, among its current surroundings."""
    # It was begun after all steps before it.
    planned = replace(plan, tools={}, left=None)
    yield plan, left.numbered(first, assembly.expand(planned, left.step.step, first))


def _of_leftover(left: UnfinishedStep, now: ReplanningState) -> _Item:
    number = left.step.step
    if number in now.reopened:
        return _Item(_only_alternative(left.numbered))
    return _Item(_only_alternative(left.numbered), number, left.with_done)


def fix_choices(
    problem: AssignmentProblem,
    kept: Mapping[int, StepChoice],
    out: Collection[str],
    busy_until: Mapping[str, int],
) -> AssignmentProblem:
    """Return a problem in which some steps keep their choices, and unavailable things are excluded.

    Args:
        problem: of the whole assembly.
        kept: choice of each step that has one.
        out: robots and objects that are out.
        busy_until: robots whose hands are full, with the step that empties them: they do no earlier one.
    """
    used = {c.object for c in kept.values()} - problem.unlimited

    def free(step: int, robot: str | None) -> bool:
        return robot is None or (robot not in out and step > busy_until.get(robot, 0))

    def may(item: PrimaryCandidate) -> bool:
        if item.step in kept:
            return item == kept[item.step].primary
        free_hands = free(item.step, item.robot) and free(item.step, item.partner)
        return free_hands and item.object not in out and item.object not in used

    def may_support(item: SupportCandidate) -> bool:
        if item.step in kept:
            return item == kept[item.step].support
        return free(item.step, item.robot)

    # What stood on another one stands there no more once a step has used it.
    gone = used | set(out)
    left = problem.of_candidates(may, may_support)
    primaries = tuple(
        item if item.step in kept else replace(item, after=item.after - gone)
        for item in left.primaries
    )
    return replace(left, primaries=primaries)


@dataclass(frozen=True)
class BlockedStep:
    """A step that no robot can do in the current state.

    Attributes:
        step: its number.
        robot: the robot that could if its hand were not occupied for a later step; None for none.
        later: that one, 0 where there is no such robot.
    """

    step: int
    robot: str | None = None
    later: int = 0


def find_blocked_step(
    cell: Workcell, problem: AssignmentProblem, now: ReplanningState
) -> BlockedStep | None:
    """Return the first step that no robot can do in a situation, None where there is none."""
    busy = _busy_until(cell, unfinished_steps(now.world, now.reopened), now.reopened)
    held = {at.holder for _, at in now.world.held()}
    about = problem, now.kept, now.world.out
    for step in fix_choices(*about, busy).impossible:
        if step in now.kept:
            continue
        for robot in sorted(busy.keys() & held):
            others = {k: until for k, until in busy.items() if k != robot}
            if step not in fix_choices(*about, others).impossible:
                return BlockedStep(step, robot, busy[robot])
        return BlockedStep(step)
    return None


def _carriers(left: list[UnfinishedStep]) -> Iterator[Task]:
    """Yield the tasks in which robots put down, or hand over, their loads."""
    for item in left:
        if not item.ends:
            yield from (task for task in item.tasks if task.kind != TaskKind.TRANSIT)


def _busy_until(
    cell: Workcell, left: list[UnfinishedStep], reopened: Collection[int]
) -> dict[str, int]:
    """Return, by robot, the last step that it cannot begin because of unfinished work."""
    until: dict[str, int] = {}
    for task in _carriers(left):
        if cell.is_machine(task.robot):
            continue
        # A step that is repeated comes after what is left of it.
        last = task.step - (task.step in reopened)
        until[task.robot] = max(last, until.get(task.robot, 0))
    return until


def _only_alternative(numbered: Callable[[int], StepTasks]) -> Expansion:
    def alternatives(
        plan: TaskPlan, first: int
    ) -> Iterator[tuple[TaskPlan, StepTasks]]:
        yield plan, numbered(first)

    return alternatives


def _idle_robots_away(
    cell: Workcell, world: World, left: list[UnfinishedStep], gone: Collection[str]
) -> Iterator[str]:
    """Yield the robots that stand away from HOME without unfinished work, and not at a goal.

    Of those that have gone a way by then, the ones that go no farther than out of where they were.
    """
    alternatives = {task.robot: task.kind for item in left for task in item.tasks}
    going = {
        k
        for k, kind in alternatives.items()
        if kind != TaskKind.STRAIGHT or k not in gone
    }
    last = set(world.beginning.last_task.values())
    tasks = (task for step in world.steps for task in step.tasks)
    going |= {task.robot for task in tasks if task.goal and task.index in last}
    for robot in cell.robots:
        at = world.state.configurations[robot.name]
        stands = abs(at - robot.home).max() > 1e-9
        if stands and robot.name not in {*going, *world.out}:
            yield robot.name


def _unplaceable_loads(
    world: World, left: list[UnfinishedStep]
) -> dict[str, tuple[str, int]]:
    """Return the objects in hands that have no placement any more, and the steps of their picks, by robot."""
    going = {task.robot for item in left if not item.ends for task in item.tasks}
    # Also in a step that was then restarted, if another plan came before the hand was emptied.
    steps = (*world.past, *world.steps)
    done = (t for s in steps for t in s.tasks if t.index in world.complete)
    picks = sorted((t.index, t.object, t.step) for t in done if t.kind == "pick")
    picked = {name: step for _, name, step in picks}
    return {
        at.holder: (name, picked[name])
        for name, at in world.held()
        if at.holder is not None
        and name in picked
        and at.holder not in going | world.out
    }


def _to(
    cell: Workcell, world: World, robot: str, q: Array, *, stands: bool = True
) -> Expansion:
    """Return the transit of a robot to or from its configuration in a world, if it still stands there."""
    last = world.beginning.last_task.get(robot)
    known = (*world.past, *world.steps)
    steps = [step for step in known for t in step.tasks if t.index == last]
    number = steps[0].step if steps else 1

    def numbered(first: int) -> StepTasks:
        task = Task(
            first, robot, TaskKind.TRANSIT, number, "aside", read_only_copy(q[None])
        )
        # What it touches where it stands, and may, it may touch on its way from and to there.
        allowed: Sequence[AllowedContact] = ()
        if last is not None and stands:
            whole = steps[0]
            done = world.complete.intersection(t.index for t in whole.tasks)
            touch = _touches(cell, world, robot)
            allowed = [
                replace(c, tasks=(c.tasks & done) | {first})
                for c in whole.allowed
                if last in c.tasks and touch(c)
            ]
        return StepTasks(number, (task,), (), tuple(allowed))

    return _only_alternative(numbered)


def _touches(
    cell: Workcell, world: World, robot: str
) -> Callable[[AllowedContact], bool]:
    """Return what tells whether the two of a contact touch where a robot stands in a world, or move as one with it."""
    checker = SceneChecker(cell, robot, world.state, margin=MARGIN)
    there = checker.pairs_in_contact(world.state.configurations[robot])
    held = {name for name, at in world.held() if at.holder == robot}
    own = held | {entity_name(robot, group) for group in GROUPS}

    def touches(contact: AllowedContact) -> bool:
        pair = {contact.first, contact.second}
        return pair <= own or pair in there

    return touches


def _done(step: StepTasks, world: World) -> StepTasks:
    """Return the completed part of a step."""
    tasks = tuple(t for t in step.tasks if t.index in world.complete)
    return replace(step, tasks=tasks, dependencies=())
