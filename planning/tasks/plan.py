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
