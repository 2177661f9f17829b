"""``twin import apex-mr``: scenarios from published task files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import InfeasibleStepError
from twin.commands.imports.options import Output
from twin.host.guard import guarded

Folder = Annotated[
    Path, typer.Argument(help="Folder with the published files.", metavar="FOLDER")
]
Task = Annotated[str, typer.Option(help="Name of the task, such as cliff.")]
Prescribed = Annotated[
    bool,
    typer.Option(
        "--prescribed-stock", help="Take the stock brick of each step as published."
    ),
]


@guarded
def apex_mr(
    folder: Folder, task: Task, output: Output, prescribed_stock: Prescribed = False
) -> None:
    """Read a task as the authors of APEX-MR publish them."""
    from planning.importers.apex_mr.importer import import_apex_mr
    from planning.lego.sequencing.stable_steps import stable_steps
    from twin.host.atomic import write_text
    from twin.planning.kind import assembly_kind
    from twin.planning.lego import build_lego
    from twin.scenario.document.text import scenario_text
    from twin.scenario.file import load_scenario
    from twin.scenario.sections.lego import LegoSection

    content = import_apex_mr(
        folder,
        task,
        prescribed_stock=prescribed_stock,
        note=lambda line: typer.echo(f"note: {line}", err=True),
    )
    note = f"Imported from the published APEX-MR task {task!r}."
    write_text(output, scenario_text(content, note))
    section = load_scenario(output).assembly
    assert isinstance(section, LegoSection)
    try:
        stable_steps(build_lego(section))
    except InfeasibleStepError as error:
        # They were built as published: rather doubt what is assumed of bricks and presses.
        typer.echo(f"note: the steps are not checked when planned: {error}", err=True)
        content["assembly"]["rules"] = {"check_steps": False}
        write_text(output, scenario_text(content, note))
    assembly = assembly_kind(section)
    typer.echo(f"{output}: {assembly.steps()} steps, {assembly.supply()}")
