"""Assignment problems and task plans as data: candidates with costs, and the choices (APEX-MR IV-A).

The data do not depend on the application. Robots, objects and tools are names. Grasps and support poses are
numbers that only the code that creates the candidates interprets.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

Tools = frozenset[tuple[str, str]]
"""Pairs of a robot and the name of the tool that it must have mounted."""

NO_TOOLS: Tools = frozenset()


@dataclass(frozen=True)
class PrimaryCandidate:
    """Alternative for the primary robot of a step (X_ijkg of Appendix B).

    Attributes:
        step: counted from 1.
        robot: the placing robot.
        object: what is placed.
        grasp: number of the grasp.
        cost: C_ijkg, joint-space distance [rad or m, summed over joints].
        partner: robot that must be the support robot of the step, because it hands the object
            over; None when any may. In a step without support it only hands the object over.
        after: objects that block it until an earlier step has used them.
        tools: that robots which change theirs must have on them.
    """

    step: int
    robot: str
    object: str
    grasp: int
    cost: float
    partner: str | None = None
    after: frozenset[str] = frozenset()
    tools: Tools = NO_TOOLS


@dataclass(frozen=True)
class SupportCandidate:
    """Alternative for the supporting robot of a step (Y_ijg of Appendix B).

    Attributes:
        step: counted from 1.
        robot: the supporting robot.
        pose: number of the support pose.
        cost: C^s_ijg, joint-space distance.
        tools: tools that must be mounted, if the robot changes tools.
    """

    step: int
    robot: str
    pose: int
    cost: float
    tools: Tools = NO_TOOLS


@dataclass(frozen=True)
class Rejection:
    """Reason for which a candidate was rejected.

    Attributes:
        step: counted from 1.
        what: the candidate in words, such as ``"left places b2_4 with grip 1/1"``.
        reason: such as ``"attach is out of reach"``.
        robot: the robot of the candidate, None for no particular one.
        by: name of the obstacle, None if that is not the cause.
    """

    step: int
    what: str
    reason: str
    robot: str | None = None
    by: str | None = None


@dataclass(frozen=True)
class AssignmentProblem:
    """Data of the integer program (1)-(8) of Appendix B; only feasible candidates.

    Attributes:
        robots: the N robots.
        steps: what the steps are, in words; their number is N_a.
        needs_support: delta^s per step.
        primaries: candidates X.
        supports: candidates Y.
        incompatible: pairs (index into primaries, index into supports) that cannot go together,
            such as poses that collide with each other: of one step, or of a step that is kept
            and a later one.
        unlimited: objects that represent an endless supply, exempt from use-once (6).
        balance: load balance; lambda is this times the mean cost of a step at its cheapest. At
            1 a robot that takes two steps in a row instead of sharing them (a spread of 2 in
            one window) pays two steps' worth of motion, which outweighs all but large detours.
            The published code uses 1000 against costs in degrees, about 4 here.
        mounted: tools that robots which change theirs have on them before the first step.
        changes: what it costs to change a tool, by robot, tool before and tool after; empty where
            nobody does.
        returns: whether robots have the tools of the start again after the last step.
        rejections: what is not a candidate and why; for messages only.
        kept: by step whose robot keeps holding what it placed the step until which it does, so
            that it can do no other one.
        clashing: pairs of indices into primaries of different steps that cannot go together.
    """

    robots: tuple[str, ...]
    steps: tuple[str, ...]
    needs_support: tuple[bool, ...]
    primaries: tuple[PrimaryCandidate, ...]
    supports: tuple[SupportCandidate, ...] = ()
    incompatible: frozenset[tuple[int, int]] = frozenset()
    unlimited: frozenset[str] = frozenset()
    balance: float = 1.0
    mounted: Mapping[str, str] = field(default_factory=dict)
    changes: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    returns: bool = False
    rejections: tuple[Rejection, ...] = field(default=(), repr=False)
    kept: Mapping[int, int] = field(default_factory=dict)
    clashing: frozenset[tuple[int, int]] = frozenset()

    @cached_property
    def balance_weight(self) -> float:
        """Lambda of (1), in the unit of the costs."""
        total = 0.0
        for items, of_step in (
            (self.primaries, self.primaries_of),
            (self.supports, self.supports_of),
        ):
            total += sum(
                min(items[k].cost for k in found) for found in of_step.values()
            )
        return self.balance * total / max(1, len(self.steps))

    @cached_property
    def primaries_of(self) -> dict[int, list[int]]:
        """Indices of the primary candidates of each step."""
        return _by_step(item.step for item in self.primaries)

    @cached_property
    def supports_of(self) -> dict[int, list[int]]:
        """Indices of the support candidates of each step."""
        return _by_step(item.step for item in self.supports)

    def among(self, crew: Collection[str]) -> AssignmentProblem:
        """Return the problem restricted to some robots.

        Args:
            crew: their names.
        """
        left = self.of_candidates(
            lambda item: item.robot in crew and item.partner in (None, *crew),
            lambda item: item.robot in crew,
        )
        return replace(
            left,
            robots=tuple(robot for robot in self.robots if robot in crew),
            changes={key: cost for key, cost in self.changes.items() if key[0] in crew},
        )

    def of_first(self, count: int) -> AssignmentProblem:
        """Return the problem of a number of first steps."""
        left = self.of_candidates(
            lambda item: item.step <= count, lambda item: item.step <= count
        )
        return replace(
            left,
            steps=self.steps[:count],
            needs_support=self.needs_support[:count],
            kept={k: until for k, until in self.kept.items() if k <= count},
        )

    def of_candidates(
        self,
        primary: Callable[[PrimaryCandidate], bool],
        support: Callable[[SupportCandidate], bool],
    ) -> AssignmentProblem:
        """Return the problem with some of its candidates.

        Args:
            primary, support: tell which are left.
        """
        primaries = [k for k, item in enumerate(self.primaries) if primary(item)]
        supports = [k for k, item in enumerate(self.supports) if support(item)]
        first = {old: new for new, old in enumerate(primaries)}
        second = {old: new for new, old in enumerate(supports)}
        return replace(
            self,
            primaries=tuple(self.primaries[k] for k in primaries),
            supports=tuple(self.supports[k] for k in supports),
            incompatible=_renumbered(self.incompatible, first, second),
            clashing=_renumbered(self.clashing, first, first),
        )

    def lacking(self, step: int) -> str | None:
        """Return in words which robot is missing for a step, whatever the other choices; None for none."""
        primaries, supports = self.primaries_of.get(step), self.supports_of.get(step)
        needs = self.needs_support[step - 1]
        if needs and not supports:
            return "no robot can support it"
        if not primaries:
            return "no robot, object and grasp can do it"
        pairs = product(primaries, supports or ())
        if needs and not any(self.compatible(*pair) for pair in pairs):
            return "no primary robot and support robot can do it together"
        return None

    @property
    def impossible(self) -> tuple[int, ...]:
        """The steps that no robot can do, or none compatible with a support."""
        steps = range(1, len(self.steps) + 1)
        return tuple(step for step in steps if self.lacking(step) is not None)

    def compatible(self, primary: int, support: int) -> bool:
        """Tell whether a primary and a support candidate of a step are compatible."""
        first, second = self.primaries[primary], self.supports[support]
        if first.step != second.step or first.robot == second.robot:
            return False
        if first.partner is not None and first.partner != second.robot:
            return False
        return (primary, support) not in self.incompatible

    def fits(self, choice: StepChoice, others: Sequence[StepChoice]) -> bool:
        """Tell whether a choice is compatible with the held parts of other steps."""
        for other in others:
            first, then = sorted((choice, other), key=lambda c: c.step)
            if not first.step < then.step <= self.kept.get(first.step, 0):
                continue
            if first.robot in then.robots:
                return False
            p, q = (self._number.get(c.primary, -1) for c in (first, then))
            if (p, q) in self.clashing:
                return False
            s = -1 if then.support is None else self.supports.index(then.support)
            if (p, s) in self.incompatible:
                return False
        return True

    @cached_property
    def _number(self) -> dict[PrimaryCandidate, int]:
        return {item: k for k, item in enumerate(self.primaries)}

    @cached_property
    def capable_robots(self) -> tuple[str, ...]:
        """The robots that can do anything at all: work is balanced among these."""
        named = {item.robot for item in self.primaries}
        named |= {item.robot for item in self.supports}
        named |= {item.partner for item in self.primaries if item.partner is not None}
        return tuple(robot for robot in self.robots if robot in named)

    def windows(self) -> list[tuple[range, float]]:
        """Return the windows of consecutive steps (from 1) to balance, each with its weight.

        A window adds its weight times lambda for every task that its busiest robot does above an
        even share, among as many robots as the window has steps. Windows are of 2 to N steps, and
        weighted so that one robot that does all steps of one costs two lambda, however long it is.
        With two robots that is (7) and (8): Z^M - Z^m is twice what Z^M is above the half.

        With more robots (8) would ask that nobody has less to do than the others. A robot that can
        do little then makes it all the same to (8) whether the others take turns: any three steps
        that two robots share have a spread of two.
        """
        steps = len(self.steps)
        return [
            (range(j, j + size), 2.0 / (size - 1))
            for size in range(2, len(self.capable_robots) + 1)
            for j in range(1, steps - size + 2)
        ]


def _renumbered(
    pairs: frozenset[tuple[int, int]], first: dict[int, int], second: dict[int, int]
) -> frozenset[tuple[int, int]]:
    """Return the pairs whose two members remain, with their new numbers."""
    return frozenset(
        (first[a], second[b]) for a, b in pairs if a in first and b in second
    )


def _by_step(steps: Iterable[int]) -> dict[int, list[int]]:
    """Return the indices of each entry."""
    out: dict[int, list[int]] = defaultdict(list)
    for index, step in enumerate(steps):
        out[step].append(index)
    return dict(out)


@dataclass(frozen=True)
class StepChoice:
    """Choice for a step: robot, object, grasp and support.

    Attributes:
        primary: the primary candidate.
        support: the support candidate, None where no support is needed.
    """

    primary: PrimaryCandidate
    support: SupportCandidate | None = None

    @property
    def step(self) -> int:
        """The step, counted from 1."""
        return self.primary.step

    @property
    def robot(self) -> str:
        """The primary robot."""
        return self.primary.robot

    @property
    def robots(self) -> frozenset[str]:
        """All robots that take part."""
        support = None if self.support is None else self.support.robot
        names = (self.robot, self.primary.partner, support)
        return frozenset(name for name in names if name is not None)

    @property
    def object(self) -> str:
        """The object that is placed."""
        return self.primary.object

    @property
    def grasp(self) -> int:
        """Number of the grasp."""
        return self.primary.grasp

    @property
    def tools(self) -> Tools:
        """Tools that must be mounted on robots that change tools."""
        return self.primary.tools | (self.support.tools if self.support else NO_TOOLS)

    @property
    def cost(self) -> float:
        """Joint-space distance of both robots."""
        return self.primary.cost + (self.support.cost if self.support else 0.0)


@dataclass(frozen=True)
class TaskPlan:
    """Choices for all steps, in order.

    Attributes:
        choices: one per step.
        taken: objects taken by steps so far, by number.
        present: names of the objects that have come up by now.
        tools: tools on the robots where the rest of an assembly begins, None for a bare flange.
        left: steps of that rest; of those that are not begun the robots begin with ``tools``. None for a whole assembly.
    """

    choices: tuple[StepChoice, ...]
    taken: Mapping[int, str] = field(default_factory=dict, hash=False)
    present: frozenset[str] = frozenset()
    tools: Mapping[str, str | None] = field(default_factory=dict, hash=False)
    left: frozenset[int] | None = None

    def __getitem__(self, step: int) -> StepChoice:
        """Return the choice of a step, counted from 1."""
        if not 1 <= step <= len(self.choices):
            raise IndexError(f"no step {step}; steps: 1 to {len(self.choices)}")
        return self.choices[step - 1]

    def tools_before(self, step: int) -> dict[str, str | None]:
        """Return the tools that robots have had put on before a step, by robot, None for a bare flange.

        A step that is done again comes after later ones that are done: what these have put on is on.
        """
        found = dict(self.tools)
        for choice in self.choices[: step - 1]:
            if self.left is None or choice.step in self.left:
                found |= dict(choice.tools)
        return found

    def with_choice(self, choice: StepChoice) -> TaskPlan:
        """Return a plan with another choice for one step."""
        at = choice.step - 1
        return replace(
            self, choices=(*self.choices[:at], choice, *self.choices[at + 1 :])
        )


def step_choices(problem: AssignmentProblem) -> Iterator[StepChoice]:
    """Yield the choices of all steps, in the order of the steps."""
    for step in range(1, len(problem.steps) + 1):
        for p in problem.primaries_of.get(step, []):
            if not problem.needs_support[step - 1]:
                yield StepChoice(problem.primaries[p])
                continue
            for s in problem.supports_of.get(step, []):
                if problem.compatible(p, s):
                    yield StepChoice(problem.primaries[p], problem.supports[s])


def alternative_choices(
    problem: AssignmentProblem, plan: TaskPlan, step: int
) -> list[StepChoice]:
    """Return the alternatives for a step that leave all other steps unchanged.

    Used when motion planning fails. Other poses (robot, grasp, support) come before other
    objects with the same poses, as it is mostly the pose that cannot be reached; cheapest
    first within both.

    Args:
        problem: what was solved.
        plan: its solution.
        step: counted from 1.
    """
    current = plan[step]
    others = [c for c in plan.choices if c.step != step]
    taken = {c.object for c in others} - problem.unlimited
    used_before = {c.object for c in others if c.step < step} - problem.unlimited
    later = {name for c in others if c.step > step for name in c.primary.after}
    must_use = later - {c.object for c in others}
    found: list[StepChoice] = []
    for p in problem.primaries_of.get(step, []):
        primary = problem.primaries[p]
        if primary.object in taken or not primary.after <= used_before:
            continue
        if not must_use <= {primary.object}:
            continue
        if not problem.needs_support[step - 1]:
            found.append(StepChoice(primary))
            continue
        found += [
            StepChoice(primary, problem.supports[s])
            for s in problem.supports_of.get(step, [])
            if problem.compatible(p, s)
        ]

    def order(choice: StepChoice) -> tuple[bool, float]:
        same_poses = (
            choice.robot == current.robot
            and choice.grasp == current.grasp
            and choice.support == current.support
        )
        return same_poses, choice.cost

    found = [c for c in found if c != current and problem.fits(c, others)]
    return sorted(found, key=order)
