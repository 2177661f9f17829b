"""``twin fit``: fit probability distributions to measured durations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planning.errors import RequestError, format_names
from twin.commands.options import AsJson, Quiet
from twin.host.guard import guarded, print_json

if TYPE_CHECKING:
    from twin.fit.fitting import Fit


@guarded
def fit(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="CSV files with a header line, a row a duration; or runs: their folders or"
            " event logs.",
        ),
    ],
    column: Annotated[
        str | None,
        typer.Option(
            help="Column of the durations; its name may end with their unit, as"
            ' cycle_time_ms or "cycle time [ms]" do; default: duration_s, or duration with'
            " another unit."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="Column of the time stamps at which durations start, in place of "
            "--column: numbers or ISO 8601. Default: columns start and end, "
            "if present."
        ),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option(help="Column of the time stamps at which they end."),
    ] = None,
    by: Annotated[
        list[str] | None,
        typer.Option(
            help="Fit each value of this column separately: skill, robot or "
            "object. Repeatable."
        ),
    ] = None,
    skill: Annotated[
        str | None,
        typer.Option(
            help="Skill of all rows; default: the file's name where it is a skill."
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of numbers in columns whose names have no unit: s, ms, min, "
            "h, us or ns; default: s."
        ),
    ] = None,
    apply: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO",
            help="Write a copy of this scenario with the fitted durations.",
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            "--into",
            "-o",
            metavar="FILE",
            help="The new scenario; default: SCENARIO with -fitted in its name.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the results; default: logs/fit-<name>-<UTC time>.",
        ),
    ] = None,
    resamples: Annotated[
        int,
        typer.Option(min=19, max=100000, help="Bootstrap samples of each test."),
    ] = 499,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the bootstrap.")] = 0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find the distributions that fit measured durations best.

    Each family is fitted by maximum likelihood and tested: Anderson-Darling, with a p value by parametric
    bootstrap. Families that are not rejected (p of at least 0.05) come first, ordered by AICc. Writes
    durations.yaml, the lines for a scenario; fit.json, all figures; and a picture of each group: histogram
    with densities, and quantiles. --apply writes a scenario with these durations.
    """
    from twin.fit.applied import apply_fits, require_skills
    from twin.fit.candidates import fit_candidates
    from twin.fit.chart import draw_fit
    from twin.fit.fitting import Fit, write_snippet
    from twin.fit.samples import read_samples, unit_notes
    from twin.host.atomic_files import write_json
    from twin.host.progress import StageDisplay
    from twin.reading.scenario_file import load_scenario
    from twin.runs.folder import EVENTS, prepare_run_folder

    columns = _columns(column, start, end)
    target = _target(apply, into)
    if apply is not None:
        load_scenario(apply)  # its errors come before the time that fitting takes
    samples, left_out = read_samples(
        files, columns=columns, by=by or (), skill=skill, unit=unit
    )
    for line in unit_notes(files, samples, columns, unit):
        typer.echo(line, err=True)
    if apply is not None:
        require_skills(samples)
    names = [
        path.resolve().parent.name if path.name == EVENTS else path.name
        for path in files
    ]
    folder = prepare_run_folder(out, f"fit-{Path(names[0]).stem}")
    silent = quiet or as_json
    with StageDisplay(enabled=not silent) as display:
        fits = []
        for sample in samples:
            progress = partial(display, sample.name)
            found = fit_candidates(
                sample.values_s, resamples=resamples, seed=seed, progress=progress
            )
            fits.append(Fit(sample, found))
        for k, one in enumerate(fits):
            display("pictures", k, len(fits))
            draw_fit(folder / f"{one.sample.name}.png", one)
    content = [_content(one) for one in fits]
    count = sum(len(sample.values_s) for sample in samples)
    note = f"{count} durations of {format_names(names)}, fitted by: twin fit"
    lines = write_snippet(folder, fits, note)
    write_json(folder / "fit.json", content)
    for group, few in left_out.items():
        typer.echo(f"{group}: {few} durations are too few, left out", err=True)
    if apply is not None:
        for stronger in apply_fits(apply, target, fits, note):
            typer.echo(
                f"skill_overrides: the exception for {stronger} stays, and beats what was fitted",
                err=True,
            )
    if as_json:
        print_json(content)
    elif not quiet:
        for one in fits:
            _print(one)
        typer.echo(lines)
        _hint(files, by or ())
        typer.echo(f"written to {folder}")
        if apply is not None:
            typer.echo(f"scenario: {target}")


def _columns(
    column: str | None, start: str | None, end: str | None
) -> str | tuple[str, str] | None:
    """Return the columns named by options, None without any."""
    if start is None and end is None:
        return column
    if start is None or end is None or column is not None:
        raise RequestError("give --start and --end, or --column alone")
    return start, end


def _target(apply: Path | None, into: Path | None) -> Path:
    """Return the path of the scenario to write."""
    if apply is None:
        if into is not None:
            raise RequestError(f"-o {into} is the scenario that --apply SCENARIO makes")
        return Path()
    return into or apply.with_name(f"{apply.stem}-fitted{apply.suffix}")


def _content(fit: Fit) -> dict[str, Any]:
    return {
        **fit.sample.labels,
        "durations": len(fit.sample.values_s),
        "section": fit.section(),
        "candidates": [
            {
                "distribution": candidate.family.title,
                "section": dict(candidate.section),
                "aicc": candidate.aicc,
                "anderson_darling": candidate.anderson_darling,
                "p_value": candidate.p_value,
                "rejected": candidate.rejected,
            }
            for candidate in fit.candidates
        ],
    }


def _print(fit: Fit) -> None:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    values = fit.sample.values_s
    low, median, high = np.percentile(values, (0, 50, 100))
    labels = ", ".join(fit.sample.labels.values()) or "durations"
    typer.echo(
        f"{labels}: {len(values)} durations, median {median:.3g} s, "
        f"from {low:.3g} to {high:.3g} s"
    )
    if not fit.candidates:
        typer.echo("all the same")
        return
    table = Table(caption="p below 0.05: rejected", caption_justify="left")
    for name in ("distribution", "AICc", "A²", "p"):
        table.add_column(name, justify="left" if name == "distribution" else "right")
    table.add_column("parameters", overflow="fold")
    for candidate in fit.candidates:
        table.add_row(
            candidate.family.title,
            f"{candidate.aicc:.1f}",
            f"{candidate.anderson_darling:.2f}",
            f"{candidate.p_value:.3f}",
            _parameters(candidate.section),
            style="dim" if candidate.rejected else "",
        )
    Console().print(table)
    if fit.best is None:
        typer.echo("no distribution fits: use the measured times themselves")


def _parameters(section: Any) -> str:
    """Return the parameters of a section in one line."""
    parts = []
    for key, value in section.items():
        if key == "model":
            parts.append(_parameters(value))
        elif key != "kind":
            parts.append(f"{key} {value:.4g}")
    return ", ".join(parts)


def _hint(files: Sequence[Path], by: Sequence[str]) -> None:
    """Print a hint if labels in the files separate groups that were fitted as one."""
    from twin.fit.samples import is_log, unused_labels

    if is_log(files[0]):
        return
    for name, values in unused_labels(files, by).items():
        typer.echo(
            f"column {name!r} has {len(values)} values, fitted as one: "
            f"--by {name} fits each on its own",
            err=True,
        )
