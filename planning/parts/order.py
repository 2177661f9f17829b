"""Search for a feasible order of the steps of an assembly of parts.

These rules hold before the search:

- A part follows the parts that it rests on.
- A part precedes each part that would block its straight insertion path.
- Parts stacked in the stock are picked from the top.
- A process follows the placement of its part, and precedes parts that would block its tool.

The first order satisfies these rules and the precedences of the scenario, and is as close as possible to the order of
the scenario. If a placed part makes a step infeasible for every robot, that part is placed after the step. If a part
at its start pose makes it infeasible, that part is placed before the step. Then the next order is tried.

A part that would fall (``balance``) is placed after parts that support it. If there are none and a later
step joins it to other parts, its robot holds it until then, and that step comes as soon as possible.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, Workcell
from planning.contacts.interference import ROUNDING, overlap_depth, sweeps_through
from planning.contacts.precedence import (
    PartGraph,
    StepPrecedence,
    build_part_graph,
    parts_stacked_on,
)
from planning.contacts.touching import PlacedObject, nearby_entities, nearest_entity
from planning.errors import InfeasibleStepError
from planning.handling.tool_changes import with_tools_in_racks
from planning.parts.assembly import AnyStep, MachineWork, PartAssembly, PlacePart, Work
from planning.parts.balance import PartBalance, make_stability_check
from planning.parts.candidates import PartCandidates, find_candidates
from planning.parts.part_steps import (
    format_room,
    objects_in_place,
    part_steps,
    spot_pose,
)
from planning.progress import Progress, no_progress
from planning.transforms import translation

_BORE = 0.002
"""Width of the straight path of a tool to the place of its process, which no part may block [m]."""


def order_steps_by_search(cell: Workcell, assembly: PartAssembly) -> PartAssembly:
    """Return the assembly with its steps in an order that placement and contacts allow.

    Args:
        cell: its objects are the parts.
        assembly: its steps are in any order.

    Raises:
        InfeasibleStepError: there is no such order; the message names steps that wait for each other.
        ConstructionError: two parts would overlap in their places.
    """
    steps = _UnorderedSteps(cell, assembly)
    return steps.ordered(steps.propped(steps.precedence()))


def find_ordered_candidates(
    cell: Workcell,
    assembly: PartAssembly,
    progress: Progress = no_progress,
) -> PartCandidates:
    """Return the candidates of an assembly in an order in which robots can do every step.

    Where no robot can do a step, the part that blocked most attempts is moved from before the step to
    after it, or the other way round, and the next order is tried.

    Args:
        cell: its objects are the parts.
        assembly: its steps are in any order.
        progress: called with the number of orders tried, and its maximum.

    Raises:
        InfeasibleStepError: no order was found; names the obstacles of the last one.
        ConstructionError: two parts would overlap in their places.
    """
    steps = _UnorderedSteps(with_tools_in_racks(cell), assembly)
    known = steps.precedence()
    most = 2 * len(assembly.steps)
    for tried in range(most + 1):
        progress(tried, most)
        known = steps.propped(known)
        ordered = steps.ordered(known)
        found = find_candidates(cell, ordered)
        stuck = found.problem.impossible
        if not stuck or tried == most:
            return found  # the assignment reports the steps that are still impossible
        changed = steps.moved(known, ordered, stuck[0], found.blockers[stuck[0]])
        if changed is None:
            return found
        known = changed
    raise AssertionError("the last try returns")


class _UnorderedSteps:
    """Unordered steps, and the precedence known between them.

    Args:
        cell: its objects are the parts.
        assembly: its steps.
    """

    def __init__(self, cell: Workcell, assembly: PartAssembly) -> None:
        self._cell, self._assembly = cell, assembly
        self._steps: tuple[AnyStep, ...] = assembly.steps
        self._named = {s.name: k for k, s in enumerate(self._steps)}
        self._places = {
            k: s for k, s in enumerate(self._steps) if isinstance(s, PlacePart)
        }
        self._placing = {step.part: k for k, step in self._places.items()}
        objects = {name: cell.object(name) for name in self._placing}
        self._starts: dict[str, PlacedObject] = {
            name: (item, item.start) for name, item in objects.items()
        }
        self._goals: dict[str, PlacedObject] = {
            name: (objects[name], assembly.goals[name]) for name in assembly.placed
        }
        placed = objects_in_place(cell, assembly)
        self._fixed = {k: v for k, v in placed.items() if k not in self._goals}

    def precedence(self) -> StepPrecedence:
        """Return the step precedence that follows from places and contacts alone.

        Raises:
            ConstructionError: two parts would overlap in their places.
        """
        rules = self._assembly
        graph = build_part_graph(
            self._goals,
            list(self._fixed.values()),
            touch=rules.touch,
            overlaps=rules.overlaps,
        )
        parts = {k: step.part for k, step in self._places.items()}
        out = StepPrecedence(
            tuple(step.words for step in self._steps),
            tuple({} for _ in self._steps),
            tuple(
                self._alternative_supports(graph, parts.get(k))
                for k in range(len(self._steps))
            ),
            {
                k: frozenset({self._named[step.until]})
                for k, step in self._places.items()
                if step.until is not None
            },
        )
        for first, then, why in (
            *self._stated_precedence(),
            *self._support_precedence(graph),
            *self._insertion_precedence(),
            *self._process_precedence(),
        ):
            out.require(first, then, why)
        return out

    def _alternative_supports(
        self, graph: PartGraph, part: str | None
    ) -> frozenset[int]:
        """Return the steps at least one of which must precede a part that touches nothing else."""
        if part is None or part in graph.ground:
            return frozenset()
        near = {*graph.neighbours[part], *self._assembly.joined_to(part)}
        if not near <= self._goals.keys():
            return frozenset()
        return frozenset(self._placing[other] for other in near)

    def _gap_message(self, steps: Collection[int]) -> str:
        """Return a message on the smallest gap between parts of some steps and the fixed surroundings."""
        names = dict.fromkeys(s.part for k, s in self._places.items() if k in steps)
        near = {name: nearest_entity(self._goals[name], self._fixed) for name in names}
        found = [(at[1], name, at[0]) for name, at in near.items() if at is not None]
        if not found:
            return ""
        gap, name, other = min(found)
        return (
            f"; none of them touches what stands: nearest is {name}, {gap * 1e3:.1f} mm from {other}"
            f" (touch_m {self._assembly.touch:g}): put it nearer, or join the two over that room"
            f" (joined: {{parts: [{name}, {other}], gap_m: {format_room(gap):g}}})"
        )

    def ordered(self, known: StepPrecedence) -> PartAssembly:
        """Return the assembly with its steps in the feasible order nearest to the list.

        Raises:
            InfeasibleStepError: there is none; the message names steps that wait for each other.
        """
        order = known.order()
        if order is None:
            raise InfeasibleStepError(
                f"there is no order of the steps\n{known.explained(self._gap_message)}"
            )
        return replace(self._assembly, steps=tuple(self._steps[k] for k in order))

    def propped(self, known: StepPrecedence) -> StepPrecedence:
        """Return the precedence with all props that are found before the parts that they support.

        Parts that fall without any prop or hold stay as they are: ``find_candidates`` refuses them.
        """
        if self._assembly.balance is None:
            return known
        standing, holdable = None, set[str]()
        while True:
            ordered = self.ordered(known)
            steps, rules = part_steps(self._cell, ordered), self._assembly.balance
            standing = standing or make_stability_check(self._cell, steps, rules)
            balance = PartBalance(self._cell, steps, rules, standing, holdable)
            if balance.fall is None:
                return known
            falls = self._number(ordered.steps[balance.fall.step])
            words = f"{balance.fall.body} would fall without it"
            tries = (
                known.with_required(self._placing[name], falls, words)
                for name in balance.props(balance.fall)
            )
            changed = next((t for t in tries if t.order() is not None), None)
            if changed is None:
                name = next((n for n in balance.fall.holds if n not in holdable), None)
                if name is None or not (ends := self._joining(name, falls)):
                    return known
                holdable.add(name)
                closing = {**known.closing, self._placing[name]: ends}
                changed = replace(known, closing=closing)
            known = changed

    def moved(
        self,
        known: StepPrecedence,
        ordered: PartAssembly,
        step: int,
        blockers: Counter[str],
    ) -> StepPrecedence | None:
        """Return the precedence after a part that blocks a step is moved past it.

        Args:
            known: the precedence.
            ordered: the order that was tried.
            step: number in that order of the step that no robot can do, from 1.
            blockers: how often each obstacle blocked the step.
        """
        place = {
            s.part: k
            for k, s in enumerate(ordered.steps, 1)
            if isinstance(s, PlacePart)
        }
        blocked = self._number(ordered.steps[step - 1])
        for name in sorted(blockers, key=lambda name: (-blockers[name], name)):
            placing = self._placing.get(name, blocked)
            if placing == blocked:
                continue
            if place[name] < step:
                words = f"{name} would be in the way"
                changed = known.with_required(blocked, placing, words)
            else:
                words = f"{name} is in the way where it is at the start"
                changed = known.with_required(placing, blocked, words)
            if changed.order() is not None:
                return changed
        return None

    def _number(self, step: AnyStep) -> int:
        """Return the index of a step in the order of the scenario."""
        return next(k for k, own in enumerate(self._steps) if own is step)

    def _joining(self, part: str, but: int) -> frozenset[int]:
        """Return the steps that join a part to others, except one."""
        found = set()
        for joint in self._assembly.joints:
            if part in joint.ends:
                (other,) = {*joint.ends} - {part}
                by_other = self._placing.get(other)
                found.add(by_other if joint.by is None else self._named[joint.by])
        return frozenset(k for k in found if k is not None and k != but)

    def _stated_precedence(self) -> Iterator[tuple[int, int, str]]:
        """Yield precedences that the scenario states, and those of processes and holds, whose parts must be placed."""
        placing = self._placing
        for k, step in enumerate(self._steps):
            for name in step.after:
                yield self._named[name], k, "as its after says"
            if isinstance(step, PlacePart) and step.until is not None:
                words = f"{step.part} is kept hold of until then"
                yield k, self._named[step.until], words
            if step.hold in placing:
                yield placing[step.hold], k, f"{step.hold} is held in its place"
            if isinstance(step, Work) and step.spot.owner in placing:
                owner = step.spot.owner
                yield placing[owner], k, f"it is done at {owner} in its place"
            for part in step.parts if isinstance(step, MachineWork) else ():
                if part in placing:
                    yield placing[part], k, f"it is done at {part} in its place"

    def _support_precedence(self, graph: PartGraph) -> Iterator[tuple[int, int, str]]:
        """Yield the support relations of parts in their places and at the start."""
        at = self._placing
        for name, carriers in graph.carriers.items():
            for other in sorted(carriers):
                yield at[other], at[name], f"{name} rests on {other}"
        for name, covers in parts_stacked_on(self._starts).items():
            for other in sorted(covers):
                yield at[other], at[name], f"{other} lies on {name} at the start"

    def _insertion_precedence(self) -> Iterator[tuple[int, int, str]]:
        """Yield parts that would block another part's straight insertion, or its removal from the start."""
        at, goals = self._placing, self._goals
        handled = {name: self._assembly.handling(name) for name in at}
        for name, goal in goals.items():
            down = np.array(handled[name].insertion), handled[name].approach
            for other, there in goals.items():
                if other == name:
                    continue
                most = self._assembly.overlaps.most(name, other)
                if sweeps_through(goal, there, *down, most):
                    words = f"{other} would bar the way of {name} to its place"
                    yield at[name], at[other], words
                start = self._starts[other]
                up = -np.array(handled[other].extraction), handled[other].leave
                if overlap_depth(goal, start) > ROUNDING or sweeps_through(
                    goal, start, *down
                ):
                    yield at[other], at[name], f"{other} is where {name} goes"
                elif sweeps_through(start, goal, *up):
                    words = f"{name} would lock {other} in at its start"
                    yield at[other], at[name], words

    def _process_precedence(self) -> Iterator[tuple[int, int, str]]:
        """Yield parts that would block the straight path of a tool to its workplace, such as a rod on it."""
        placed = {item.name: item.start for item in self._cell.objects}
        placed |= self._assembly.goals
        for k, step in enumerate(self._steps):
            if not isinstance(step, Work):
                continue
            place = spot_pose(self._cell, step.spot, placed)
            long = step.process.approach - 2.0 * _BORE
            rod = box_shape("way", (_BORE, _BORE, long))
            for pose in step.process.path or (np.eye(4),):
                at = place @ pose @ translation(0.0, 0.0, 0.5 * step.process.approach)
                way = Fixture("way", rod, at), at
                for name, goal in self._goals.items():
                    if name != step.spot.owner and _overlap(way, goal):
                        words = f"{name} would bar the tool's way to {step.spot.words}"
                        yield k, self._placing[name], words


def _overlap(one: PlacedObject, other: PlacedObject) -> bool:
    return any(
        gap < -0.5 * _BORE for gap in nearby_entities(one, {"": other}, 0.0).values()
    )
