"""``report.html``: figures and tables of a study in one file that needs no network."""

from __future__ import annotations

import html
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from planning.transforms import Array
from twin.host.atomic import write_text
from twin.host.pictures import save_png
from twin.host.progress import Report
from twin.host.versions import versions
from twin.run.policies import ASYNCHRONOUS, ASYNCHRONOUS_SHORTCUTS, NAMED_POLICIES
from twin.study.folder import BLOCKS, PLANS, REPORT
from twin.study.plans import load_plans, workloads
from twin.study.replications.block_results import cell_blocks, cell_tally
from twin.study.report.figures import (
    draw_bands,
    draw_ecdf,
    draw_response,
    draw_sobol,
    draw_tornado,
    draw_waits,
)
from twin.study.sensitivity import influences, sobol_indices
from twin.study.study import StudyResult
from twin.study.summary import cell_label, collisions

DRAWING = "report"
"""Name of the stage for progress displays."""


def write_report(result: StudyResult, progress: Report) -> None:
    """Draw the pictures of a study and write its report.

    Raises:
        OutputError: a file cannot be written.
    """
    progress(DRAWING, 0, 5)
    pictures = dict(_pictures(result, progress))
    for name, (figure, _) in pictures.items():
        save_png(figure, result.folder / f"{name}.png")
    write_text(result.folder / REPORT, _page(result, pictures))
    progress(DRAWING, 5, 5)


def _pictures(
    result: StudyResult, progress: Report
) -> Iterator[tuple[str, tuple[Figure, str]]]:
    """Yield names of pictures, with the picture and its heading."""
    experiment, summary = result.request.experiment, result.summary
    policies = experiment.policies
    samples = [makespans_s(result, cell) for cell in range(len(experiment.cells))]
    yield "makespan", (draw_ecdf(summary, samples, policies), "How long it takes")
    for key in experiment.variants[0]:
        name = "response-" + key.replace(".", "-")
        yield name, (draw_response(summary, key, policies), f"What {key} does")
    progress(DRAWING, 1, 5)
    yield "waits", (draw_waits(summary), "What the robots wait for")
    loads = workloads(
        result.request.scenario,
        result.request.base,
        load_plans(result.folder / PLANS, policies),
        experiment,
    )
    cell = _shown_cell(policies)
    tally = cell_tally(result.folder / BLOCKS, cell)
    label = cell_label(summary["cells"][cell])
    progress(DRAWING, 2, 5)
    if len(tally.start_ns):
        figure = draw_bands(loads[cell].tpg, tally)
        yield "gantt", (figure, f"When tasks are done, and which are critical: {label}")
    progress(DRAWING, 3, 5)
    if "makespan_s" in summary["cells"][cell]:
        found = influences(loads[cell])
        mean = summary["cells"][cell]["makespan_s"]["estimate"]
        figure = draw_tornado(found, mean)
        yield "tornado", (figure, f"Which inputs the makespan hangs on: {label}")
        points = result.request.sobol_points
        if points:
            indices = sobol_indices(
                loads[cell],
                points,
                seed=result.request.scenario.seed,
                progress=progress,
            )
            heading = f"Which inputs it hangs on when all vary at once: {label}"
            yield "sobol", (draw_sobol(indices), heading)
    progress(DRAWING, 4, 5)


def makespans_s(result: StudyResult, cell: int) -> Array:
    """Return the makespans of a cell, NaN where it did not complete, shape (n,) [s]."""
    blocks = cell_blocks(result.folder / BLOCKS, cell)
    return np.concatenate([block.rows.makespans_s() for block in blocks])


def _shown_cell(policies: Sequence[str]) -> int:
    """Return the cell whose tasks are shown: of the policy that coordinates best."""
    order = (ASYNCHRONOUS_SHORTCUTS, ASYNCHRONOUS, *NAMED_POLICIES)
    return policies.index(next(policy for policy in order if policy in policies))


def _page(result: StudyResult, pictures: Mapping[str, tuple[Figure, str]]) -> str:
    summary = result.summary
    title = f"{summary['scenario']}: study"
    style = (
        files("twin.study.report").joinpath("report.css").read_text(encoding="utf-8")
    )
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{html.escape(_lead(result))}</p>",
        _table(summary),
        _differences(summary),
        _open_loop(summary),
    ]
    for figure, heading in pictures.values():
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts.append(f"<figure>{_svg(figure)}</figure>")
    parts.append("<h2>How it was made</h2>")
    made_with = ", ".join(f"{name} {number}" for name, number in versions().items())
    parts.append(f"<p>{html.escape(f'Made with {made_with}')}</p>")
    design = json.dumps(_design(result), indent=2, ensure_ascii=False)
    parts.append(f"<pre>{html.escape(design)}</pre></body></html>")
    return "\n".join(part for part in parts if part) + "\n"


def _lead(result: StudyResult) -> str:
    experiment, summary = result.request.experiment, result.summary
    counts = sorted({cell["replications"] for cell in summary["cells"]})
    many = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    text = (
        f"{many} replications of {len(experiment.policies)} policies"
        f" with the same draws, seed {result.request.scenario.seed}."
    )
    if experiment.replications is None:
        text += (
            f" Sampling went on until the {100 * summary['confidence']:g} % interval of"
            f" every mean was within {100 * experiment.precision.relative_half_width:g} %,"
            f" or {experiment.precision.most} replications were done."
        )
    return text


def _table(summary: Mapping[str, Any]) -> str:
    varied = list(summary["cells"][0]["variant"])
    names = ["policy", *varied, "n", "mean", "P50", "P90", "P95", "P99"]
    deadline = summary["deadline_s"]
    names += ["not completed"] + ([f"within {deadline:g} s"] if deadline else [])
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    rows = []
    for cell in summary["cells"]:
        row = [cell["policy"], *(str(cell["variant"][key]) for key in varied)]
        row.append(str(cell["replications"]))
        for key in ("makespan_s", *(f"makespan_p{p}_s" for p in (50, 90, 95, 99))):
            row.append(_span(cell.get(key), "{:.1f}", 1.0))
        row.append(_span(cell["not_completed"], "{:.1f} %", 100.0))
        if deadline:
            row.append(_span(cell.get("in_time"), "{:.1f} %", 100.0))
        rows.append(
            "<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in row) + "</tr>"
        )
    share = f"{100 * summary['confidence']:g} %"
    caption = f"Makespan in seconds, with {share} intervals"
    return (
        f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _span(entry: Mapping[str, Any] | None, form: str, factor: float) -> str:
    if entry is None:
        return "-"
    text = form.format(factor * entry["estimate"])
    if entry["low"] is None:
        return text
    low, high = (f"{factor * entry[side]:.1f}" for side in ("low", "high"))
    return f"{text} ({low} to {high})"


def _differences(summary: Mapping[str, Any]) -> str:
    texts = []
    for entry in summary["differences"]:
        span = _span(entry["makespan_s"], "{:+.1f} s", 1.0)
        where = "".join(f", {key} = {value}" for key, value in entry["variant"].items())
        texts.append(
            f"{entry['policy']} against {entry['reference']}{where}: {span},"
            f" {100 * entry['relative']:+.1f} %"
        )
    return _list("Differences, replication by replication", texts)


def _open_loop(summary: Mapping[str, Any]) -> str:
    texts = []
    for cell in summary["cells"]:
        if "collided" in cell:
            share = _span(cell["collided"], "{:.0f} %", 100.0)
            texts.append(f"{cell_label(cell)}: {collisions(cell)}, {share}")
    return _list("When nobody waits for anybody", texts)


def _list(heading: str, texts: Sequence[str]) -> str:
    """Return a list with its heading, nothing where there are no entries."""
    items = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f"<h2>{heading}</h2><ul>{items}</ul>" if items else ""


def _design(result: StudyResult) -> dict[str, Any]:
    experiment = result.request.experiment
    return {
        "policies": experiment.policies,
        "variants": experiment.variants,
        "replications": experiment.replications,
        "antithetic": experiment.antithetic,
        **_origin(result),
        "engines": [_engine(cell) for cell in result.summary["cells"]],
    }


def _origin(result: StudyResult) -> dict[str, Any]:
    """Return where the plans come from: a run, or a search with some shortcuts."""
    if result.request.plan:
        return {"plan": result.request.plan}
    return {"shortcut_candidates": result.request.candidates}


def _engine(cell: Mapping[str, Any]) -> dict[str, Any]:
    because = cell["event_engine_because"]
    own = {"cell": cell_label(cell), "engine": cell["engine"]}
    return own | ({"because": because} if because else {})


def _svg(figure: Figure) -> str:
    """Return a picture as an SVG element, the same for the same study."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
