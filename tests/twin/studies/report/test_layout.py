"""Pictures of a study: everything lies within the picture, and nothing on anything else; its tables."""

import html
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from tests.twin.studies.study_toys import toy_cell_summary, toy_summary, toy_workload
from tests.twin.twin_toys import random_tpg
from twin.runs.policies import NAMED_POLICIES
from twin.studies.replications.experiment import Block
from twin.studies.replications.statistics import Interval
from twin.studies.replications.workload import Engines
from twin.studies.report.cell_figures import draw_bands, draw_sobol, draw_tornado
from twin.studies.report.figures import draw_ecdf, draw_response, draw_waits
from twin.studies.report.markup import escape_text, picture
from twin.studies.report.page_tables import makespans_table
from twin.studies.report.sensitivity_tables import sobol_table, tornado_table
from twin.studies.sensitivity import Influence, SobolIndex
from twin.studies.summary import StudySummary

LONG = "breakdowns.of_a_robot_with_a_rather_long_name"


def texts(figure: Figure) -> list[tuple[str, Bbox]]:
    """Return all that is written in a picture and where it stands.

    Ticks beyond the ends of an axis have names that are not drawn.
    """
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer: Any = canvas.get_renderer()
    beyond = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not low <= tick.get_loc() <= high:
                    beyond |= {tick.label1, tick.label2}
    return [
        (item.get_text(), item.get_window_extent(renderer))
        for item in figure.findobj(Text)
        if isinstance(item, Text)
        and item not in beyond
        and item.get_text().strip()
        and item.get_visible()
    ]


def assert_legible(figure: Figure) -> None:
    """Everything written lies within the picture, and no two texts on each other."""
    found = texts(figure)
    whole = figure.bbox
    for words, box in found:
        assert box.x0 >= whole.x0 - 1, words
        assert box.x1 <= whole.x1 + 1, words
        assert box.y0 >= whole.y0 - 1, words
        assert box.y1 <= whole.y1 + 1, words
    for (one, first), (two, second) in combinations(found, 2):
        shared = Bbox.intersection(first.padded(-1), second.padded(-1))
        assert shared is None or shared.width * shared.height < 1, (one, two)


def summary_of(
    variants: int, policies: int = 7, deadline_s: float | None = None
) -> StudySummary:
    waits = {"wait_dependency_s": 10.0, "wait_other_s": 0.0}
    cells = [
        toy_cell_summary(
            policy,
            {LONG: 100.0 * k, "stalls.rate_per_h": 30},
            Interval(90.0 + k, 89.0, np.inf, 100),
            wait_s={**waits, "wait_conflict_s": 20.0 + k},
        )
        for k in range(variants)
        for policy in list(NAMED_POLICIES)[:policies]
    ]
    return toy_summary(cells, deadline_s=deadline_s)


@pytest.mark.nightly
@pytest.mark.parametrize(("variants", "policies"), [(1, 7), (3, 2), (6, 7)])
def test_comparisons_are_legible(variants: int, policies: int) -> None:
    summary = summary_of(variants, policies, 95.0)
    names = list(NAMED_POLICIES)[:policies]
    rng = np.random.default_rng(0)
    samples = [rng.normal(90.0, 3.0, 200) for _ in summary.cells]
    for figure in (
        draw_ecdf(summary, samples, names),
        draw_waits(summary),
        draw_response(summary, LONG, names),
    ):
        assert_legible(figure)
        for legend in figure.findobj(Legend):
            box = legend.get_window_extent()
            axes = figure.axes[0].get_tightbbox()
            assert axes is not None
            assert box.y1 <= axes.y0 + 1
            assert figure.bbox.x0 - 1 <= box.x0 <= box.x1 <= figure.bbox.x1 + 1
        assert figure.axes[0].get_window_extent().height > 100


def test_every_line_of_a_chart_differs_from_every_other() -> None:
    figure = draw_ecdf(summary_of(6), [np.arange(5.0)] * 42, list(NAMED_POLICIES))
    styles = {(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
    assert len(styles) == 42


def test_tornado_and_sobol_are_legible() -> None:
    names = [f"motions of {LONG}_{k}" for k in range(20)]
    found = [
        Influence(
            name=name,
            less_s=Interval(k - 20.0, k - 22.0, k - 19.0, 200),
            more_s=Interval(20.0 - k, -np.inf, np.inf, 1),
        )
        for k, name in enumerate(names)
    ]
    assert_legible(draw_tornado(found, 1234.5))
    share = Interval(0.1, -0.05, 0.3, 64)
    indices = [SobolIndex(name=name, first=share, total=share) for name in names]
    assert_legible(draw_sobol(indices))
    cell = toy_cell_summary("asynchronous", {}, share, tornado=found, sobol=indices)
    table = tornado_table(cell)
    assert table.count("<tr>") == 21
    assert "<span>-20.0</span>" in table
    assert f'<span class="interval">{unbroken("-22.0 to -19.0")}</span>' in table
    assert f">{unbroken('-0.05 to 0.30')}</span>" in sobol_table(cell)


@pytest.mark.parametrize("tasks", [2, 14, 150])
def test_bands_are_legible(tasks: int) -> None:
    tpg = random_tpg(1, dofs=(2, 2, 3), tasks=max(tasks, 3), edges=tasks)
    load = replace(toy_workload(1), tpg=tpg)
    tally = Engines(load).compute(Block(0, 0, 30)).tally
    assert_legible(draw_bands(load.tpg, tally))


def _makespans(variants: int) -> StudySummary:
    cells = [
        toy_cell_summary(
            policy,
            {"stalls.rate_per_h": k},
            Interval(100.04, 99.96, np.inf, 100),
            makespan_p50_s=Interval(100.04, 99.96, 101.5, 100),
        )
        for k in range(variants)
        for policy in ("sequential", "asynchronous")
    ]
    return toy_summary(cells)


def test_a_table_has_the_rows_that_are_asked_for_and_long_names_may_be_broken() -> None:
    summary = _makespans(5)
    assert makespans_table(summary).count("<tr>") == 1 + 10
    assert makespans_table(summary, summary.cells[:2]).count("<tr>") == 1 + 2
    found = makespans_table(_makespans(1))
    assert "<th>stalls.<wbr>rate_<wbr>per_<wbr>h</th>" in found
    for words in ("at least 100.0", "100.0 to 101.5"):
        interval = f'<span class="interval">{unbroken(words)}</span>'
        assert f"<span>100.0</span><br>{interval}" in found
    assert f"{unbroken('90 %')} intervals" in found
    assert "<td>-</td>" in found  # no P90


def unbroken(words: str) -> str:
    return words.replace(" ", "\u00a0")


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        ("mean +12.3 s (-1.5 to 0.25), n", ("+12.3 s", "-1.5 to 0.25")),
        ("at 95 % 3 % to 7.5 % of all", ("95 %", "3 % to 7.5 %")),
        ("12.3 ± 0.4 in 3 steps to 4 seconds", ("12.3 ± 0.4",)),
        ("<9 mm> at least 3", ("9 mm", "at least 3")),
    ],
)
def test_intervals_and_units_stay_on_one_line(
    words: str, kept: tuple[str, ...]
) -> None:
    expected = html.escape(words)
    for own in kept:
        expected = expected.replace(own, unbroken(own))
    assert escape_text(words) == expected


def test_a_picture_is_as_wide_as_its_smallest_text_needs() -> None:
    figure = Figure(figsize=(5.0, 1.0))
    figure.text(0.1, 0.5, "large", fontsize=12)
    figure.text(0.5, 0.5, "small", fontsize=6)
    figure.text(0.9, 0.5, "", fontsize=1)
    # 360 points, and 6 of them are to be 10 pixels.
    assert '<svg style="min-width:600px" ' in picture(figure, "small")
