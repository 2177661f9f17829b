"""Report of a study (``report.html``): figures and tables in one file that can be viewed offline."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from twin.checks.finding import CheckContext
from twin.checks.picture import cell_figure
from twin.drawing.pictures import WIDTH_IN
from twin.host.atomic_files import write_text
from twin.host.cards import pairs
from twin.host.progress import Report
from twin.runs.policies import preferred_policy
from twin.scenario.variations import apply_variation
from twin.studies.folder import BLOCKS, REPORT
from twin.studies.gains.gains import LEADING
from twin.studies.products import orders_of, study_product_times
from twin.studies.replications.block_results import cell_makespans_s, cell_tally
from twin.studies.report.assumptions import assumptions, warnings
from twin.studies.report.cell_figures import draw_bands, draw_sobol, draw_tornado
from twin.studies.report.figures import (
    draw_ecdf,
    draw_line,
    draw_ranking,
    draw_response,
    draw_waits,
)
from twin.studies.report.markup import (
    bullets,
    escape_text,
    heading,
    page,
    paragraph,
    save_and_embed_picture,
    text_table,
)
from twin.studies.report.page_tables import (
    OPERATED,
    busy_rows,
    collision_lists,
    critical_tasks_table,
    difference_list,
    holding_texts,
    lateness_list,
    lines_table,
    makespans_table,
    operated_tables,
    ranking_table,
    refused_table,
    replication_sentence,
    variant_rows,
    window_rows,
    worker_rows,
)
from twin.studies.report.sensitivity_tables import (
    GAINS_NOTE,
    gains_tables,
    sobol_table,
    tornado_table,
)
from twin.studies.study import StudyResult
from twin.studies.summary import CellSummary, StudySummary, shown_cell
from twin.throughput.product_gantt import products_figure
from twin.throughput.throughput import seconds

DRAWING = "report"
"""Name of the stage for progress displays."""

_DRAWN = 8
"""Cells whose charts are drawn; of further ones there are tables."""

_AT_ONCE = 8
"""Cells whose makespans are on the first page; of more it has those of the first variant."""

_LATER = 5
"""Rows of each table of gains for cells after the first."""

_CRITICAL = 10
"""Rows of the table of critical tasks."""

_LONGEST_NAME = 150
"""Letters of a label in the name of a file; file systems allow some 250."""

Pieces = Iterator[str]


def write_report(result: StudyResult, progress: Report) -> None:
    """Draw the pictures of a study and write its report.

    Raises:
        OutputError: a file cannot be written.
    """
    cells = len(result.summary.cells)
    progress(DRAWING, 0, cells + 2)
    pieces = [*_first_page(result), *_whole_study(result)]
    progress(DRAWING, 1, cells + 2)
    for place, cell in enumerate(_in_order(result)):
        pieces += _cell(result, cell)
        progress(DRAWING, 2 + place, cells + 2)
    pieces += _made(result)
    title = f"{result.summary.scenario}: study"
    write_text(result.folder / REPORT, page(title, report_style(), pieces))
    progress(DRAWING, cells + 2, cells + 2)


def _in_order(result: StudyResult) -> list[int]:
    """Return the cells, first that of the policy that coordinates best."""
    first = shown_cell(result.summary, result.request.experiment.policies)
    return [first, *(k for k in range(len(result.loads)) if k != first)]


def _file_name(label: str) -> str:
    """Return a label as part of a file name, shortened with a hash."""
    name = re.sub(r"[^a-z0-9.]+", "-", label.lower()).strip("-")
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[:_LONGEST_NAME]}-{hashlib.sha256(label.encode()).hexdigest()[:8]}"


def report_style() -> str:
    """Return the style sheet of pages."""
    sheet = files("twin.studies.report").joinpath("report.css")
    return sheet.read_text(encoding="utf-8")


def _first_page(result: StudyResult) -> Pieces:
    """Yield results, gains, the cell, and assumptions."""
    request, summary = result.request, result.summary
    yield paragraph(replication_sentence(result))
    cell = shown_cell(result.summary, result.request.experiment.policies)
    scenario = apply_variation(request.scenario, summary.cells[cell].variant)
    subject = CheckContext(scenario, request.base)
    doubts = [*warnings(subject), *summary.warnings]
    doubts += [
        f"check off: {own['key']}: {own['check']}" for own in scenario.checks_off
    ]
    if doubts:
        yield paragraph(f"Warning: {' Warning: '.join(doubts)}", "warning")
    policies = len(request.experiment.policies)
    many = len(summary.cells) > _AT_ONCE
    yield from _layouts(result)
    start = cell - cell % policies
    shown = summary.cells[start : start + policies]
    yield makespans_table(summary, shown if many else None)
    if many:
        yield paragraph("The other variants are in a table further down.", "note")
    yield from _lines(result, cell)
    yield from _windows(summary)
    if any(own.operated for own in summary.cells):
        yield heading("What failures cost")
        yield paragraph(OPERATED, "note")
        yield operated_tables(summary)
    yield heading("What is worth fixing")
    yield paragraph(GAINS_NOTE, "note")
    yield gains_tables(
        result.gains[cell],
        summary.cells[cell].label,
        confidence=summary.confidence,
        most=LEADING,
    )
    if len(summary.cells) > 1:
        yield paragraph("The other policies and variants follow one by one.", "note")
    yield heading("The cell")
    yield save_and_embed_picture(
        result.folder, cell_figure(subject, width_in=WIDTH_IN), "cell"
    )
    yield heading("What it rests on")
    yield pairs(assumptions(result))


def _lines(result: StudyResult, cell: int) -> Pieces:
    """Yield throughput, takt and lateness, where several products are made."""
    summary = result.summary
    if not any(own.line for own in summary.cells):
        return
    yield heading("What the line achieves")
    yield lines_table(summary)
    yield lateness_list(summary)
    yield text_table("by variant", variant_rows(summary))
    words = "share of the time of robots and machines by state, and overall equipment effectiveness (OEE)"
    yield text_table(words, worker_rows(summary))
    times = study_product_times(result.folder / BLOCKS, cell)
    if times is not None:
        scenario = apply_variation(result.request.scenario, summary.cells[cell].variant)
        orders = orders_of(scenario)
        figure = draw_line(times, orders)
        yield save_and_embed_picture(result.folder, figure, "products")
        first = (
            seconds(times.product_begin_ns[:, 0]),
            seconds(times.product_end_ns[:, 0]),
        )
        words = "one replication"
        figure = products_figure(*first, orders.due_s, orders.variants, words)
        yield save_and_embed_picture(result.folder, figure, "products-gantt")


def _windows(summary: StudySummary) -> Pieces:
    """Yield statistics and cost of time windows, where there are any."""
    if any(cell.windows for cell in summary.cells):
        yield heading("Windows of time between steps")
        yield text_table(
            "time that passes from the end of the earlier step to the begin of the later one",
            window_rows(summary),
        )
        yield bullets("What holding back costs", holding_texts(summary))


def _layouts(result: StudyResult) -> Pieces:
    """Yield the ranking of layouts, and those without a plan."""
    summary, policies = result.summary, result.request.experiment.policies
    if summary.ranking:
        yield heading("Which layout")
        policy = preferred_policy(policies)
        yield ranking_table(summary, policy)
        yield save_and_embed_picture(
            result.folder, draw_ranking(summary, policy), "ranking"
        )
    yield refused_table(summary)


def _whole_study(result: StudyResult) -> Pieces:
    """Yield comparisons of policies and variants."""
    experiment, summary = result.request.experiment, result.summary
    policies = experiment.policies
    if len(summary.cells) > _AT_ONCE:
        yield heading("All policies and variants")
        yield makespans_table(summary)
    yield difference_list(summary)
    yield collision_lists(summary)
    blocks = result.folder / BLOCKS
    samples = [cell_makespans_s(blocks, cell) for cell in range(len(experiment.cells))]
    yield heading("How long it takes")
    yield save_and_embed_picture(
        result.folder, draw_ecdf(summary, samples, policies), "makespan"
    )
    for key in experiment.variants[0]:
        yield heading(f"What {key} does")
        name = "response-" + key.replace(".", "-")
        yield save_and_embed_picture(
            result.folder, draw_response(summary, key, policies), name
        )
    yield heading("How busy robots and machines are")
    words = "share of the time at work, standstills in it included"
    yield text_table(words, busy_rows(summary))
    yield heading("What the robots wait for")
    yield save_and_embed_picture(result.folder, draw_waits(summary), "waits")


def _cell(result: StudyResult, cell: int) -> Pieces:
    """Yield the details of one cell: tasks, sensitivities, and gains."""
    order = _in_order(result)
    found, load = result.summary.cells[cell], result.loads[cell]
    drawn, first = order.index(cell) < _DRAWN, cell == order[0]
    label = found.label
    name = _file_name(label)
    yield heading(f"What decides: {label}")
    if found.makespan_s is None:
        yield paragraph("No replication was completed.")
        return
    tally = cell_tally(result.folder / BLOCKS, cell)
    if not tally.count:
        yield paragraph("Every replication was replanned.")
        return
    if drawn:
        yield heading("When tasks are done, and which are critical", 3)
        yield save_and_embed_picture(
            result.folder, draw_bands(load.tpg, tally), f"gantt-{name}"
        )
    yield critical_tasks_table(load, tally, label, _CRITICAL)
    yield heading("Which inputs the makespan hangs on", 3)
    if drawn:
        figure = draw_tornado(found.tornado, found.makespan_s.estimate)
        yield save_and_embed_picture(result.folder, figure, f"tornado-{name}")
    yield tornado_table(found)
    if found.sobol:
        yield heading("Which inputs it hangs on when all vary at once", 3)
        yield save_and_embed_picture(result.folder, draw_sobol(found.sobol), "sobol")
        yield sobol_table(found)
    if not first:
        confidence = result.summary.confidence
        gains = result.gains[cell]
        yield heading("What is worth fixing", 3)
        yield gains_tables(gains, label, confidence=confidence, most=_LATER)


def _made(result: StudyResult) -> Pieces:
    """Yield how to repeat the study."""
    experiment = result.request.experiment
    design = {
        "policies": experiment.policies,
        "variants": experiment.variants,
        "replications": experiment.replications,
        "antithetic": experiment.antithetic,
        "engines": [_engine(cell) for cell in result.summary.cells],
    }
    yield heading("How it was made")
    yield f"<pre>{escape_text(json.dumps(design, indent=2, ensure_ascii=False))}</pre>"


def _engine(cell: CellSummary) -> dict[str, Any]:
    because = cell.event_engine_because
    own = {"cell": cell.label, "engine": cell.engine}
    return own | ({"because": because} if because else {})
