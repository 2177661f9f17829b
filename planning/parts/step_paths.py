"""Paths of the steps of an assembly of parts, alone and beside robots that hold something meanwhile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from planning.cell.workcell import Attachment
from planning.parts.assembly import Grip
from planning.parts.part_skills import PartSkills
from planning.parts.part_steps import KnownStep, MachineStep, PartStep, WorkStep
from planning.parts.relays import Relay
from planning.steps.handovers import CandidateCollector
from planning.steps.skill import (
    NOTHING,
    Obstruction,
    SkillContacts,
    SkillPath,
    gripped,
)
from planning.steps.skill_scene import SkillScene, find_obstruction
from planning.tasks.assignment import (
    NO_TOOLS,
    PrimaryCandidate,
    SupportCandidate,
    TaskPlan,
    Tools,
)
from planning.tasks.task import STRAIGHT
from planning.transforms import Array

_ENOUGH = 4
"""So many candidates of each robot to place a part and keep hold of it are looked for, and so many of
another one to do a step meanwhile."""


@dataclass(frozen=True)
class Holders:
    """Robots that hold something.

    Attributes:
        at: where they stand, by name, shape (n,) each.
        tools: that they have on them, if they change theirs.
    """

    at: Mapping[str, Array] = field(default_factory=dict)
    tools: Tools = NO_TOOLS

    def and_also(self, other: Holders) -> Holders:
        """Return these and others."""
        return Holders({**self.at, **other.at}, self.tools | other.tools)


NOBODY = Holders()


@dataclass(frozen=True)
class StepPaths:
    """Paths of the candidates of an assembly, found alone, and beside robots that hold something.

    Attributes:
        skills: returns those of robots that have certain tools on them, all others at HOME.
        steps: what is done.
        alone: pick and place, or a process, of every candidate, beside nobody.
        holds: how a part is held, beside nobody.
        relays: how the part changes hands in between, of candidates with which it does.
        keeps: by step, from 1, whose robot keeps hold of what it placed, the step until which.
    """

    skills: Callable[[Tools], PartSkills]
    steps: Sequence[KnownStep]
    alone: dict[PrimaryCandidate, tuple[SkillPath, ...]] = field(default_factory=dict)
    holds: dict[SupportCandidate, SkillPath] = field(default_factory=dict)
    relays: dict[PrimaryCandidate, Relay] = field(default_factory=dict)
    keeps: Mapping[int, int] = field(default_factory=dict)

    def among(
        self, item: PrimaryCandidate, holding: Holders, supporting: Holders = NOBODY
    ) -> tuple[SkillPath, ...] | Obstruction:
        """Return the paths of a candidate beside robots that hold something, or what is in its way.

        Paths that are free beside them are as they were. How a part gets to where its robot picks
        it last is not looked at.

        Args:
            item: the candidate.
            holding: who holds something all the time.
            supporting: who holds something while the part is placed, or the process is done.
        """
        step = self.steps[item.step - 1]
        if isinstance(step, MachineStep):
            return ()
        known = self.alone[item]
        if not holding.at and not supporting.at:
            return known
        early = self._skills(item.tools, holding)
        skills = self._skills(item.tools, holding.and_also(supporting))
        robot = skills.cell.robot(item.robot)
        if isinstance(step, WorkStep):
            turn = step.step.process.turns[item.grasp]
            found = [skills.work(robot, step, turn, known[-1])]
        else:
            grip = self.grip_of(item).pose
            found = [skills.place(robot, step, grip, known[-1])]
            if item not in self.relays and holding.at:
                found = [early.pick(robot, step, grip, known[0]), *found]
                blocked = early.carried_home(robot, step, grip)
                found += [] if blocked is None else [blocked]
        wrong = next((item for item in found if isinstance(item, Obstruction)), None)
        if wrong is not None:
            return wrong
        own = [item for item in found if isinstance(item, SkillPath)]
        return (*known[: len(known) - len(own)], *own)

    def held_among(
        self, item: SupportCandidate, holding: Holders
    ) -> SkillPath | Obstruction:
        """Return how a robot holds a part beside others, or what is in its way."""
        step, known = self.steps[item.step - 1], self.holds[item]
        if not holding.at:
            return known
        assert not isinstance(step, MachineStep)
        assert step.held is not None
        skills = self._skills(item.tools, holding)
        robot, grip = skills.cell.robot(item.robot), step.held.grips[item.pose].pose
        return skills.hold(robot, step, step.held, grip, known)

    def _skills(self, tools: Tools, holding: Holders) -> PartSkills:
        return replace(self.skills(tools | holding.tools), holding=holding.at)

    def grip_of(self, item: PrimaryCandidate) -> Grip:
        """Return the grip with which a part is placed."""
        step, relay = self.steps[item.step - 1], self.relays.get(item)
        assert isinstance(step, PartStep)
        return step.grips[item.grasp] if relay is None else relay.take

    def planned(self, plan: TaskPlan, step: int) -> tuple[SkillPath, ...]:
        """Return pick and place of a step, or its process, beside all that is held meanwhile.

        Where nothing is free beside several that hold, the paths are those beside nobody, which
        motion planning finds to be blocked.
        """
        choice, supporting = plan[step], NOBODY
        if (hold := self.planned_hold(plan, step)) is not None:
            supporting = Holders({hold.robot: hold.path[-1]}, choice.tools)
        found = self.among(choice.primary, self._kept(plan, step), supporting)
        return self.alone[choice.primary] if isinstance(found, Obstruction) else found

    def planned_hold(self, plan: TaskPlan, step: int) -> SkillPath | None:
        """Return how a part is held in a step, None if none is."""
        support = plan[step].support
        if support is None:
            return None
        found = self.held_among(support, self._kept(plan, step))
        return self.holds[support] if isinstance(found, Obstruction) else found

    def _kept(self, plan: TaskPlan, step: int) -> Holders:
        """Return who keeps hold of what was placed before a step."""
        out = NOBODY
        for k, last in self.keeps.items():
            if k < step <= last:
                at = {plan[k].robot: self.planned(plan, k)[-1].contact}
                out = out.and_also(Holders(at, plan[k].tools))
        return out

    def release(self, place: SkillPath) -> SkillPath:
        """Return the way back of who kept hold of what it placed."""
        assert place.change_at is not None
        rest = place.waypoints[place.change_at :]
        return SkillPath(STRAIGHT, place.robot, rest[:1], rest[1:])

    def blocks_release(self, item: PrimaryCandidate) -> Obstruction | None:
        """Return what is in the way of who lets go once the step is done that it waited for."""
        kept = self.steps[item.step - 1]
        assert isinstance(kept, PartStep)
        last = self.steps[self.keeps[item.step] - 1]
        there = dict(last.around)
        if isinstance(last, PartStep):
            there[last.part.name] = last.part, Attachment(None, last.goal)
        cell, grip = self.skills(item.tools).cell, gripped(item.robot, kept.part.name)
        scene = SkillScene(
            cell,
            there,
            {robot.name: robot.home for robot in cell.robots},
            SkillContacts(grip, grip, NOTHING),
        )
        return find_obstruction(self.release(self.alone[item][-1]), scene)


def pair_kept(paths: StepPaths, found: CandidateCollector) -> None:
    """Find which candidates go together where robots keep hold of what they placed.

    Of every step of that sort the cheapest are taken, some for each robot, that leave others
    candidates to do each step until they may let go, and that lead away then. The rest is dropped.

    Args:
        paths: of all candidates.
        found: with the candidates of all steps.
    """
    # The last ones first: what others go with must be left when it is their turn.
    for step in sorted(paths.keeps, reverse=True):
        own = [p for p, item in enumerate(found.primaries) if item.step == step]
        own.sort(key=lambda p: (found.primaries[p].cost, p))
        enough: Counter[str] = Counter()
        for p in own:
            robot = found.primaries[p].robot
            if enough[robot] < _ENOUGH and _can_keep(paths, p, found):
                enough[robot] += 1
            else:
                found.dropped.add(p)


def _can_keep(paths: StepPaths, p: int, found: CandidateCollector) -> bool:
    """Tell whether others can do what is to be done while a robot keeps hold; note what clashes."""
    item = found.primaries[p]
    grip = paths.grip_of(item).words
    words = f"{item.robot} that keeps hold of {item.object}, {grip}"
    if (wrong := paths.blocks_release(item)) is not None:
        found.reject(item.step, f"{words}, lets go", wrong)
        return False
    holding = Holders({item.robot: paths.alone[item][-1].contact}, item.tools)
    clashing: set[tuple[int, int]] = set()
    incompatible: set[tuple[int, int]] = set()
    for later in range(item.step + 1, paths.keeps[item.step] + 1):
        others = [
            q
            for q in _of_step(found.primaries, later, item.robot)
            if q not in found.dropped
        ]
        good: Counter[str] = Counter()
        wrong = None
        for q in sorted(others, key=lambda q: (found.primaries[q].cost, q)):
            other = found.primaries[q]
            if good[other.robot] == _ENOUGH:
                clashing.add((p, q))
                continue
            way = paths.among(other, holding)
            if isinstance(way, Obstruction):
                clashing.add((p, q))
                wrong = wrong or way
                found.reject(later, f"{other.robot} beside {words}", way)
            else:
                good[other.robot] += 1
        if not good:
            found.reject(item.step, *_nobody(paths, found, item, later, wrong))
            return False
        if paths.steps[later - 1].held is None:
            continue
        beside = 0
        for s in _of_step(found.supports, later, item.robot):
            support = found.supports[s]
            hold = paths.held_among(support, holding)
            if isinstance(hold, Obstruction):
                incompatible.add((p, s))
                wrong = hold
                found.reject(later, f"{support.robot} holds beside {words}", hold)
            else:
                beside += 1
        if not beside:
            found.reject(item.step, *_nobody(paths, found, item, later, wrong))
            return False
    found.clashing |= clashing
    found.incompatible |= incompatible
    return True


def _nobody(
    paths: StepPaths,
    found: CandidateCollector,
    item: PrimaryCandidate,
    later: int,
    wrong: Obstruction | None,
) -> tuple[str, Obstruction]:
    """Return in words that a step cannot be done meanwhile: who keeps hold, and why not.

    Where nothing of who keeps hold is in the way, nobody else can do the step at all: then that is why.
    """
    step = f"step {later} ({paths.steps[later - 1].step.words})"
    words = (
        f"{item.robot} that keeps hold of {item.object}, {paths.grip_of(item).words}"
    )
    if wrong is not None:
        nobody = f"nobody else could do {step} meanwhile: {wrong.words}"
        return words, Obstruction(nobody, wrong.by)
    others = [
        r
        for r in found.rejections
        if r.step == later and not r.what.startswith(item.robot)
    ]
    why = f"nobody else can do {step}"
    if others:
        reason, _ = Counter(r.reason for r in others).most_common(1)[0]
        what = next(r.what for r in others if r.reason == reason)
        why += f" at all: {what}: {reason}"
    return words, Obstruction(why)


def _of_step(
    items: Iterable[PrimaryCandidate | SupportCandidate], step: int, but: str
) -> Iterator[int]:
    """Yield the numbers of the candidates of a step, those of one robot left out."""
    for k, item in enumerate(items):
        if item.step == step and item.robot != but:
            yield k
