"""Candidates for the assignment: who can do which LEGO step with what (APEX-MR App. B)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations

from planning.assignment_problem import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    SupportCandidate,
)
from planning.lego.brick_world import BrickWorld, press_of
from planning.lego.handover_options import HandoverOption, HandoverOptions
from planning.lego.skill_options import SkillOption, SkillOptions
from planning.lego.structure import LegoAssembly
from planning.skill_paths import Obstruction, SkillPath, joint_distance
from planning.task_plan import StepChoice
from planning.workcell import Workcell


@dataclass(frozen=True)
class LegoCandidates:
    """The assignment problem of a LEGO assembly, and the joint paths behind its candidates.

    Attributes:
        world: cell and assembly.
        problem: what the solver needs.
        skills: picks, places and supports.
        handovers: handovers.
    """

    world: BrickWorld
    problem: AssignmentProblem
    skills: SkillOptions = field(repr=False)
    handovers: HandoverOptions = field(repr=False)

    def pick(self, choice: StepChoice) -> SkillPath:
        """Return the pick of a choice; in a place-up the support robot picks."""
        return _path(
            self.skills.pick(
                choice.primary.partner or choice.robot, choice.object, choice.grasp
            )
        )

    def place(self, choice: StepChoice) -> SkillPath:
        """Return the place of a choice, with its support robot standing by."""
        beside = self.support(choice)
        return _path(self.skills.place(choice.robot, choice.step, choice.grasp, beside))

    def support(self, choice: StepChoice) -> SkillPath | None:
        """Return the support of a choice, None where there is none."""
        if choice.support is None:
            return None
        return _path(self.skills.support(choice.support.robot, choice.step))

    def handover(self, choice: StepChoice) -> HandoverOption:
        """Return the handover of a place-up."""
        assert choice.primary.partner is not None
        found = self.handovers.handover(
            choice.primary.partner, choice.robot, choice.step, choice.grasp
        )
        assert isinstance(found, HandoverOption), found
        return found


def find_candidates(
    cell: Workcell, assembly: LegoAssembly, *, balance: float = 1.0
) -> LegoCandidates:
    """Find every feasible way to do every step, with its cost.

    A candidate's skills are reachable in one posture each, and free of contacts among the stock,
    the goals of the earlier steps, the other robots at HOME, and the cooperating robot at its
    post. Costs are L1 joint distances: HOME to pick plus HOME to place; for a place-up the
    giver's pick and handover, the receiver's receive and place. (The paper counts the handover
    with the support. It depends on both robots and the grip, so it is counted here; the sum is
    the same.)

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.
        balance: see AssignmentProblem.

    Raises:
        ScenarioError: a step cannot be understood.
    """
    world = BrickWorld(cell, assembly)
    skills = SkillOptions(world)
    collector = _Collector(world, skills, HandoverOptions(world, skills))
    for number in range(1, len(assembly.steps) + 1):
        if world.step(number).up:
            collector.add_up(number)
        else:
            collector.add_down(number)
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(_words(world, k) for k in range(1, len(assembly.steps) + 1)),
        needs_support=tuple(s.up or s.support is not None for s in assembly.steps),
        primaries=tuple(collector.primaries),
        supports=tuple(collector.supports),
        incompatible=frozenset(collector.incompatible),
        unlimited=world.stations,
        balance=balance,
        rejections=tuple(collector.rejections),
    )
    return LegoCandidates(world, problem, skills, collector.handovers)


class _Collector:
    """Gathers candidates step by step."""

    def __init__(
        self, world: BrickWorld, skills: SkillOptions, handovers: HandoverOptions
    ) -> None:
        self.world = world
        self.skills = skills
        self.handovers = handovers
        self.primaries: list[PrimaryCandidate] = []
        self.supports: list[SupportCandidate] = []
        self.incompatible: list[tuple[int, int]] = []
        self.rejections: list[Rejection] = []
        self._names = [robot.name for robot in world.cell.robots]
        self._home = skills.home

    def add_down(self, step: int) -> None:
        """Add the candidates of a place-down."""
        supports = self._add_supports(step)
        for robot in self._names:
            for grasp in self.world.grasps(step):
                place = self._place(robot, step, grasp, supports)
                if place is None:
                    continue
                first = len(self.primaries)
                cost = self._cost(place.path)
                for stock in self.world.usable_stock(step):
                    self._add_primary(step, robot, stock, grasp, place, cost)
                self._add_clashes(step, robot, grasp, supports, first)

    def add_up(self, step: int) -> None:
        """Add the candidates of a place-up: receiver, giver, brick and grip."""
        supports = self._add_supports(step)
        for receiver, giver in permutations(self._names, 2):
            for grasp in self.world.grasps(step):
                place = self._place(receiver, step, grasp, supports)
                if place is None:
                    continue
                handover = self.handovers.handover(giver, receiver, step, grasp)
                if isinstance(handover, Obstruction):
                    self._reject(
                        step,
                        f"{giver} hands it to {receiver}, {_grip(grasp)}",
                        handover,
                    )
                    continue
                first = len(self.primaries)
                cost = self._cost(place.path) + self._cost(handover.give)
                cost += joint_distance(self._home[receiver], handover.receive)
                for stock in self.world.usable_stock(step):
                    self._add_primary(step, receiver, stock, grasp, place, cost, giver)
                self._add_clashes(step, receiver, grasp, supports, first)

    def _add_supports(self, step: int) -> dict[int, SkillPath]:
        """Add the support candidates of a step; return their paths by candidate index."""
        work = self.world.step(step)
        out: dict[int, SkillPath] = {}
        if not work.up and work.support is None:
            return out
        for robot in self._names:
            option = self.skills.support(robot, step)
            if isinstance(option, Obstruction):
                self._reject(step, f"{robot} supports", option)
                continue
            if option.after:
                blocked = Obstruction(f"blocked by {', '.join(sorted(option.after))}")
                self._reject(step, f"{robot} supports", blocked)
                continue
            out[len(self.supports)] = option.path
            self.supports.append(
                SupportCandidate(
                    step, robot, option.path.support, self._cost(option.path)
                )
            )
        return out

    def _place(
        self, robot: str, step: int, grasp: int, supports: dict[int, SkillPath]
    ) -> SkillOption | None:
        """Return the cheapest place, alone or beside any of the supports."""
        words = f"{robot} places, {_grip(grasp)}"
        work = self.world.step(step)
        beside: list[SkillPath | None] = [None]
        if work.up or work.support is not None:
            beside = [path for path in supports.values() if path.robot != robot]
            if not beside:
                alone = Obstruction("no other robot can support it")
                self._reject(step, words, alone)
                return None
        best: SkillOption | None = None
        reason: Obstruction | None = None
        for support in beside:
            option = self.skills.place(robot, step, grasp, support)
            if isinstance(option, Obstruction):
                reason = reason or option
            elif best is None or self._cost(option.path) < self._cost(best.path):
                best = option
        if best is None and reason is not None:
            self._reject(step, words, reason)
        return best

    def _add_primary(
        self,
        step: int,
        robot: str,
        stock: str,
        grasp: int,
        place: SkillOption,
        cost: float,
        giver: str | None = None,
    ) -> None:
        picker = giver or robot
        pick = self.skills.pick(picker, stock, grasp)
        words = f"{picker} picks {stock}, {_grip(grasp)}"
        if isinstance(pick, Obstruction):
            self._reject(step, words, pick)
            return
        if pick.latest is not None and step > pick.latest:
            blocked = Obstruction(f"the brick of step {pick.latest} is in the way")
            self._reject(step, words, blocked)
            return
        self.primaries.append(
            PrimaryCandidate(
                step,
                robot,
                stock,
                grasp,
                cost + self._cost(pick.path),
                giver,
                (place.after | pick.after) - {stock},
            )
        )

    def _add_clashes(
        self,
        step: int,
        robot: str,
        grasp: int,
        supports: dict[int, SkillPath],
        first: int,
    ) -> None:
        """Note which of the newest primary candidates collide with which supports."""
        for index, path in supports.items():
            if path.robot == robot:
                continue
            option = self.skills.place(robot, step, grasp, path)
            if isinstance(option, Obstruction):
                self._reject(
                    step,
                    f"{robot} places beside {path.robot}, {_grip(grasp)}",
                    option,
                )
                self.incompatible += [
                    (p, index) for p in range(first, len(self.primaries))
                ]

    def _cost(self, path: SkillPath) -> float:
        return joint_distance(self._home[path.robot], path.contact)

    def _reject(self, step: int, what: str, reason: Obstruction) -> None:
        self.rejections.append(Rejection(step, what, reason.words))


def _path(found: SkillOption | Obstruction) -> SkillPath:
    assert isinstance(found, SkillOption), found
    return found.path


def _grip(grasp: int) -> str:
    press = press_of(grasp)
    return f"grip {press.side}/{press.offset}"


def _words(world: BrickWorld, step: int) -> str:
    work = world.step(step)
    turned = " turned" if work.cell.turned else ""
    how = "place-up" if work.up else "place-down"
    return f"{how} of {work.brick} at [{work.cell.x}, {work.cell.y}, {work.cell.z}]{turned}"
