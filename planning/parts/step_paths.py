"""Paths of assembly steps: computed for a robot alone, and next to other robots that hold parts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import TypeVar

from planning.cell.workcell import Attachment
from planning.grips.grip import Grip
from planning.handling.skill_contacts import NOTHING, SkillContacts, grip_contact
from planning.handling.skill_scene import SkillScene
from planning.handling.skill_trial import find_obstruction
from planning.parts.part_skills import PartSkills, SkillTry
from planning.parts.part_steps import KnownStep, PartStep
from planning.parts.relays import Relay
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, SkillPath
from planning.tasks.assignment import (
    PrimaryCandidate,
    SupportCandidate,
    TaskPlan,
    Tools,
)
from planning.tasks.task import TaskKind
from planning.transforms import Array

_ENOUGH = 4
"""Greatest number of candidates of each robot to place a part and keep holding it, or to do a step
beside another robot that holds something."""

Candidate = PrimaryCandidate | SupportCandidate


Holders = Mapping[str, tuple[Array, Tools]]
"""Robots that hold something: their configurations, shape (n,), and loads, by name."""

_NOBODY: Holders = {}
Item = TypeVar("Item", PrimaryCandidate, SupportCandidate)


@dataclass(frozen=True)
class StepPaths:
    """Paths of the candidates of an assembly, found alone, and next to robots that hold something.

    Attributes:
        skills: returns those of robots that have certain tools on them, all others at HOME.
        steps: what is done.
        keeps: by step, from 1, whose robot keeps holding what it placed, the step until which.
        unpaired: pick and place, a process, or a hold, of every candidate, without holding robots.
        tries: what the last of these paths were found by.
        relays: how the part changes hands in between, of candidates with which it does.
    """

    skills: Callable[[Tools], PartSkills]
    steps: Sequence[KnownStep]
    keeps: Mapping[int, int] = field(default_factory=dict)
    unpaired: dict[Candidate, tuple[SkillPath, ...]] = field(default_factory=dict)
    tries: dict[Candidate, tuple[SkillTry, ...]] = field(default_factory=dict)
    relays: dict[PrimaryCandidate, Relay] = field(default_factory=dict)

    def among(
        self, item: Candidate, holding: Holders, supporting: Holders = _NOBODY
    ) -> tuple[SkillPath, ...] | Obstruction:
        """Return the paths of a candidate next to robots that hold something, or the obstruction.

        Paths that are free next to them are unchanged. The transport of a part to its last pick is not checked.

        Args:
            item: the candidate.
            holding: robots that hold something all the time.
            supporting: robots that hold something during the last of its skills.
        """
        tries, found = self.tries.get(item, ()), list(self.unpaired.get(item, ()))
        for k, tried in enumerate(tries, len(found) - len(tries)):
            last = k == len(found) - 1
            if holders := {**holding, **(supporting if last else _NOBODY)}:
                path = self._beside(tried, item, holders).found(found[k])
                if isinstance(path, Obstruction):
                    return path
                found[k] = path
        if len(tries) > 1 and holding:
            blocked = self._beside(tries[0], item, holding).carried_home()
            if blocked is not None:
                return blocked
        return tuple(found)

    def _beside(self, tried: SkillTry, item: Candidate, holders: Holders) -> SkillTry:
        tools = item.tools.union(*(own for _, own in holders.values()))
        at = {name: q for name, (q, _) in holders.items()}
        return self.skills(tools).with_standing_robots(tried, at)

    def grip_of(self, item: PrimaryCandidate) -> Grip:
        """Return the grip with which a part is placed."""
        step, relay = self.steps[item.step - 1], self.relays.get(item)
        assert isinstance(step, PartStep)
        return step.grips[item.grasp] if relay is None else relay.take.grip

    def planned(self, plan: TaskPlan, step: int) -> tuple[SkillPath, ...]:
        """Return pick and place of a step, or its process, next to all that is held meanwhile.

        Where nothing is free next to several holding robots, the paths are those without them, which motion
        planning finds to be blocked.
        """
        choice, supporting = plan[step], _NOBODY
        if (hold := self.planned_hold(plan, step)) is not None:
            supporting = {hold.robot: (hold.path[-1], choice.tools)}
        found = self.among(choice.primary, self._kept(plan, step), supporting)
        return (
            self.unpaired[choice.primary] if isinstance(found, Obstruction) else found
        )

    def planned_hold(self, plan: TaskPlan, step: int) -> SkillPath | None:
        """Return the hold of a part in a step, None if there is none."""
        support = plan[step].support
        if support is None:
            return None
        found = self.among(support, self._kept(plan, step))
        return (self.unpaired[support] if isinstance(found, Obstruction) else found)[0]

    def _kept(self, plan: TaskPlan, step: int) -> Holders:
        """Return the robots that still hold a part placed before a step."""
        return {
            plan[k].robot: (self.planned(plan, k)[-1].contact, plan[k].tools)
            for k, last in self.keeps.items()
            if k < step <= last
        }

    def release(self, place: SkillPath) -> SkillPath:
        """Return the retreat of the robot that held its placed part."""
        assert place.change_at is not None
        rest = place.waypoints[place.change_at :]
        return SkillPath(TaskKind.STRAIGHT, place.robot, rest[:1], rest[1:])

    def blocks_release(self, item: PrimaryCandidate) -> Obstruction | None:
        """Return the obstruction of a release once the step that it waited for is done."""
        kept = self.steps[item.step - 1]
        assert isinstance(kept, PartStep)
        last = self.steps[self.keeps[item.step] - 1]
        there = dict(last.around)
        if isinstance(last, PartStep):
            there[last.part.name] = last.part, Attachment(None, last.place)
        cell, grip = (
            self.skills(item.tools).cell,
            grip_contact(item.robot, kept.part.name),
        )
        at_home = {robot.name: robot.home for robot in cell.robots}
        contacts = SkillContacts(grip, grip, NOTHING)
        scene = SkillScene(cell, there, at_home, contacts)
        return find_obstruction(self.release(self.unpaired[item][-1]), scene)


@dataclass(frozen=True)
class Pairing:
    """Checks compatibility of candidates where robots hold something.

    Attributes:
        paths: of all candidates.
        found: with the candidates; notes which do not go together, and why.
    """

    paths: StepPaths
    found: CandidateCollector

    def pair_held(self, step: int) -> None:
        """Check the candidates of a step against the holds during it; undecided pairs are incompatible."""
        good: dict[str, Counter[str]] = defaultdict(Counter)
        for s, support in _of_step(self.found.supports, step).items():
            at = self.paths.unpaired[support][0].path[-1]
            bad, _ = self._beside(
                self._cheapest(step, support.robot),
                f"beside {support.robot} that holds",
                (_NOBODY, {support.robot: (at, support.tools)}),
                good[support.robot],
            )
            self.found.incompatible |= {(p, s) for p in bad}

    def pair_kept(self, steps: range) -> None:
        """Check the candidates of steps, from 0, against robots that keep holding placed parts.

        Of every step of that sort the cheapest are taken, some for each robot, that leave others
        candidates to do each step until they may let go, and that lead away then. The rest is
        dropped.
        """
        # The last ones first: what others go with must be left when it is their turn.
        kept = (step for step in self.paths.keeps if step - 1 in steps)
        for step in sorted(kept, reverse=True):
            enough: Counter[str] = Counter()
            for p, item in self._cheapest(step).items():
                if enough[item.robot] < _ENOUGH and self._can_keep(p, item):
                    enough[item.robot] += 1
                else:
                    self.found.dropped.add(p)

    def _can_keep(self, p: int, item: PrimaryCandidate) -> bool:
        """Tell whether others can do the steps while a robot keeps holding; note incompatible candidates."""
        paths, found = self.paths, self.found
        words = f"{item.robot} that keeps hold of {item.object}, {paths.grip_of(item).words}"
        if (wrong := paths.blocks_release(item)) is not None:
            found.reject(item.step, f"{words}, lets go", wrong, item.robot)
            return False
        at = paths.unpaired[item][-1].contact
        holding: tuple[Holders, Holders] = {item.robot: (at, item.tools)}, _NOBODY
        clashing: set[tuple[int, int]] = set()
        incompatible: set[tuple[int, int]] = set()
        for later in range(item.step + 1, paths.keeps[item.step] + 1):
            others = self._cheapest(later, item.robot)
            bad, why = self._beside(others, f"beside {words}", holding, Counter())
            clashing |= {(p, q) for q in bad}
            wrong, able = next(iter(why), None), len(bad) < len(others)
            if able and paths.steps[later - 1].held is not None:
                holds = _of_step(found.supports, later, item.robot)
                said = f"holds beside {words}"
                bad, why = self._beside(holds, said, holding, Counter(), inf)
                incompatible |= {(p, s) for s in bad}
                wrong, able = [wrong, *why][-1], len(bad) < len(holds)
            if not able:
                nobody = self._holding_rejection(item, later, wrong)
                found.reject(item.step, words, nobody, item.robot)
                return False
        found.clashing |= clashing
        found.incompatible |= incompatible
        return True

    def _beside(
        self,
        items: Mapping[int, Candidate],
        words: str,
        holders: tuple[Holders, Holders],
        good: Counter[str],
        most: float = _ENOUGH,
    ) -> tuple[set[int], list[Obstruction]]:
        """Return the candidates that cannot be done next to robots that hold something, and why.

        Args:
            items: candidates by their numbers.
            words: the neighbouring robots, for messages.
            holders: robots that hold something all the time, and at the end.
            good: how many candidates of each robot can be done, counted on.
            most: how many of these are searched; the others count as those that cannot.
        """
        bad, why = set(), []
        for number, item in items.items():
            if good[item.robot] >= most:
                bad.add(number)
                continue
            found = self.paths.among(item, *holders)
            if isinstance(found, Obstruction):
                bad.add(number)
                why.append(found)
                what = f"{item.robot} {words}"
                self.found.reject(item.step, what, found, item.robot)
            else:
                good[item.robot] += 1
        return bad, why

    def _holding_rejection(
        self, kept: PrimaryCandidate, later: int, wrong: Obstruction | None
    ) -> Obstruction:
        """Return the rejection of a step that cannot be done while a robot keeps holding.

        Where nothing of a robot that keeps holding is in the way, no other robot can do the step at all: then
        that is why.
        """
        step = f"step {later} ({self.paths.steps[later - 1].step.words})"
        if wrong is not None:
            nobody = f"no other robot could do {step} meanwhile: {wrong.words}"
            return Obstruction(nobody, wrong.by)
        reasons = Counter[str]()
        whats: dict[str, str] = {}
        for item in self.found.rejections:
            if item.step == later and item.robot != kept.robot:
                reasons[item.reason] += 1
                whats.setdefault(item.reason, item.what)
        why = f"no other robot can do {step}"
        if reasons:
            reason, _ = reasons.most_common(1)[0]
            why += f" at all: {whats[reason]}: {reason}"
        return Obstruction(why)

    def _cheapest(self, step: int, but: str = "") -> dict[int, PrimaryCandidate]:
        """Return the candidates of a step by number, cheapest first, without those of one robot."""
        items = _of_step(self.found.primaries, step, but)
        numbers = sorted(items.keys() - self.found.dropped)
        return {p: items[p] for p in sorted(numbers, key=lambda p: items[p].cost)}


def _of_step(items: Sequence[Item], step: int, but: str = "") -> dict[int, Item]:
    """Return the candidates of a step by number, without those of one robot."""
    return {
        k: item
        for k, item in enumerate(items)
        if item.step == step and item.robot != but
    }
