"""Ways to do steps beside robots that hold something, or keep hold of what they placed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from planning.cell.workcell import Attachment
from planning.parts.assembly import Grip
from planning.parts.part_skills import PartSkills
from planning.parts.part_steps import KnownStep, MachineStep, PartStep, WorkStep
from planning.parts.relays import Relay
from planning.steps.skill import NOTHING, Obstruction, SkillContacts, SkillPath, gripped
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
"""So many ways of each robot to place a part and keep hold of it are looked for, and so many ways
of another one to do a step meanwhile."""

Way = tuple[int, str, int, Tools]
"""Step, robot, number of a grip or of a turn, and the tools that it takes."""

Blocked = Callable[[int, str, Obstruction], None]
"""Told of a step what was tried, and what was in the way."""


@dataclass(frozen=True)
class Holding:
    """Robots that hold something.

    Attributes:
        at: where they stand, by name, shape (n,) each.
        tools: that they have on them, if they change theirs.
    """

    at: Mapping[str, Array] = field(default_factory=dict)
    tools: Tools = NO_TOOLS

    def and_also(self, other: Holding) -> Holding:
        """Return these and others."""
        return Holding({**self.at, **other.at}, self.tools | other.tools)


NOBODY = Holding()


def way_of(primary: PrimaryCandidate) -> Way:
    """Return by what the paths of a candidate are known."""
    return primary.step, primary.robot, primary.grasp, primary.tools


def hold_way(support: SupportCandidate) -> Way:
    """Return by what the path of a candidate to hold something is known."""
    return support.step, support.robot, support.pose, support.tools


@dataclass(frozen=True)
class WaysBeside:
    """Ways to do steps, found alone, and beside robots that hold something.

    Attributes:
        skills: returns those of robots that have certain tools on them, all others at HOME.
        steps: what is done.
        paths: pick and place, or a process, of every way, beside nobody.
        holds: how a part is held, beside nobody.
        relays: ways in which the part changes hands in between.
        keeps: by step, from 1, whose robot keeps hold of what it placed, the step until which.
    """

    skills: Callable[[Tools], PartSkills]
    steps: Sequence[KnownStep]
    paths: dict[Way, tuple[SkillPath, ...]] = field(default_factory=dict)
    holds: dict[Way, SkillPath] = field(default_factory=dict)
    relays: dict[Way, Relay] = field(default_factory=dict)
    keeps: Mapping[int, int] = field(default_factory=dict)

    def done(
        self,
        way: Way,
        holding: Holding,
        supporting: Holding = NOBODY,
    ) -> tuple[SkillPath, ...] | Obstruction:
        """Return the paths of a way beside robots that hold something, or what is in its way.

        Paths that are free beside them are as they were. How a part gets to where its robot picks
        it last is not looked at.

        Args:
            way: of a step.
            holding: who holds something all the time.
            supporting: who holds something while the part is placed, or the process is done.
        """
        step = self.steps[way[0] - 1]
        if isinstance(step, MachineStep):
            return ()
        known = self.paths[way]
        if not holding.at and not supporting.at:
            return known
        early = self._beside(way, holding)
        skills = self._beside(way, holding.and_also(supporting))
        robot = skills.cell.robot(way[1])
        if isinstance(step, WorkStep):
            turn = step.step.process.turns[way[2]]
            found = [skills.work(robot, step, turn, known[-1])]
        else:
            relay, grip = self.relays.get(way), self.grip_of(way).pose
            found = [skills.place(robot, step, grip, known[-1])]
            if relay is None and holding.at:
                found = [early.pick(robot, step, grip, known[0]), *found]
                blocked = early.carried_home(robot, step, grip)
                found += [] if blocked is None else [blocked]
        wrong = next((item for item in found if isinstance(item, Obstruction)), None)
        if wrong is not None:
            return wrong
        own = [item for item in found if isinstance(item, SkillPath)]
        return (*known[: len(known) - len(own)], *own)

    def held(self, way: Way, holding: Holding) -> SkillPath | Obstruction:
        """Return how a robot holds a part beside others, or what is in its way."""
        step, known = self.steps[way[0] - 1], self.holds[way]
        if not holding.at:
            return known
        assert not isinstance(step, MachineStep)
        assert step.held is not None
        skills, grip = self._beside(way, holding), step.held.grips[way[2]].pose
        return skills.hold(skills.cell.robot(way[1]), step, step.held, grip, known)

    def _beside(self, way: Way, holding: Holding) -> PartSkills:
        return replace(self.skills(way[3] | holding.tools), holding=holding.at)

    def grip_of(self, way: Way) -> Grip:
        """Return the grip with which a part is placed."""
        step, relay = self.steps[way[0] - 1], self.relays.get(way)
        assert isinstance(step, PartStep)
        return step.grips[way[2]] if relay is None else relay.take

    def paths_of(self, plan: TaskPlan, step: int) -> tuple[SkillPath, ...]:
        """Return pick and place of a step, or its process, beside all that is held meanwhile.

        Where nothing is free beside several that hold, the paths are those beside nobody, which
        motion planning finds to be blocked.
        """
        choice = plan[step]
        way, holding, supporting = (
            way_of(choice.primary),
            self._kept(plan, step),
            NOBODY,
        )
        if (hold := self.hold_of(plan, step)) is not None:
            supporting = Holding({hold.robot: hold.path[-1]}, choice.tools)
        found = self.done(way, holding, supporting)
        return self.paths[way] if isinstance(found, Obstruction) else found

    def hold_of(self, plan: TaskPlan, step: int) -> SkillPath | None:
        """Return how a part is held in a step, None if none is."""
        support = plan[step].support
        if support is None:
            return None
        found = self.held(hold_way(support), self._kept(plan, step))
        return (
            self.holds[hold_way(support)] if isinstance(found, Obstruction) else found
        )

    def _kept(self, plan: TaskPlan, step: int) -> Holding:
        """Return who keeps hold of what was placed before a step."""
        out = NOBODY
        for k, last in self.keeps.items():
            if k < step <= last:
                at = {plan[k].robot: self.paths_of(plan, k)[-1].contact}
                out = out.and_also(Holding(at, plan[k].tools))
        return out

    def let_go(self, place: SkillPath) -> SkillPath:
        """Return the way back of who kept hold of what it placed."""
        assert place.change_at is not None
        rest = place.waypoints[place.change_at :]
        return SkillPath(STRAIGHT, place.robot, rest[:1], rest[1:])

    def blocks_letting_go(self, way: Way) -> Obstruction | None:
        """Return what is in the way of who lets go once the step is done that it waited for."""
        kept = self.steps[way[0] - 1]
        assert isinstance(kept, PartStep)
        last = self.steps[self.keeps[way[0]] - 1]
        there = dict(last.around)
        if isinstance(last, PartStep):
            there[last.part.name] = last.part, Attachment(None, last.goal)
        cell, grip = self.skills(way[3]).cell, gripped(way[1], kept.part.name)
        scene = SkillScene(
            cell,
            there,
            {robot.name: robot.home for robot in cell.robots},
            SkillContacts(grip, grip, NOTHING),
        )
        return find_obstruction(self.let_go(self.paths[way][-1]), scene)


@dataclass
class Pairing:
    """Which ways of different steps go together, where one keeps hold of what it placed.

    Attributes:
        primaries, supports: all candidates.
        dropped: numbers of the primaries that are not to be taken.
        clashing: pairs of primaries of different steps that do not go together.
        incompatible: a primary that is kept, and a support of a later step.
    """

    primaries: Sequence[PrimaryCandidate]
    supports: Sequence[SupportCandidate]
    dropped: set[int] = field(default_factory=set)
    clashing: set[tuple[int, int]] = field(default_factory=set)
    incompatible: set[tuple[int, int]] = field(default_factory=set)

    def numbers(self) -> dict[int, int]:
        """Return the new numbers of the primaries that are left, by their old ones."""
        left = (p for p in range(len(self.primaries)) if p not in self.dropped)
        return {p: k for k, p in enumerate(left)}


def pair_kept(
    ways: WaysBeside,
    primaries: Sequence[PrimaryCandidate],
    supports: Sequence[SupportCandidate],
    blocked: Blocked,
) -> Pairing:
    """Return which ways go together where robots keep hold of what they placed.

    Of every step of that sort the cheapest ways are taken, some for each robot, that leave others
    ways to do each step until they may let go, and that lead away then.

    Args:
        ways: all there are.
        primaries, supports: the candidates that they belong to.
        blocked: told what was in the way.
    """
    out = Pairing(primaries, supports)
    # The last ones first: what others go with must be left when it is their turn.
    for step in sorted(ways.keeps, reverse=True):
        own = [p for p, item in enumerate(primaries) if item.step == step]
        own.sort(key=lambda p: (primaries[p].cost, p))
        enough: Counter[str] = Counter()
        for p in own:
            item = primaries[p]
            if enough[item.robot] < _ENOUGH and _goes(ways, p, out, blocked):
                enough[item.robot] += 1
            else:
                out.dropped.add(p)
    return out


def _goes(ways: WaysBeside, p: int, out: Pairing, blocked: Blocked) -> bool:
    """Tell whether others can do what is to be done while a robot keeps hold; note what clashes."""
    item = out.primaries[p]
    way = way_of(item)
    words = f"{item.robot} that keeps hold of {item.object}, {ways.grip_of(way).words}"
    wrong = ways.blocks_letting_go(way)
    if wrong is not None:
        blocked(item.step, f"{words}, lets go", wrong)
        return False
    holding = Holding({item.robot: ways.paths[way][-1].contact}, item.tools)
    clashing: set[tuple[int, int]] = set()
    incompatible: set[tuple[int, int]] = set()
    for later in range(item.step + 1, ways.keeps[item.step] + 1):
        others = [
            q
            for q in _of_step(out.primaries, later, item.robot)
            if q not in out.dropped
        ]
        good: Counter[str] = Counter()
        wrong = None
        for q in sorted(others, key=lambda q: (out.primaries[q].cost, q)):
            other = out.primaries[q]
            if good[other.robot] == _ENOUGH:
                clashing.add((p, q))
                continue
            found = ways.done(way_of(other), holding)
            if isinstance(found, Obstruction):
                clashing.add((p, q))
                wrong = wrong or found
                blocked(later, f"{other.robot} beside {words}", found)
            else:
                good[other.robot] += 1
        if not good:
            blocked(item.step, *_nobody(ways, later, words, wrong))
            return False
        if ways.steps[later - 1].held is None:
            continue
        beside = 0
        for s in _of_step(out.supports, later, item.robot):
            support = out.supports[s]
            found_hold = ways.held(hold_way(support), holding)
            if isinstance(found_hold, Obstruction):
                incompatible.add((p, s))
                wrong = found_hold
                blocked(later, f"{support.robot} holds beside {words}", found_hold)
            else:
                beside += 1
        if not beside:
            blocked(item.step, *_nobody(ways, later, words, wrong))
            return False
    out.clashing |= clashing
    out.incompatible |= incompatible
    return True


def _nobody(
    ways: WaysBeside, later: int, words: str, wrong: Obstruction | None
) -> tuple[str, Obstruction]:
    """Return in words that a step cannot be done meanwhile: who keeps hold, and why not."""
    step = f"step {later} ({ways.steps[later - 1].step.words})"
    why = "" if wrong is None else f" ({wrong.words})"
    return f"{words}{why}", Obstruction(f"nobody else could do {step} meanwhile")


def _of_step(
    items: Iterable[PrimaryCandidate | SupportCandidate], step: int, but: str
) -> Iterator[int]:
    """Yield the numbers of the candidates of a step, those of one robot left out."""
    for k, item in enumerate(items):
        if item.step == step and item.robot != but:
            yield k
