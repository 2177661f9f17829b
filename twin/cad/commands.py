"""``twin import step``: create a scenario from the STEP file of an assembly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planning.errors import RequestError
from twin.host.extras import extra_module
from twin.host.guard import ExitCode, guarded, print_error

if TYPE_CHECKING:
    from twin.cad.step_import import ImportedAssembly


@guarded
def import_step(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="STEP file of an assembly.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Scenario file to write.")
    ],
    base: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Body that stands there first, as a fixture, and that the others are put"
            " on; by default the heaviest.",
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Where the middle of the base comes to, and the lowest point of the assembly"
            " [m]; by default on the table, at the best distance from all robots.",
        ),
    ] = None,
    up: Annotated[
        str,
        typer.Option(help="Axis of the file that points up: x, y, z, -x, -y or -z."),
    ] = "z",
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO",
            help="Scenario whose cell is taken: its robots, tools and fixtures; by default"
            " two arms at a table, as those of twin init.",
        ),
    ] = None,
    density: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]KG_M3",
            help="Density of all bodies, or of those of one name [kg/m^3]; by default that"
            " of steel, 7850.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the picture cell.png, or locked.png of bodies that hold each other.",
        ),
    ] = None,
) -> int:
    """Create a scenario from the STEP file of an assembly, as CAD programs export it."""
    extra_module(
        "cascadio", package="cascadio", extra="cad", needs="reading a STEP file"
    )
    from twin.cad.step_import import UPS, Wishes, import_step_file
    from twin.checks.commands import verdict

    if up not in UPS:
        raise RequestError(f"--up {up}", choices=tuple(UPS))
    overall, single = _densities(density or [])
    wishes = Wishes(base, _position(at), up, like, overall, single, picture)
    imported = import_step_file(file, output, wishes)
    for note in imported.notes:
        typer.echo(f"note: {note}", err=True)
    report = imported.report
    if report.findings:
        print_error(report.excerpts(report.findings).report())
    _print_table(imported)
    if picture is not None:
        from twin.checks.picture import draw_cell

        typer.echo(f"picture: {draw_cell(report.subject, picture)}")
    typer.echo(f"{output}: {verdict(report)}")
    return ExitCode.BAD_INPUT if report.errors else ExitCode.COMPLETED


def _position(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise RequestError(f"--at {text}: X,Y,Z expected, such as 0,0.1,0") from None
    if not all(abs(value) <= 1e4 for value in (x, y, z)):
        raise RequestError(f"--at {text}: at most 10 km from the origin")
    return x, y, z


def _densities(texts: list[str]) -> tuple[float, dict[str, float]]:
    """Return the density of all bodies, and those of single ones by name [kg/m^3]."""
    from planning.bounds import DENSEST_KG_M3
    from twin.cad.step_import import DENSITY

    overall, single = DENSITY, dict[str, float]()
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            found = float(value)
        except ValueError:
            found = -1.0
        if not 0.0 < found <= DENSEST_KG_M3:
            raise RequestError(
                f"--density {text}: a number of kg/m^3 up to {DENSEST_KG_M3:g} expected,"
                " such as 2700 or pin=7850"
            )
        if name:
            single[name] = found
        else:
            overall = found
    return overall, single


def _print_table(imported: ImportedAssembly) -> None:
    """Print the parts with their numbers and masses, the base, and the fits."""
    base = imported.base
    typer.echo(f"{base.name}: the base, a fixture")
    width = max(len(own.name) for own in imported.entries)
    for own in imported.entries:
        mass = own.density * own.type.volume
        typer.echo(f"{own.name:{width}}  {len(own.goals):3} x {mass:8.3f} kg")
    for fit in imported.report.fits:
        typer.echo(f"step {fit.step}: {fit.words}")
