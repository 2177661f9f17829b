"""Assignment as data: candidates for every step, with costs, and the choice of one (APEX-MR IV-A).

Free of any domain: robots and objects are names, grasps and support poses are numbers whose
meaning only the maker of the candidates knows.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

_MOST_REASONS = 12
"""How many reasons for rejections are named."""


@dataclass(frozen=True)
class PrimaryCandidate:
    """One way for a robot to be the primary robot of a step (X_ijkg of Appendix B).

    Attributes:
        step: counted from 1.
        robot: who places the object.
        object: what is placed.
        grasp: number of the grasp.
        cost: C_ijkg, joint-space distance [rad or m, summed over joints].
        partner: robot that must be the support robot of the step, because it hands the object
            over; None when any may. In a step without support it only hands the object over.
        after: objects that stand in the way until an earlier step has used them.
    """

    step: int
    robot: str
    object: str
    grasp: int
    cost: float
    partner: str | None = None
    after: frozenset[str] = frozenset()


@dataclass(frozen=True)
class SupportCandidate:
    """One way for a robot to support a step (Y_ijg of Appendix B).

    Attributes:
        step: counted from 1.
        robot: who supports.
        pose: number of the support pose.
        cost: C^s_ijg, joint-space distance.
    """

    step: int
    robot: str
    pose: int
    cost: float


@dataclass(frozen=True)
class Rejection:
    """Reason for which a candidate was rejected.

    Attributes:
        step: counted from 1.
        what: the candidate in words, such as ``"left places b2_4 with grip 1/1"``.
        reason: such as ``"attach is out of reach"``.
    """

    step: int
    what: str
    reason: str


@dataclass(frozen=True)
class AssignmentProblem:
    """Data of the integer program (1)-(8) of Appendix B; only feasible candidates.

    Attributes:
        robots: the N robots.
        steps: what the steps are, in words; their number is N_a.
        needs_support: delta^s per step.
        primaries: candidates X.
        supports: candidates Y.
        incompatible: pairs (index into primaries, index into supports) of one step that cannot
            go together, such as poses that collide with each other.
        unlimited: objects that stand for an endless supply, exempt from use-once (6).
        balance: load balance; lambda is this times the mean cost of a step at its cheapest. At
            1 a robot that takes two steps in a row instead of sharing them (a spread of 2 in
            one window) pays two steps' worth of motion, which outweighs all but large detours.
            The published code uses 1000 against costs in degrees, about 4 here.
        rejections: what is not a candidate and why; for messages only.
    """

    robots: tuple[str, ...]
    steps: tuple[str, ...]
    needs_support: tuple[bool, ...]
    primaries: tuple[PrimaryCandidate, ...]
    supports: tuple[SupportCandidate, ...] = ()
    incompatible: frozenset[tuple[int, int]] = frozenset()
    unlimited: frozenset[str] = frozenset()
    balance: float = 1.0
    rejections: tuple[Rejection, ...] = field(default=(), repr=False)

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

    @property
    def impossible(self) -> tuple[int, ...]:
        """The steps that no robot can do, or that none can support."""
        return tuple(
            step
            for step, held in enumerate(self.needs_support, start=1)
            if not self.primaries_of.get(step)
            or (held and not self.supports_of.get(step))
        )

    def compatible(self, primary: int, support: int) -> bool:
        """Tell whether a primary and a support candidate of a step are compatible."""
        first, second = self.primaries[primary], self.supports[support]
        if first.step != second.step or first.robot == second.robot:
            return False
        if first.partner is not None and first.partner != second.robot:
            return False
        return (primary, support) not in self.incompatible

    def windows(self) -> list[range]:
        """Return the windows of N consecutive steps (from 1) that (7) and (8) balance."""
        size = len(self.robots)
        last = len(self.steps) - size + 1
        return [range(j, j + size) for j in range(1, last + 1)]


def _by_step(steps: Iterable[int]) -> dict[int, list[int]]:
    """Return the indices of each entry."""
    out: dict[int, list[int]] = defaultdict(list)
    for index, step in enumerate(steps):
        out[step].append(index)
    return dict(out)


def explain_rejections(problem: AssignmentProblem, step: int) -> str:
    """Return the reasons for which candidates of a step were rejected, a line each.

    Args:
        problem: with its rejections.
        step: counted from 1.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for item in problem.rejections:
        if item.step == step:
            groups[item.reason].append(item.what)
    if not groups:
        return "  nothing of the right type is there to try"
    ordered = sorted(groups.items(), key=lambda entry: (-len(entry[1]), entry[0]))
    lines = []
    for reason, whats in ordered[:_MOST_REASONS]:
        shown = ", ".join(whats[:3])
        more = f" and {len(whats) - 3} more" if len(whats) > 3 else ""
        lines.append(f"  {reason}: {shown}{more}")
    if len(ordered) > _MOST_REASONS:
        lines.append(f"  and {len(ordered) - _MOST_REASONS} more reasons")
    return "\n".join(lines)


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
    def object(self) -> str:
        """The object that is placed."""
        return self.primary.object

    @property
    def grasp(self) -> int:
        """Number of the grasp."""
        return self.primary.grasp

    @property
    def cost(self) -> float:
        """Joint-space distance of both robots."""
        return self.primary.cost + (self.support.cost if self.support else 0.0)


@dataclass(frozen=True)
class TaskPlan:
    """Choices for all steps, in order."""

    choices: tuple[StepChoice, ...]

    def __getitem__(self, step: int) -> StepChoice:
        """Return the choice of a step, counted from 1."""
        if not 1 <= step <= len(self.choices):
            raise IndexError(f"no step {step}; steps: 1 to {len(self.choices)}")
        return self.choices[step - 1]

    def with_choice(self, choice: StepChoice) -> TaskPlan:
        """Return a plan in which one step is done another way."""
        at = choice.step - 1
        return replace(
            self, choices=(*self.choices[:at], choice, *self.choices[at + 1 :])
        )


def alternatives(
    problem: AssignmentProblem, plan: TaskPlan, step: int
) -> list[StepChoice]:
    """Return the other ways to do a step that leave all other steps as they are.

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

    return sorted((c for c in found if c != current), key=order)
