"""``twin import apex-mr``: scenarios from published task files."""

from __future__ import annotations

from pathlib import Path

import typer

from planning.errors import InfeasibleStepError, RequestError
from twin.commands.command import command


def import_apex_mr_task(
    folder: Path,
    *,
    task: str,
    output: Path,
    prescribed_stock: bool = False,
    tool: str | None = None,
    press_from: str = "side",
) -> None:
    """Read a task as the authors of APEX-MR publish them.

    Args:
        folder: folder with the published files.
        task: name of the task, such as cliff.
        output: scenario file to write.
        prescribed_stock: take the stock brick of each step as published.
        tool: tool of both arms: dual-arm or slim; by default the first with which some
            robot can do every step.
        press_from: where the two ways to give a grip contradict each other: side
            (press_side, press_offset) or cell (press_x, press_ori).
    """
    from planning.importers.apex_mr.brick_steps import READINGS
    from planning.importers.apex_mr.importer import import_apex_mr
    from planning.lego.sequencing.stable_steps import stable_steps
    from planning.robots.registry import with_tool
    from twin.commands.imports.tool_choice import choose_tool
    from twin.host.atomic import write_text
    from twin.planning.kind import assembly_kind
    from twin.planning.lego import build_lego
    from twin.scenario.document.yaml_text import scenario_text
    from twin.scenario.file import load_scenario
    from twin.scenario.sections.lego import LegoSection

    if press_from not in READINGS:
        raise RequestError(f"--press-from {press_from}", choices=tuple(READINGS))
    with_tool("gp4", tool)
    content = import_apex_mr(
        folder,
        task,
        prescribed_stock=prescribed_stock,
        press_from=READINGS[press_from],
        note=_note,
    )
    note = f"Imported from the published APEX-MR task {task!r}."
    write_text(output, scenario_text(content, note))
    scenario = load_scenario(output)
    section = scenario.assembly
    assert isinstance(section, LegoSection)
    assembly = build_lego(section)
    try:
        stable_steps(assembly)
    except InfeasibleStepError as error:
        # They were built as published: rather doubt what is assumed of bricks and presses.
        _note(f"the steps are not checked when planned: {error}")
        content["assembly"]["rules"] = {"check_steps": False}
    if tool is None:
        choice = choose_tool(scenario, assembly, output.parent)
        tool = choice.tool
        typer.echo(choice.words)
    for robot in content["cell"]["robots"]:
        robot["tool"] = tool
    write_text(output, scenario_text(content, note))
    kind = assembly_kind(section)
    typer.echo(f"{output}: {kind.steps()} steps, {kind.supply()}")


def _note(line: str) -> None:
    typer.echo(f"note: {line}", err=True)


apex_mr = command(
    f"{__name__}:import_apex_mr_task",
    output={"names": ("--output", "-o")},
    press_from={"names": ("--press-from",)},
)
