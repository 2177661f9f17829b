"""Messages with the reasons why a step has no candidate, and the names of its obstacles."""

from __future__ import annotations

from collections import Counter, defaultdict

from planning.tasks.assignment import AssignmentProblem, Rejection

_MOST_REASONS = 12
"""Largest number of reasons in a message."""


def explain_rejections(problem: AssignmentProblem, step: int) -> str:
    """Return the reasons why candidates of a step were rejected, one per line.

    Args:
        problem: the assignment problem, with its rejections.
        step: number of the step, from 1.
    """
    ordered = _by_reason(problem, step)
    if not ordered:
        return "  nothing of the right type is there to try"
    lines = []
    for reason, items in ordered[:_MOST_REASONS]:
        excluded = Counter(item.what for item in items)
        shown = ", ".join(
            what if count == 1 else f"{what} ({count} ways)"
            for what, count in list(excluded.items())[:3]
        )
        more = f" and {len(excluded) - 3} more" if len(excluded) > 3 else ""
        lines.append(f"  {reason}: {shown}{more}")
    if len(ordered) > _MOST_REASONS:
        lines.append(f"  and {len(ordered) - _MOST_REASONS} more reasons")
    return "\n".join(lines)


def find_blockers(problem: AssignmentProblem, step: int) -> frozenset[str]:
    """Return the names of the obstacles of a step, for the most frequent reasons."""
    ordered = _by_reason(problem, step)[:_MOST_REASONS]
    return frozenset(item.by for _, items in ordered for item in items if item.by)


def _by_reason(
    problem: AssignmentProblem, step: int
) -> list[tuple[str, list[Rejection]]]:
    """Return the rejections of a step grouped by reason, most frequent first."""
    groups: dict[str, list[Rejection]] = defaultdict(list)
    for item in problem.rejections:
        if item.step == step:
            groups[item.reason].append(item)
    return sorted(groups.items(), key=lambda entry: (-len(entry[1]), entry[0]))
