"""Choice of a tool with which a LEGO scenario is feasible, for robots with several tools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planning.lego.bricks.assembly import LegoAssembly
    from twin.scenario.sections.scenario import Scenario


@dataclass(frozen=True)
class ToolChoice:
    """Steps that no robot can do, for each tested tool.

    Attributes:
        impossible: step numbers by tool, in the order in which the tools were tested.
    """

    impossible: Mapping[str, tuple[int, ...]]

    @property
    def tool(self) -> str:
        """The first tool with the fewest steps without a robot."""
        return min(self.impossible, key=lambda name: len(self.impossible[name]))

    @property
    def words(self) -> str:
        """Result in one line."""
        found = [
            f"with the {tool} tool "
            + (f"{_steps(steps)} cannot be done" if steps else "every step can be done")
            for tool, steps in self.impossible.items()
        ]
        return f"tool: {self.tool}, as {' and '.join(found)} by some robot"


def choose_tool(scenario: Scenario, assembly: LegoAssembly, folder: Path) -> ToolChoice:
    """Return a tool with which every step has a robot, preferably the model's own.

    Looked for are free and reachable picks, places, handovers and supports; ways between them are
    left to planning.

    Args:
        scenario: with robots of one type, and no tool chosen.
        assembly: its steps.
        folder: where relative paths start.
    """
    from planning.lego.skills.candidates import find_candidates
    from planning.robots.registry import ROBOTS
    from twin.planning.build_workcell import build_workcell

    tools = ROBOTS[scenario.cell.robots[0].model].tools
    found: dict[str, tuple[int, ...]] = {}
    for tool in tools:
        robots = tuple(
            robot.model_copy(update={"tool": tool}) for robot in scenario.cell.listed
        )
        cell = scenario.cell.model_copy(update={"listed": robots})
        trial = scenario.model_copy(update={"cell": cell})
        cell_with_it = build_workcell(trial, folder)
        found[tool] = find_candidates(cell_with_it, assembly).problem.impossible
        if not found[tool]:
            break
    return ToolChoice(found)


def _steps(numbers: tuple[int, ...]) -> str:
    some = ", ".join(map(str, numbers[:5]))
    more = f" and {len(numbers) - 5} more" if len(numbers) > 5 else ""
    return f"step{'s' if len(numbers) > 1 else ''} {some}{more}"
