"""Assignment of robots, objects, grasps and supports to steps with HiGHS: program (1)-(8) of APEX-MR."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import pulp

from planning.errors import InfeasibleStepError
from planning.silence import QuietHighs
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    StepChoice,
    SupportCandidate,
    TaskPlan,
    explain_rejections,
)
from planning.tasks.rolling_horizon import is_large, solve_in_windows

_TIME_LIMIT_S = 60.0
"""Time limit of one solve; the best plan found by then is taken."""


def assign_steps(problem: AssignmentProblem) -> TaskPlan:
    """Return the cheapest plan (1) under (2)-(8): optimal, and the same every time.

    Where very many objects that can be used once compete, it is cheapest window by window of
    steps, see ``rolling_horizon``.

    Raises:
        InfeasibleStepError: a step has no candidate (why each fell out is listed), or the steps
            compete for robots and objects (which do is listed).
    """
    _require_candidates(problem)
    windows = is_large(problem) and not problem.kept
    plan = solve_in_windows(problem, _solved) if windows else None
    plan = plan or _solved(problem)
    if plan is None:
        raise _competition(problem)
    return plan


def _solved(problem: AssignmentProblem) -> TaskPlan | None:
    """Return the cheapest plan, None where there is none."""
    program = _Program(problem, elastic=False)
    return program.plan() if program.solve() else None


def _require_candidates(problem: AssignmentProblem) -> None:
    """Raise for the first step that nobody can do, whatever the other steps do."""
    for step, words in enumerate(problem.steps, start=1):
        primaries = problem.primaries_of.get(step, [])
        lacking = None
        supports = problem.supports_of.get(step, [])
        needs = problem.needs_support[step - 1]
        if needs and not supports:
            lacking = "no robot can support it"
        elif not primaries:
            lacking = "no robot, object and grasp can do it"
        elif needs and not any(
            problem.compatible(p, s) for p in primaries for s in supports
        ):
            lacking = "no primary robot and support robot can do it together"
        if lacking:
            raise InfeasibleStepError(
                f"step {step} ({words}): {lacking}\n{explain_rejections(problem, step)}"
            )


class _Program:
    """The integer program; elastic means that steps may be left out at a cost of 1 each."""

    def __init__(self, problem: AssignmentProblem, *, elastic: bool) -> None:
        self.problem = problem
        self.model = pulp.LpProblem("assignment", pulp.LpMinimize)
        self.x = {
            index: self.model.add_variable(f"x{index}", cat="Binary")
            for index in _undominated(problem)
        }
        self.y = {
            index: self.model.add_variable(f"y{index}", cat="Binary")
            for index in range(len(problem.supports))
        }
        self.left_out: dict[int, Any] = {}
        steps = range(1, len(problem.steps) + 1)
        if elastic:
            self.left_out = {
                s: self.model.add_variable(f"u{s}", cat="Binary") for s in steps
            }
            self.model += pulp.lpSum(self.left_out.values())
        else:
            self.model += (
                self._motion()
                + problem.balance_weight * self._imbalance()
                + self._changes()
            )
        self.x_of: dict[int, list[int]] = defaultdict(list)
        for index in self.x:
            self.x_of[problem.primaries[index].step].append(index)
        for step in steps:
            self._constrain_step(step)
        self._constrain_objects()
        self._constrain_kept()

    def _motion(self) -> Any:
        terms = [(var, self.problem.primaries[p].cost) for p, var in self.x.items()]
        terms += [(var, self.problem.supports[s].cost) for s, var in self.y.items()]
        return pulp.LpAffineExpression(terms)

    def _imbalance(self) -> Any:
        """Return the sum of Z^M - Z^m, with constraints (7) and (8)."""
        problem = self.problem
        work: dict[tuple[str, int], list[Any]] = defaultdict(list)
        for p, var in self.x.items():
            item = problem.primaries[p]
            work[item.robot, item.step].append(var)
            if item.partner is not None and not problem.needs_support[item.step - 1]:
                work[item.partner, item.step].append(var)
        for s, var in self.y.items():
            work[problem.supports[s].robot, problem.supports[s].step].append(var)
        spread = []
        for window in problem.windows():
            most = self.model.add_variable(f"most{window.start}", 0, len(window))
            least = self.model.add_variable(f"least{window.start}", 0, len(window))
            spread.append(most - least)
            for robot in problem.robots:
                load = pulp.lpSum(v for step in window for v in work[robot, step])
                self.model += most >= load
                self.model += least <= load
        return pulp.lpSum(spread)

    def _changes(self) -> Any:
        """Return what changes of tools cost; a step is done with its tools on the robots."""
        problem = self.problem
        tools: dict[str, set[str]] = defaultdict(set)
        for robot, old, new in problem.changes:
            tools[robot] |= {old, new}
        on_it: dict[tuple[str, str, int], Any] = {}
        terms: list[tuple[Any, float]] = []
        for robot, names in tools.items():
            own = sorted(names)
            for tool in own:
                on_it[robot, tool, 0] = int(problem.mounted[robot] == tool)
            for step in range(1, len(problem.steps) + 1):
                at = f"tool{len(on_it)}"
                now = [
                    self.model.add_variable(f"{at}_{k}", cat="Binary")
                    for k in range(len(own))
                ]
                on_it |= {
                    (robot, tool, step): var for tool, var in zip(own, now, strict=True)
                }
                self.model += pulp.lpSum(now) == 1
        for (robot, old, new), cost in problem.changes.items():
            for step in range(1, len(problem.steps) + 1):
                name = f"change{len(terms)}"
                changed = self.model.add_variable(name, 0, 1)
                before, after = on_it[robot, old, step - 1], on_it[robot, new, step]
                self.model += changed >= before + after - 1
                terms.append((changed, cost))
        items: list[tuple[PrimaryCandidate | SupportCandidate, Any]] = [
            (problem.primaries[p], var) for p, var in self.x.items()
        ]
        items += [(problem.supports[s], var) for s, var in self.y.items()]
        for item, var in items:
            for robot, tool in sorted(item.tools):
                self.model += var <= on_it[robot, tool, item.step]
        return pulp.LpAffineExpression(terms)

    def _constrain_step(self, step: int) -> None:
        problem = self.problem
        done = 1 - self.left_out[step] if self.left_out else 1
        primaries = self.x_of[step]
        supports = problem.supports_of.get(step, [])
        # (2), and (5): only objects of the right type are candidates.
        self.model += pulp.lpSum(self.x[p] for p in primaries) == done
        if not problem.needs_support[step - 1]:
            for s in supports:
                self.model += self.y[s] == 0
            return
        self.model += pulp.lpSum(self.y[s] for s in supports) == done  # (3)
        by_robot: dict[str, list[Any]] = defaultdict(list)
        by_partner: dict[str, list[Any]] = defaultdict(list)
        supported: dict[str, list[Any]] = defaultdict(list)
        for p in primaries:
            item = problem.primaries[p]
            by_robot[item.robot].append(self.x[p])
            if item.partner is not None:
                by_partner[item.partner].append(self.x[p])
        for s in supports:
            supported[problem.supports[s].robot].append(self.y[s])
        for robot, terms in by_robot.items():  # (4)
            self.model += pulp.lpSum(terms) + pulp.lpSum(supported[robot]) <= 1
        for robot, terms in by_partner.items():
            self.model += pulp.lpSum(terms) <= pulp.lpSum(supported[robot])
        for s in supports:
            clashing = [self.x[p] for p in primaries if (p, s) in problem.incompatible]
            if clashing:
                self.model += pulp.lpSum(clashing) + self.y[s] <= 1

    def _constrain_objects(self) -> None:
        problem = self.problem
        uses: dict[str, list[tuple[int, Any]]] = defaultdict(list)
        blocked: dict[tuple[int, str], list[Any]] = defaultdict(list)
        for p, var in self.x.items():
            item = problem.primaries[p]
            if item.object not in problem.unlimited:
                uses[item.object].append((item.step, var))
            for other in item.after:
                blocked[item.step, other].append(var)
        for terms in uses.values():  # (6)
            self.model += pulp.lpSum(var for _, var in terms) <= 1
        for (step, other), terms_blocked in blocked.items():
            earlier = pulp.lpSum(var for at, var in uses[other] if at < step)
            self.model += pulp.lpSum(terms_blocked) <= earlier

    def _constrain_kept(self) -> None:
        """Let who keeps hold of what it placed do nothing else, and nothing be in its way."""
        problem = self.problem
        for step, last in problem.kept.items():
            for later in range(step + 1, last + 1):
                alone = not problem.needs_support[later - 1]
                held = problem.supports_of.get(later, [])
                for robot in problem.robots:
                    busy = [
                        self.x[p]
                        for p in (*self.x_of[step], *self.x_of[later])
                        if (item := problem.primaries[p]).robot == robot
                        or (item.partner == robot and item.step == later and alone)
                    ]
                    busy += [
                        self.y[s] for s in held if problem.supports[s].robot == robot
                    ]
                    self.model += pulp.lpSum(busy) <= 1
                for p in self.x_of[step]:
                    bad = [
                        self.x[q]
                        for q in self.x_of[later]
                        if (p, q) in problem.clashing
                    ]
                    self.model += pulp.lpSum(bad) + self.x[p] <= 1
                    bad = [self.y[s] for s in held if (p, s) in problem.incompatible]
                    self.model += pulp.lpSum(bad) + self.x[p] <= 1

    def solve(self) -> bool:
        """Solve; return whether there is a solution."""
        self.model.solve(QuietHighs(timeLimit=_TIME_LIMIT_S, gapRel=0.0))
        return bool(self.model.sol_status in (1, 2))

    def plan(self) -> TaskPlan:
        """Return the choices of the solution."""
        taken = [self.problem.primaries[p] for p in _chosen(self.x)]
        supports = {
            item.step: item
            for item in (self.problem.supports[s] for s in _chosen(self.y))
        }
        taken.sort(key=lambda item: item.step)
        return TaskPlan(
            tuple(StepChoice(item, supports.get(item.step)) for item in taken)
        )


def _chosen(variables: Mapping[int, Any]) -> list[int]:
    return [index for index, var in variables.items() if var.value() > 0.5]


def _undominated(problem: AssignmentProblem) -> list[int]:
    """Return the primary candidates that no cheaper one can replace in every plan."""
    clashes: dict[int, set[int]] = defaultdict(set)
    for p, s in problem.incompatible:
        clashes[p].add(s)
    rivals: dict[int, set[int]] = defaultdict(set)
    for p, q in problem.clashing:
        rivals[p].add(q)
        rivals[q].add(p)
    best: dict[tuple[object, ...], int] = {}
    for index, item in enumerate(problem.primaries):
        key = (
            item.step,
            item.robot,
            item.object,
            item.partner,
            item.after,
            item.tools,
            frozenset(clashes.get(index, ())),
            frozenset(rivals.get(index, ())),
        )
        known = best.get(key)
        if known is None or item.cost < problem.primaries[known].cost:
            best[key] = index
    return sorted(best.values())


def _competition(problem: AssignmentProblem) -> InfeasibleStepError:
    """Return the error that names the fewest steps to give up, and whom they compete with."""
    program = _Program(problem, elastic=True)
    if not program.solve():
        return InfeasibleStepError("no assignment was found within the time limit")
    lacking = _chosen(program.left_out)
    taken: dict[str, list[int]] = defaultdict(list)
    for choice in program.plan().choices:
        taken[choice.object].append(choice.step)
    lines = []
    for step in lacking:
        objects = sorted(
            {problem.primaries[p].object for p in problem.primaries_of[step]}
        )
        rivals = [
            f"{name} by step {', '.join(map(str, taken[name]))}"
            for name in objects
            if taken[name]
        ]
        free = [name for name in objects if not taken[name]]
        text = f"  step {step} ({problem.steps[step - 1]}) can use {', '.join(objects)}"
        if rivals:
            text += f"; taken: {', '.join(rivals)}"
        if free:
            blockers = sorted(
                {
                    other
                    for p in problem.primaries_of[step]
                    for other in problem.primaries[p].after
                    if problem.primaries[p].object in free
                }
            )
            if blockers:
                text += f"; {', '.join(free)} is blocked by {', '.join(blockers)}"
        for kept, last in problem.kept.items():
            if kept <= step <= last:
                text += (
                    f"; step {kept} ({problem.steps[kept - 1]}) is kept hold of until step {last}"
                    f" ({problem.steps[last - 1]}), and whoever does that can do nothing else: join"
                    " it earlier, or let another robot do these steps"
                )
        lines.append(text)
    names = ", ".join(map(str, lacking))
    word = "step" if len(lacking) == 1 else "steps"
    return InfeasibleStepError(
        f"{word} {names} cannot be done along with the others\n" + "\n".join(lines)
    )
