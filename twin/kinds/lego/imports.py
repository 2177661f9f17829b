"""Commands of ``twin import`` for LEGO: published task files, brick lists and LDraw models."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from planning.errors import InfeasibleStepError, RequestError, ScenarioError, TwinError
from twin.host.guard import guarded

if TYPE_CHECKING:
    from planning.lego.importers.brick_models.model import BrickModel
    from twin.scenario.sections.scenario import Scenario

Output = Annotated[Path, typer.Option("--output", "-o", help="Scenario file to write.")]
CellOf = Annotated[
    Path | None,
    typer.Option(
        metavar="SCENARIO",
        help="Scenario whose cell, plate and stock are taken; by default a cell is chosen:"
        " two arms across a plate, and feeding stations.",
    ),
]

_STOCK_KEYS = ("plate", "storage_plate", "bricks", "stock", "rules", "twist_deg")


@guarded
def import_apex_mr_task(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with the published files.")
    ],
    task: Annotated[str, typer.Option(help="Name of the task, such as cliff.")],
    output: Output,
    prescribed_stock: Annotated[
        bool,
        typer.Option(
            "--prescribed-stock",
            help="Take the stock brick of each step as published.",
        ),
    ] = False,
    tool: Annotated[
        str | None,
        typer.Option(
            help="Tool of both arms: dual-arm or slim; by default the first with which some"
            " robot can do every step."
        ),
    ] = None,
    press_from: Annotated[
        str | None,
        typer.Option(
            help="Used where the two descriptions of a grip contradict each other: "
            "side (press_side, press_offset) or cell (press_x, press_ori); by "
            "default the first with which the structure bears every press."
        ),
    ] = None,
) -> None:
    """Create a scenario from a task published by the authors of APEX-MR."""
    import_task(
        folder,
        task=task,
        output=output,
        prescribed_stock=prescribed_stock,
        tool=tool,
        press_from=press_from,
    )


@guarded
def import_brick_list(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Brick list, one brick a line: hxw (x,y,z), as BrickGPT writes them.",
        ),
    ],
    output: Output,
    cell: CellOf = None,
) -> None:
    """Create a scenario from a brick list."""
    from planning.lego.importers.brick_models.brick_list import read_brick_list

    _write(file, read_brick_list(file), output, cell)


@guarded
def import_ldraw(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Model of LDraw, .ldr or .mpd.")
    ],
    output: Output,
    cell: CellOf = None,
    parts: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Parts library of LDraw, with the folders parts and p: sizes of parts that are"
            " not among the known bricks.",
        ),
    ] = None,
    unknown: Annotated[
        str,
        typer.Option(
            help="Parts that no tool places: refuse; box, an obstacle in its place from the"
            " start; or leave-out, with the bricks that nothing else holds."
        ),
    ] = "refuse",
) -> None:
    """Create a scenario from an LDraw model, as LeoCAD, Studio and others write them."""
    from planning.lego.importers.brick_models.ldraw import Unknown, read_ldraw

    choices: tuple[Unknown, ...] = get_args(Unknown)
    chosen = [own for own in choices if own == unknown]
    if not chosen:
        raise RequestError(f"--unknown {unknown}", choices=choices)
    model = read_ldraw(file, library=parts, unknown=chosen[0])
    _write(file, model, output, cell)


def import_task(
    folder: Path,
    *,
    task: str,
    output: Path,
    prescribed_stock: bool = False,
    tool: str | None = None,
    press_from: str | None = None,
) -> None:
    """Write the scenario of a published APEX-MR task; arguments as options of the command.

    Raises:
        RequestError: there is no such task, or no such reading of its presses.
        ScenarioError: the published tables do not fit together.
    """
    from planning.lego.importers.apex_mr.importer import PressFrom, import_apex_mr
    from planning.lego.sequencing.stable_steps import stable_steps
    from planning.robots.registry import with_tool
    from twin.checks.finding import CheckContext
    from twin.document.yaml_text import scenario_text
    from twin.host.atomic_files import write_text
    from twin.kinds.lego.checks import check_brick_tools
    from twin.kinds.lego.kind import build_lego
    from twin.kinds.lego.section import LegoSection
    from twin.kinds.lego.tool_choice import choose_tool
    from twin.reading.scenario_file import parse_scenario
    from twin.scenario.sections.kind import assembly_kind

    known: tuple[PressFrom, ...] = get_args(PressFrom)
    readings = [own for own in known if press_from in (None, own)]
    if not readings:
        raise RequestError(f"--press-from {press_from}", choices=known)
    with_tool("gp4", tool)
    about, refusals = f"Imported from the published APEX-MR task {task!r}.", list[str]()
    found: list[tuple[dict[str, Any], list[str]]] = []
    for reading in readings:
        notes: list[str] = []
        content = import_apex_mr(
            folder,
            task,
            prescribed_stock=prescribed_stock,
            press_from=reading,
            note=notes.append,
        )
        scenario, _ = parse_scenario(output, scenario_text(content, about))
        section = scenario.assembly
        assert isinstance(section, LegoSection)
        found.append((content, notes))
        try:
            stable_steps(build_lego(section))
            break
        except InfeasibleStepError as error:
            refusals.append(f"with the grips of --press-from {reading}: {error}")
    else:
        # They were built as published: rather doubt what is assumed of bricks and presses.
        content, notes = found[0]
        content["assembly"]["rules"] = {"check_steps": False}
        refusals = [
            "the steps are not checked when planned (rules.check_steps: false)",
            *refusals,
        ]
        about = "\n".join([about, *refusals])
    for line in (*notes, *refusals):
        _note(line)
    scenario, _ = parse_scenario(output, scenario_text(content, about))
    section = scenario.assembly
    assert isinstance(section, LegoSection)
    if tool is None:
        choice = choose_tool(scenario, build_lego(section), output.parent)
        tool = choice.tool
        typer.echo(choice.words)
    for robot in content["cell"]["robots"]:
        robot["tool"] = tool
    text = scenario_text(content, about)
    scenario, _ = parse_scenario(output, text)
    for misfit in check_brick_tools(CheckContext(scenario, output.parent)):
        if misfit.error:
            raise ScenarioError(
                f"{folder}: the tables of robot_properties: {misfit.message}"
            )
        _note(misfit.message)
    write_text(output, text)
    kind = assembly_kind(section)
    typer.echo(f"{output}: {kind.steps()} steps, {kind.supply()}")


def _note(line: str) -> None:
    typer.echo(f"note: {line}", err=True)


def _write(file: Path, model: BrickModel, output: Path, cell: Path | None) -> None:
    """Write the scenario of a model, turned if need be, if its cell reaches all of it."""
    from planning.lego.importers.brick_models.cell import model_cell, model_orientations
    from twin.document.yaml_text import scenario_text
    from twin.host.atomic_files import write_text
    from twin.reading.scenario_file import parse_scenario

    name = re.sub(r"[^A-Za-z0-9_.-]", "_", file.stem)
    refusal: TwinError | None = None
    for turned in [model] if cell is not None else model_orientations(model):
        try:
            content = (
                model_cell(turned) if cell is None else _in_cell(turned, cell, output)
            )
            # Models of others were not drawn for two arms: temporary bricks may carry what hangs.
            content["assembly"].setdefault("rules", {"scaffold": True})
            content = {"version": 1, "name": name, "seed": 0, **content}
            text = scenario_text(content, f"Imported from {file.name}.")
            scenario, _ = parse_scenario(output, text)
            _check_reach(scenario, output.parent)
        except (InfeasibleStepError, ScenarioError) as error:
            if refusal is None and isinstance(error, ScenarioError):
                raise
            refusal = refusal or error
            continue
        model = turned
        break
    else:
        assert refusal is not None
        raise refusal
    for line in model.notes:
        typer.echo(f"note: {line}", err=True)
    write_text(output, text)
    wide, deep, levels = model.size
    total, kinds = len(model.bricks), len(model.kinds)
    typer.echo(
        f"{output}: {total} brick{'s' * (total > 1)} of {kinds} type{'s' * (kinds > 1)},"
        f" {wide} x {deep} studs, {levels / 3:.4g} bricks high"
    )


def _in_cell(model: BrickModel, path: Path, output: Path) -> dict[str, Any]:
    """Return the content of a scenario with the model in the cell of another scenario."""
    from planning.files import read_file
    from planning.lego.importers.brick_models.cell import (
        free_corner,
        obstacle_fixtures,
        own_types,
        structure_content,
    )
    from twin.document.yaml_text import read_yaml
    from twin.kinds.lego.kind import build_lego
    from twin.kinds.lego.section import LegoSection
    from twin.reading.scenario_file import load_scenario

    section = load_scenario(path).assembly
    if not isinstance(section, LegoSection):
        raise ScenarioError(f"{path}: only the cell of a LEGO scenario has a stock")
    assembly = build_lego(section)
    taken = {
        place: item.name
        for item in assembly.stock
        if assembly.plate_of(item) is assembly.plate
        for place in item.studs
    }
    corner = free_corner(model, assembly.plate.studs, taken)
    data = read_yaml(path, read_file(path).decode("utf-8-sig")).data
    old = data["assembly"]
    kept = {key: old[key] for key in _STOCK_KEYS if key in old}
    new = {"kind": "lego", **kept, "structure": structure_content(model, corner)}
    own = own_types(model).get("bricks", {})
    if own:
        theirs = kept.get("bricks", {})
        other = [name for name in own if name in theirs and theirs[name] != own[name]]
        if other:
            raise ScenarioError(f"{path}: other types are called {', '.join(other)}")
        new["bricks"] = {**own, **theirs}
    content: dict[str, Any] = {"cell": data["cell"], "assembly": new}
    if boxes := obstacle_fixtures(model, corner, assembly.plate):
        content["cell"]["fixtures"] = [*content["cell"].get("fixtures", ()), *boxes]
    for robot in content["cell"]["robots"]:
        _relocate_path(robot, path.parent, output.parent)
    return content


def _relocate_path(robot: dict[str, Any], old: Path, new: Path) -> None:
    """Adapt the path of a robot's description to another folder."""
    import os

    from planning.files import is_file
    from planning.robots.registry import ROBOTS

    name = str(robot["model"])
    if name not in ROBOTS and is_file(old / name):
        robot["model"] = Path(os.path.relpath(old / name, new)).as_posix()


def _check_reach(scenario: Scenario, folder: Path) -> None:
    """Raise an error where no robot reaches a brick's place, or any of its type in stock."""
    from planning.lego.bricks.assembly import LegoStep
    from planning.lego.sequencing.step_reach import check_reach
    from twin.kinds.lego.kind import build_lego, build_structure
    from twin.kinds.lego.section import LegoSection
    from twin.planning.build_workcell import build_workcell

    section = scenario.assembly
    assert isinstance(section, LegoSection)
    placed = build_structure(section) or ()
    steps = tuple(LegoStep(item.brick, item.cell) for item in placed)
    assembly = replace(build_lego(section), steps=steps)
    names = [f"{b.name} ({b.brick.name} at {b.cell.words})" for b in placed]
    check_reach(build_workcell(scenario, folder), assembly, names)
