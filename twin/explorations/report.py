"""HTML report of a design exploration: one self-contained file with tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from twin.checks.finding import CheckContext
from twin.checks.picture import cell_figure
from twin.drawing.pictures import INK, bar_chart, legend_below, one_chart
from twin.explorations.dimensions import Dimension, variant_of
from twin.explorations.folder import REPORT
from twin.explorations.journal import TriedDesign
from twin.explorations.page_words import (
    BEST_HEAD,
    best_rows,
    describe_changes,
    describe_importances,
    rung_rows,
    single_rows,
    verdict,
)
from twin.explorations.rungs import ExplorationSetting
from twin.explorations.summary import ExploreSummary, RankedDesign
from twin.host.atomic_files import write_text
from twin.host.cards import pairs
from twin.host.progress import Report
from twin.scenario.variations import apply_variation
from twin.studies.report.markup import (
    escape_text,
    heading,
    page,
    paragraph,
    save_and_embed_picture,
    table,
    text_table,
)
from twin.studies.report.report import report_style

DRAWING = "report"
"""Name of the stage for progress displays."""

_CELLS = 3
"""Cells that are drawn side by side."""

_BLUE, _ORANGE, _RED, _GREY = "#2f6db5", "#d9822b", "#c23b54", "#a7afb9"

_CSS = (
    ".cells{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(560px,100%),1fr));gap:8px}"
    ".cells>div{min-width:0}"
    ".best th:last-child,.best td:last-child{text-align:left}"
    "@media(min-width:901px){.best td:not(:last-child){white-space:nowrap}}"
    ".why th:nth-child(3),.why td:nth-child(3){text-align:left}"
)

Pieces = Iterator[str]


def write_report(
    found: ExploreSummary,
    setting: ExplorationSetting,
    dimensions: Sequence[Dimension],
    folder: Path,
    progress: Report,
) -> None:
    """Draw the pictures of an exploration and write its report.

    Args:
        found: the findings.
        setting: common setting of all designs.
        dimensions: the varied keys.
        folder: of the files.
        progress: receives the progress.

    Raises:
        OutputError: a file cannot be written.
    """
    progress(DRAWING, 0, 1)
    pieces = [
        *_answers(found),
        *_cells(found, setting, dimensions, folder),
        *_pictures(found, dimensions, folder),
        *_refused(found),
        *_made(found, dimensions),
    ]
    title = f"{found.scenario}: which cell should it be"
    write_text(folder / REPORT, page(title, report_style() + _CSS, pieces))
    progress(DRAWING, 1, 1)


def _answers(found: ExploreSummary) -> Pieces:
    behind = sum(rung.behind for rung in found.rungs)
    left = f", and {behind} were left behind as too long" if behind else ""
    yield paragraph(
        f"{found.tried} designs were tried; {len(found.ranked)} of {len(found.rows)} different ones are"
        f" possible{left}. Looked for: {', '.join(g.words for g in found.section.goals)}."
    )
    if not found.ranked:
        yield paragraph("No design is possible; further down is why.", "warning")
        return
    if found.singles:
        caption = "single changes that gain most for their effort; intervals hold for all of them together"
        yield text_table(caption, single_rows(found), "best")
        return
    head, rows = best_rows(found)
    kind = (
        "the best compromises" if len(found.section.goals) > 1 else "the best designs"
    )
    share = f"{100 * found.section.confidence:g} %"
    yield table(
        f"{kind}, {share} intervals, same draws for all of them",
        [*BEST_HEAD, *head],
        [
            [escape_text(cell).replace(" mm", "&nbsp;mm") for cell in row]
            for row in rows
        ],
        "best",
    )
    for line in verdict(found):
        yield paragraph(f"{line}.")
    worths = list(describe_changes(found))
    if worths:
        yield heading("What it is worth")
        items = "".join(f"<li>{escape_text(line)}</li>" for line in worths)
        yield f"<ul>{items}</ul>"
        yield paragraph(
            "Each change of the best design was undone alone, planned and replicated: gains of several"
            " do not add up. Replications are none of those of the search, by which designs became finalists.",
            "note",
        )


def _cells(
    found: ExploreSummary,
    setting: ExplorationSetting,
    dimensions: Sequence[Dimension],
    folder: Path,
) -> Pieces:
    """Yield the best cells, side by side."""
    shown = (found.compromises or found.ranked)[:_CELLS]
    if not shown or found.singles:
        return
    yield heading("The best cells")
    parts = []
    for item in shown:
        scenario = apply_variation(
            setting.scenario, variant_of(dimensions, item.values)
        )
        subject = CheckContext(scenario, setting.folder)
        figure = cell_figure(subject, width_in=4.7, detail=False)
        figure.suptitle(f"#{item.rank}", color=INK, fontsize=12)
        words = paragraph(f"#{item.rank}: {item.label}", "note")
        drawn = save_and_embed_picture(folder, figure, f"cell-{item.rank}")
        parts.append(f"<div>{words}{drawn}</div>")
    yield f'<div class="cells">{"".join(parts)}</div>'
    yield paragraph(f"twin init PATH --from {folder}#1 writes the first as a scenario.")


def _pictures(
    found: ExploreSummary, dimensions: Sequence[Dimension], folder: Path
) -> Pieces:
    if len(found.section.goals) > 1 and found.compromises:
        yield heading("Compromises")
        yield save_and_embed_picture(folder, _front(found), "front")
    yield heading("How the search went")
    yield save_and_embed_picture(folder, _course(found), "search")
    if found.importances:
        yield heading("What matters")
        yield paragraph(
            "Of the variance of the ranks of designs by the first goal, the share that lies between designs"
            " with different values of a key, or in different quarters of its numbers. A search looks more"
            " often where it is good: the shares are those of the designs that it tried.",
            "note",
        )
        yield save_and_embed_picture(folder, _importance(found), "importance")
        for line in describe_importances(found):
            yield paragraph(f"{line}.")
    numbers = [one for one in dimensions if one.low is not None]
    order = {item.key: place for place, item in enumerate(found.importances)}
    numbers.sort(key=lambda one: order.get(one.key, len(order)))
    if len(numbers) > 1 and not found.singles:
        yield heading("Where designs are possible")
        yield save_and_embed_picture(folder, _map(found, numbers[0], numbers[1]), "map")


def _refused(found: ExploreSummary) -> Pieces:
    yield heading("How far designs got")
    yield text_table("by rung", rung_rows(found))
    reasons = [
        [
            escape_text(item.rung),
            str(item.count),
            escape_text(item.reason),
            str(item.design),
        ]
        for item in found.refusals
    ]
    yield table(
        "why designs are refused, the first of each kind in its words",
        ["rung", "designs", "reason", "first"],
        reasons,
        "why",
    )


def _made(found: ExploreSummary, dimensions: Sequence[Dimension]) -> Pieces:
    section = found.section
    yield heading("What it rests on")
    rows = [(one.key, _range(one)) for one in dimensions]
    rows += [("constraint", words) for words in section.constraints]
    rows += [
        ("sampler", section.chosen_sampler),
        ("replications in the search", str(section.replications)),
        ("replications of finalists, at most", str(section.most_replications)),
    ]
    yield pairs(rows)


def _range(one: Dimension) -> str:
    if one.low is not None:
        linked = [key for key, _ in (*one.moves, *one.mirrors)]
        also = f", with {', '.join(linked)}" if linked else ""
        return f"{one.low:g} to {one.high:g}, in the scenario {one.base}{also}"
    if one.ordered:
        return "any order"
    return f"{', '.join(map(str, one.choices))}, in the scenario {one.base}"


def _course(found: ExploreSummary) -> Figure:
    """Draw the first goal of each design as it was tried, and the best so far."""
    figure, axes = one_chart(3.6)
    goal = found.section.goals[0]
    done = [row for row in found.rows if row.done]
    behind = [row for row in found.rows if row.evaluation.outcome == "behind"]
    refused = [row for row in found.rows if row.evaluation.outcome == "refused"]
    for rows, colour, words in (
        (done, _BLUE, "possible"),
        (behind, _ORANGE, "left behind, as estimated"),
    ):
        if rows:
            values = [goal.sign * row.evaluation.goals[0] for row in rows]
            numbers = [row.design for row in rows]
            axes.scatter(numbers, values, color=colour, s=16, label=words)
    if done:
        ordered = sorted(done, key=lambda row: row.design)
        best = np.minimum.accumulate([row.evaluation.goals[0] for row in ordered])
        steps = [row.design for row in ordered]
        axes.step(steps, goal.sign * best, where="post", color=INK, label="best so far")
    if refused:
        at = axes.get_ylim()[0 if goal.sign < 0 else 1]
        numbers = [row.design for row in refused]
        axes.scatter(
            numbers, [at] * len(numbers), marker="x", color=_RED, s=16, label="refused"
        )
    axes.set_xlabel("design", color=INK)
    axes.set_ylabel(goal.expression.text, color=INK)
    legend_below(axes)
    return figure


def _front(found: ExploreSummary) -> Figure:
    """Draw designs by the first two goals, with the compromises."""
    figure, axes = one_chart(4.2)
    first, second = found.section.goals[:2]

    def points(items: Sequence[RankedDesign]) -> tuple[list[float], list[float]]:
        return [i.goals[0] for i in items], [i.goals[1] for i in items]

    others = [item for item in found.ranked if not item.compromise]
    axes.scatter(*points(others), color=_GREY, s=16, label="other designs")
    best = sorted(found.compromises, key=lambda item: item.goals[:2])
    # Between two compromises there is what the worse one has, nothing in the middle.
    steps = "steps-post" if first.sign > 0 else "steps-pre"
    axes.plot(
        *points(best),
        "o-",
        drawstyle=steps,
        color=_BLUE,
        markersize=5,
        label="compromises",
    )
    for item in best:
        axes.annotate(
            f"#{item.rank}",
            (item.goals[0], item.goals[1]),
            (5, 4),
            textcoords="offset points",
            fontsize=8,
            color=INK,
        )
    if found.base is not None:
        axes.scatter(
            *points([found.base]), marker="*", s=90, color=_ORANGE, label="as it is"
        )
    axes.set_xlabel(first.words, color=INK)
    axes.set_ylabel(second.words, color=INK)
    legend_below(axes)
    return figure


def _importance(found: ExploreSummary) -> Figure:
    items = found.importances[:12]
    figure, axes = bar_chart([item.key for item in items], 0.3)
    for place, item in enumerate(items):
        share = item.share
        axes.barh(place, share.estimate, color=_BLUE, height=0.6)
        axes.plot([share.low, share.high], [place, place], color=INK, linewidth=1.2)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of differences, with its interval", color=INK)
    return figure


def _map(found: ExploreSummary, across: Dimension, up: Dimension) -> Figure:
    """Draw feasible designs with their goals, and the rungs at which others are refused."""
    figure, axes = one_chart(4.6)
    done = [row for row in found.rows if row.done]

    def points(rows: Sequence[TriedDesign]) -> tuple[list[float], list[float]]:
        keys = across.key, up.key
        xs, ys = ([float(row.values[key]) for row in rows] for key in keys)
        return xs, ys

    if done:
        values = np.array([row.evaluation.goals[0] for row in done])
        goal = found.section.goals[0]
        # A tenth of them may be so bad that all others would look alike.
        low, high = np.sort(goal.sign * np.quantile(values, [0.0, 0.9])).tolist()
        shown = axes.scatter(
            *points(done), c=goal.sign * values, s=30, cmap="viridis", label="possible"
        )
        shown.set_clim(low, high)
        beyond = "max" if goal.sign > 0 else "min"
        figure.colorbar(shown, ax=axes, label=goal.expression.text, extend=beyond)
    rungs = dict.fromkeys(item.rung for item in found.refusals)
    marks = ("x", "+", "1", "2", "3", "4")
    for rung, mark in zip(rungs, marks, strict=False):
        rows = [
            row
            for row in found.rows
            if row.evaluation.outcome == "refused" and row.evaluation.rung == rung
        ]
        axes.scatter(*points(rows), marker=mark, color=_RED, label=f"refused: {rung}")
    if across.base is not None and up.base is not None:
        base = [across.base], [up.base]
        axes.scatter(*base, marker="*", s=90, color=_ORANGE, label="as it is")
    axes.set_xlabel(across.key, color=INK)
    axes.set_ylabel(up.key, color=INK)
    legend_below(axes)
    return figure
