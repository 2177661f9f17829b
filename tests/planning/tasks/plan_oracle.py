"""What an assignment must keep to, constraint by constraint, and which task comes before which."""

from collections.abc import Iterable, Sequence

import networkx as nx

from planning.tasks.assignment import AssignmentProblem, TaskPlan
from planning.tasks.task import Task


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


def objective(problem: AssignmentProblem, plan: TaskPlan) -> float:
    """Return (1), step by step: motion, the busiest robot of every window, and changes of tools."""
    total = sum(c.primary.cost for c in plan.choices)
    total += sum(c.support.cost for c in plan.choices if c.support)
    able = {name for item in problem.primaries for name in (item.robot, item.partner)}
    able = (able | {item.robot for item in problem.supports}) - {None}
    count = len(plan.choices)
    windows = [
        plan.choices[start : start + size]
        for size in range(2, len(able) + 1)
        for start in range(count - size + 1)
    ]
    for window in windows:
        busy = [c.robot for c in window] + [
            c.support.robot for c in window if c.support
        ]
        # Who hands an object over works, too, whether or not the step has a support.
        busy += [
            c.primary.partner for c in window if c.primary.partner and not c.support
        ]
        load = [busy.count(robot) for robot in problem.robots]
        size = len(window)
        excess = max(load) - len(busy) / size
        total += problem.balance_weight * 2.0 / (size - 1) * excess
    on_it = dict(problem.mounted)
    for choice in plan.choices:
        for robot, tool in choice.tools:
            if on_it[robot] != tool:
                total += problem.changes[robot, on_it[robot], tool]
                on_it[robot] = tool
    if problem.returns:
        total += sum(
            problem.changes[robot, on_it[robot], tool]
            for robot, tool in problem.mounted.items()
            if on_it[robot] != tool
        )
    return total


def task_order(
    tasks: Sequence[Task], dependencies: Iterable[tuple[int, int]]
) -> "nx.DiGraph[int]":
    """Return tasks by index, after what they wait for and after the one before of their robot."""
    graph = nx.DiGraph([(int(a), int(b)) for a, b in dependencies])
    for robot in {task.robot for task in tasks}:
        nx.add_path(graph, [task.index for task in tasks if task.robot == robot])
    assert nx.is_directed_acyclic_graph(graph)
    assert set(graph) == {task.index for task in tasks}
    return graph
