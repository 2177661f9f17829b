"""The task plan: one choice of robot, object, grasp and support for every step."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planning.tasks.assignment_problem import (
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
)


@dataclass(frozen=True)
class StepChoice:
    """What was chosen for a step.

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
    def support_robot(self) -> str | None:
        """The support robot, if any."""
        return self.support.robot if self.support else None

    @property
    def support_pose(self) -> int | None:
        """Number of the support pose, if any."""
        return self.support.pose if self.support else None

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


def plan_cost(problem: AssignmentProblem, plan: TaskPlan) -> float:
    """Return the objective (1) of Appendix B: motion plus lambda times the imbalance."""
    imbalance = 0
    for window in problem.windows():
        load = dict.fromkeys(problem.robots, 0)
        for step in window:
            choice = plan[step]
            load[choice.robot] += 1
            if choice.support is not None:
                load[choice.support.robot] += 1
        imbalance += max(load.values()) - min(load.values())
    motion = sum(choice.cost for choice in plan.choices)
    return motion + problem.balance_weight * imbalance


def plan_violations(problem: AssignmentProblem, plan: TaskPlan) -> list[str]:
    """Return every constraint (2)-(6) of Appendix B, and every "after", that a plan breaks."""
    out = []
    used: dict[str, int] = {}
    if len(plan.choices) != len(problem.steps):
        out.append(f"{len(plan.choices)} choices for {len(problem.steps)} steps")
    primaries, supports = set(problem.primaries), set(problem.supports)
    incompatible = {
        (problem.primaries[p], problem.supports[s]) for p, s in problem.incompatible
    }
    for number, choice in enumerate(plan.choices, start=1):
        if choice.step != number or choice.primary not in primaries:
            out.append(f"step {number}: not a candidate of this step")
            continue
        support = choice.support
        if (support is not None) != problem.needs_support[number - 1]:
            out.append(f"step {number}: support needed or not, but not as planned")
        if support is not None:
            if support not in supports or support.step != number:
                out.append(f"step {number}: not a support candidate of this step")
            if support.robot == choice.robot:
                out.append(f"step {number}: {choice.robot} would support itself")
            if choice.primary.partner not in (None, support.robot):
                out.append(f"step {number}: {support.robot} is not the partner")
            if (choice.primary, support) in incompatible:
                out.append(f"step {number}: primary and support collide")
        for other in sorted(choice.primary.after):
            if other not in used:
                out.append(f"step {number}: {other} is still in the way")
        if choice.object not in problem.unlimited:
            if choice.object in used:
                out.append(
                    f"step {number}: {choice.object} was used in step "
                    f"{used[choice.object]}"
                )
            used.setdefault(choice.object, number)
    return out


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
