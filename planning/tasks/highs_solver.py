"""Assignment of robots, objects, grasps and supports to steps with HiGHS: program (1)-(8) of APEX-MR, App. B."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import pulp
from highspy import HighsModelStatus

from planning.errors import InfeasibleStepError
from planning.silence import QuietHighs
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    StepChoice,
    SupportCandidate,
    TaskPlan,
)
from planning.tasks.rejections import explain_rejections, find_blockers
from planning.tasks.rolling_horizon import needs_rolling_horizon, solve_in_windows

_TIME_LIMIT_S = 60.0
"""Time limit of one solve; the best plan found so far is used."""


def assign_steps(problem: AssignmentProblem) -> TaskPlan:
    """Return the cheapest plan (1) under (2)-(8): optimal and deterministic.

    Where very many objects that can be used once compete, it is cheapest window by window of
    steps, see ``rolling_horizon``.

    Raises:
        InfeasibleStepError: a step has no candidate (why each fell out is listed), or the steps
            compete for robots and objects (which do is listed).
    """
    check_candidates(problem)
    windows = needs_rolling_horizon(problem) and not problem.kept
    plan = solve_in_windows(problem, _solved) if windows else None
    plan = plan or _solved(problem)
    if plan is None:
        raise _competition(problem)
    return plan


def check_candidates(problem: AssignmentProblem) -> None:
    """Check that every step has a candidate.

    Raises:
        InfeasibleStepError: a step has no candidate; why each fell out is listed.
    """
    for step, words in enumerate(problem.steps, start=1):
        if (lacking := problem.lacking(step)) is not None:
            raise InfeasibleStepError(
                f"step {step} ({words}): {lacking}\n{explain_rejections(problem, step)}",
                steps=[step],
                blocked_by=find_blockers(problem, step),
            )


def _solved(problem: AssignmentProblem) -> TaskPlan | None:
    """Return the cheapest plan, None where there is none."""
    program = _Program(problem, elastic=False)
    return program.plan() if program.solve() else None


class _Program:
    """The integer program; in elastic mode steps may be left out at a cost of 1 each."""

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
        self.x_of: dict[int, list[int]] = defaultdict(list)
        self.busy: dict[tuple[str, int], list[Any]] = defaultdict(list)
        for p, var in self.x.items():
            item = problem.primaries[p]
            self.x_of[item.step].append(p)
            self.busy[item.robot, item.step].append(var)
            if item.partner is not None and not problem.needs_support[item.step - 1]:
                self.busy[item.partner, item.step].append(var)
        for s, var in self.y.items():
            self.busy[problem.supports[s].robot, problem.supports[s].step].append(var)
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
        for step in steps:
            self._constrain_step(step)
        self._constrain_objects()
        self._constrain_kept()

    def _motion(self) -> Any:
        terms = [(var, item.cost) for item, var in self._candidates()]
        return pulp.LpAffineExpression(terms)

    def _imbalance(self) -> Any:
        """Return the terms of windows, see ``AssignmentProblem.windows``; of two robots by (7) and (8).

        That somebody does an even share or more is implied, but not known to the relaxed program.
        """
        problem = self.problem
        pair = len(problem.capable_robots) == 2
        terms: list[Any] = []
        for k, (window, weight) in enumerate(problem.windows(), start=1):
            tasks = len(window) + sum(problem.needs_support[j - 1] for j in window)
            even = 0 if pair else -(-tasks // len(problem.capable_robots))
            most = self.model.add_variable(f"most{k}", even, len(window))
            terms.append(most if pair else weight * most)
            if pair:
                least = self.model.add_variable(f"least{k}", 0, len(window))
                terms.append(-least)
            for robot in problem.capable_robots:
                load = pulp.lpSum(v for step in window for v in self.busy[robot, step])
                self.model += most >= load
                if pair:
                    self.model += least <= load
                else:
                    terms.append(-weight / len(window) * load)
        return pulp.lpSum(terms)

    def _changes(self) -> Any:
        """Return the cost of tool changes; a step requires its tools to be mounted."""
        problem, last = self.problem, len(self.problem.steps)
        steps, ends = range(1, last + 1), range(1, last + 1 + problem.returns)
        tools: dict[str, set[str]] = defaultdict(set)
        for robot, old, new in problem.changes:
            tools[robot] |= {old, new}
        on_it: dict[tuple[str, str, int], Any] = {}
        terms: list[tuple[Any, float]] = []
        for robot, names in tools.items():
            for tool in sorted(names):
                at_first = int(problem.mounted[robot] == tool)
                on_it[robot, tool, 0] = on_it[robot, tool, last + 1] = at_first
            for step in steps:
                at, now = f"tool{len(on_it)}", []
                for k, tool in enumerate(sorted(names)):
                    now.append(self.model.add_variable(f"{at}_{k}", cat="Binary"))
                    on_it[robot, tool, step] = now[-1]
                self.model += pulp.lpSum(now) == 1
        for (robot, old, new), cost in problem.changes.items():
            for step in ends:
                name = f"change{len(terms)}"
                changed = self.model.add_variable(name, 0, 1)
                before, after = on_it[robot, old, step - 1], on_it[robot, new, step]
                self.model += changed >= before + after - 1
                terms.append((changed, cost))
        for item, var in self._candidates():
            for robot, tool in sorted(item.tools):
                self.model += var <= on_it[robot, tool, item.step]
        return pulp.LpAffineExpression(terms)

    def _candidates(self) -> Iterator[tuple[PrimaryCandidate | SupportCandidate, Any]]:
        """Yield the candidates with their variables."""
        yield from ((self.problem.primaries[p], var) for p, var in self.x.items())
        yield from ((self.problem.supports[s], var) for s, var in self.y.items())

    def _constrain_step(self, step: int) -> None:
        problem = self.problem
        done = 1 - self.left_out[step] if self.left_out else 1
        candidates = {p: problem.primaries[p] for p in self.x_of[step]}
        helps = {s: problem.supports[s] for s in problem.supports_of.get(step, [])}
        # (2), and (5): only objects of the right type are candidates.
        self.model += pulp.lpSum(self.x[p] for p in candidates) == done
        if not problem.needs_support[step - 1]:
            for s in helps:
                self.model += self.y[s] == 0
            return
        self.model += pulp.lpSum(self.y[s] for s in helps) == done  # (3)

        def supporting(robot: str) -> Any:
            return pulp.lpSum(
                self.y[s] for s, item in helps.items() if item.robot == robot
            )

        for robot in dict.fromkeys(item.robot for item in candidates.values()):  # (4)
            own = pulp.lpSum(
                self.x[p] for p, item in candidates.items() if item.robot == robot
            )
            self.model += own + supporting(robot) <= 1
        for partner in dict.fromkeys(item.partner for item in candidates.values()):
            if partner is not None:
                own = pulp.lpSum(
                    self.x[p] for p in candidates if candidates[p].partner == partner
                )
                self.model += own <= supporting(partner)
        for s in helps:
            clashing = [self.x[p] for p in candidates if (p, s) in problem.incompatible]
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
        """Exclude other work of robots that hold placed parts, and anything that blocks them."""
        problem, x = self.problem, self.x
        for step, last in problem.kept.items():
            for later in range(step + 1, last + 1):
                held = problem.supports_of.get(later, [])
                for robot in problem.robots:
                    own = [
                        p
                        for p in self.x_of[step]
                        if problem.primaries[p].robot == robot
                    ]
                    busy = [*(x[p] for p in own), *self.busy[robot, later]]
                    self.model += pulp.lpSum(busy) <= 1
                for p in self.x_of[step]:
                    bad = [x[q] for q in self.x_of[later] if (p, q) in problem.clashing]
                    self.model += pulp.lpSum(bad) + x[p] <= 1
                    bad = [self.y[s] for s in held if (p, s) in problem.incompatible]
                    self.model += pulp.lpSum(bad) + x[p] <= 1

    def solve(self) -> bool:
        """Solve the program; return whether there is a solution."""
        for presolve in ("choose", "off"):  # presolving fails on some
            limits = {"timeLimit": _TIME_LIMIT_S, "gapRel": 0.0, "presolve": presolve}
            self.model.solve(QuietHighs(**limits))
            if self.model.solverModel.getModelStatus() != HighsModelStatus.kSolveError:
                break
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
        about = item.step, item.robot, item.object, item.partner, item.after, item.tools
        key = *about, frozenset(clashes[index]), frozenset(rivals[index])
        known = best.setdefault(key, index)
        if item.cost < problem.primaries[known].cost:
            best[key] = index
    return sorted(best.values())


def _competition(problem: AssignmentProblem) -> InfeasibleStepError:
    """Return the error that names the fewest steps to drop, and those they compete with."""
    program = _Program(problem, elastic=True)
    if not program.solve():
        return InfeasibleStepError("no assignment was found within the time limit")
    lacking = _chosen(program.left_out)
    taken: dict[str, list[int]] = defaultdict(list)
    for choice in program.plan().choices:
        taken[choice.object].append(choice.step)
    lines = []
    for step in lacking:
        candidates = [problem.primaries[p] for p in problem.primaries_of[step]]
        objects = sorted({item.object for item in candidates})
        free = [name for name in objects if not taken[name]]
        text = f"  step {step} ({problem.steps[step - 1]}) can use {', '.join(objects)}"
        if len(free) < len(objects):
            text += "; taken: " + ", ".join(
                f"{name} by step {', '.join(map(str, taken[name]))}"
                for name in objects
                if taken[name]
            )
        blockers = {other for w in candidates if w.object in free for other in w.after}
        if blockers:
            text += f"; {', '.join(free)} is blocked by {', '.join(sorted(blockers))}"
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
        f"{word} {names} cannot be done along with the others\n" + "\n".join(lines),
        steps=lacking,
    )
