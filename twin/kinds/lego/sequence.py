"""``twin sequence``: assembly sequence of a structure, with the placement of each brick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from planning.errors import InfeasibleStepError, ScenarioError
from twin.commands.options import AsJson, ScenarioFile
from twin.host.guard import guarded, print_json

if TYPE_CHECKING:
    from planning.lego.bricks.assembly import LegoAssembly, Support
    from planning.lego.insertion.rules import SequencingRules
    from planning.lego.sequencing.sequencing import SequencedStep, SequencedStructure
    from twin.kinds.lego.section import LegoSection

_SCAFFOLDS: Mapping[str, bool | Literal["removable"]] = {
    "none": False,
    "any": True,
    "removable": "removable",
}


@guarded
def sequence(
    scenario: ScenarioFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Write the scenario with these steps to a file."
        ),
    ] = None,
    explain: Annotated[
        int | None,
        typer.Option(
            metavar="STEP",
            help="Print the load that the structure bears at a step, and draw the "
            "joints that fail first: explain-STEP.png in this folder.",
        ),
    ] = None,
    scaffold: Annotated[
        str | None,
        typer.Option(
            metavar="WHICH",
            help="Temporary bricks, in place of the rules': none, any, or "
            "removable, only such as can be removed once the model is lifted "
            "off the plate.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the sequence of a LEGO assembly from its finished structure.

    If the scenario lists steps, only the structure that they build is used, not their order. Every step is
    feasible for some robots of the cell among the bricks present at that time; transits between steps are not
    checked.
    """
    from planning.tasks.highs_solver import check_candidates
    from twin.host.progress import StageWatch
    from twin.kinds.lego.kind import buildable_sequence
    from twin.kinds.lego.section import LegoSection
    from twin.planning.build_workcell import build_workcell
    from twin.reading.scenario_file import load_scenario
    from twin.scenario.shipped import scenario_path

    scenario = scenario_path(scenario)
    loaded = load_scenario(scenario)
    lego = loaded.assembly
    if not isinstance(lego, LegoSection):
        raise ScenarioError(f"{scenario}: only a LEGO assembly has a sequence to find")
    if scaffold is not None:
        lego = _with_scaffold(lego, scaffold)
    cell = build_workcell(loaded, scenario.parent)
    try:
        sequenced = buildable_sequence(lego, cell, StageWatch())
        check_candidates(sequenced.candidates.problem)
    except InfeasibleStepError as error:
        raise error.with_message(f"{scenario}: {error}") from None
    found = sequenced.found
    if explain is not None:
        _explain(sequenced.candidates.world.assembly, explain, sequenced.rules)
        return
    if output is not None:
        _write(scenario, output, found)
    if as_json:
        behind = {
            item.brick.name: [b.name for b in item.behind] for item in found.shut_in
        }
        rows = [
            _row(k, item)
            | ({"shut_in_behind": behind[item.name]} if item.name in behind else {})
            for k, item in enumerate(found.sequence, start=1)
        ]
        print_json(rows)
    else:
        _print_table(found)
        for item in found.shut_in:
            typer.echo(f"cannot be taken out again: {item.words}")
        if output is not None:
            typer.echo(f"written: {output}")


def _with_scaffold(lego: LegoSection, scaffold: str) -> LegoSection:
    """Return a section with another rule for temporary bricks."""
    if scaffold not in _SCAFFOLDS:
        raise ScenarioError(
            f"--scaffold {scaffold}: there is no such scaffold",
            choices=tuple(_SCAFFOLDS),
        )
    rules = lego.rules.model_copy(update={"scaffold": _SCAFFOLDS[scaffold]})
    return lego.model_copy(update={"rules": rules})


def _explain(assembly: LegoAssembly, number: int, rules: SequencingRules) -> None:
    """Print the loads of the structure at a step, and draw it."""
    from planning.lego.sequencing.explained_step import MOST, explain_step
    from twin.kinds.lego.step_picture import draw_step

    def up_to(force: float) -> str:
        return f"{force:.1f} N" + (" and more" if force >= MOST - 0.05 else "")

    found = explain_step(assembly, number, rules)
    step = assembly.steps[number - 1]
    typer.echo(f"step {number}, {step.words}: it takes {found.needed:.1f} N")
    held = ""
    if step.support is not None:
        held = f" with its support, {up_to(found.bears_unsupported)} without"
    typer.echo(f"the structure bears {up_to(found.bears)}{held}")
    for first, second, share in found.report.pulled[:5]:
        names = " and ".join(name or "the plate" for name in (first, second))
        typer.echo(f"  {names}: {100 * share:.0f} % of the friction of a knob")
    if not found.report.pulled:
        typer.echo(
            "  no joint is pulled: every force goes down to the plate by pushing"
        )
    picture = Path(f"explain-{number}.png")
    picture.write_bytes(draw_step(found))
    typer.echo(f"written: {picture}")


def _row(number: int, item: SequencedStep) -> dict[str, Any]:
    return {
        "step": number,
        "name": item.name,
        **step_section(item),
        "kind": _kind(item),
        "press_n": round(item.needed, 2),
        "reason": item.reason,
    }


def step_section(item: SequencedStep) -> dict[str, Any]:
    """Return a step in the form of a scenario file."""
    step = item.step
    out: dict[str, Any] = {"brick": step.brick.name, **step.cell.entry}
    if step.temporary:
        out["temporary"] = True
    if step.up:
        out["place"] = "up"
    out["press"] = asdict(step.presses[0])
    if len(step.presses) > 1:
        out["presses"] = [asdict(press) for press in step.presses]
    if step.supports:
        out["support"] = _support(step.supports[0], up=step.up)
    if len(step.supports) > 1:
        out["supports"] = [_support(item, up=step.up) for item in step.supports]
    if step.attack != 1:
        out["attack"] = step.attack
    return out


def _support(support: Support, *, up: bool) -> dict[str, Any]:
    top = {"from_above": True} if support.from_above and not up else {}
    return {**support.cell.entry, "orientation": support.orientation, **top}


def _kind(item: SequencedStep) -> str:
    if item.step.up:
        return "place-up"
    return "support-bottom" if item.step.support is not None else "plain"


def _print_table(found: SequencedStructure) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for heading in ("step", "name", "brick", "cell", "kind", "press", "support"):
        table.add_column(heading, no_wrap=True)
    table.add_column("why", min_width=24)
    for number, item in enumerate(found.sequence, start=1):
        step = item.step
        cell = f"{step.cell.x}, {step.cell.y}, {step.cell.z}"
        cell += f" raised {step.cell.raised}" if step.cell.raised else ""
        cell += " turned" if step.cell.turned else ""
        press = "" if step.press is None else f"{step.press.side}/{step.press.offset}"
        if len(item.step.presses) > 1:
            press += f" (of {len(item.step.presses)})"
        support = ""
        if step.support is not None:
            at = step.support.cell
            support = f"{at.x}, {at.y}, {at.z} way {step.support.orientation}"
            support += f" raised {at.raised}" if at.raised else ""
            if len(item.step.supports) > 1:
                support += f" (of {len(item.step.supports)})"
        table.add_row(
            str(number),
            item.name,
            step.brick.name,
            cell,
            _kind(item),
            press,
            support,
            item.reason,
        )
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, 120)
    console.print(table)
    kinds = [_kind(item) for item in found.sequence]
    counts = ", ".join(
        f"{kinds.count(kind)} {kind}"
        for kind in ("plain", "support-bottom", "place-up")
        if kind in kinds
    )
    console.print(f"{len(kinds)} steps: {counts}")


def _write(source: Path, output: Path, found: SequencedStructure) -> None:
    """Write the scenario with explicit steps, and read it again."""
    from planning.files import read_file
    from twin.document.yaml_text import read_yaml, scenario_text
    from twin.host.atomic_files import write_text
    from twin.kinds.lego.kind import brick_colours
    from twin.kinds.lego.section import LegoSection
    from twin.reading.scenario_file import load_scenario

    content = read_yaml(source, read_file(source).decode("utf-8-sig")).data
    section = load_scenario(source).assembly
    assert isinstance(section, LegoSection)
    colours = brick_colours(section)
    assembly = {k: v for k, v in content["assembly"].items() if k != "structure"}
    assembly["steps"] = [
        step_section(item)
        | (
            {"colour": list(colours[item.step.cell])}
            if item.step.cell in colours
            else {}
        )
        for item in found.sequence
    ]
    note = f"The sequence that twin sequence found for {source.name}."
    write_text(output, scenario_text({**content, "assembly": assembly}, note))
    load_scenario(output)
