"""Tables of the sensitivity of the makespan: gains of interventions, effects of inputs, and Sobol indices."""

from __future__ import annotations

from collections.abc import Sequence

from twin.studies.gains.gains import QUANTILE, SHORTER, CellGains, Gain
from twin.studies.report.estimates import format_estimate
from twin.studies.report.markup import escape_text, paragraph, table
from twin.studies.sensitivity import SHARE
from twin.studies.summary import CellSummary

KINDS = {"stall": "standstill", "message": "messages"}
"""Names of kinds of interventions in the report, where they differ from those in files."""

_LEAST_S = 0.005
"""Least mean gain that gets a row in a table [s]."""

LESS = f"{100 * SHORTER:.0f} % shorter"
P90 = f"P{100 * QUANTILE:.0f}"

GAINS_NOTE = (
    "Seconds by which the last part would be in its place sooner if one thing took a fifth less time,"
    " or no time, and all other draws stayed the same: the same replications were executed again with"
    " that one thing changed. What robots do after their last work, such as going HOME, counts in the"
    " makespan but not here. These are gains of the model, and only as good as its times. The model"
    " does not know whether something can be made shorter, or what that costs. Gains of several"
    " things do not add up, and robots are never reassigned or replanned. Where a wait is removed,"
    " the robot does not wait, whatever is in its way: no better plan could achieve more."
)
"""Note below the tables of gains."""


def gains_tables(cell: CellGains, label: str, *, confidence: float, most: int) -> str:
    """Return the greatest gains of a cell: single interventions, then joint ones."""
    if cell.replications == 0:
        return paragraph(
            f"{label}: nothing was tried. No replication was completed, or the event engine would"
            " take longer for it than for the study; more replications give it more time."
        )
    share = f"{100 * confidence:g} %"
    made = f"seconds gained with {share} intervals, {cell.replications} replications"
    tables = []
    for what, many in (("one thing", False), ("many at once", True)):
        found = cell.best(most, many=many)
        shown = [gain for gain in found if gain.gone.mean_s.estimate >= _LEAST_S]
        tables.append(_table(f"{label}: {what}, {made}", shown))
    if not any(tables):
        return paragraph(f"{label}: nothing that was tried gains anything.")
    rest = len(cell.gains) - sum(len(cell.best(most, many=m)) for m in (False, True))
    return "".join(tables) + (
        paragraph(f"{rest} more are in gains.csv.", "note") if rest else ""
    )


def _table(caption: str, gains: Sequence[Gain]) -> str:
    """Return gains as a table; empty if there are none."""
    head = ["", "", "what", f"mean, {LESS}", f"{P90}, {LESS}", "mean, gone"]
    longest = max([gain.shorter.mean_s.estimate for gain in gains], default=0.0)
    rows = []
    for rank, gain in enumerate(gains, start=1):
        width = 100.0 * max(gain.shorter.mean_s.estimate, 0.0) / max(longest, 1e-12)
        bar = f'<div class="bar" style="width:{width:.0f}%"></div>'
        kind = f'<span class="kind">{KINDS.get(gain.intervention.kind, gain.intervention.kind)}</span>'
        row = [str(rank), kind, escape_text(gain.intervention.name) + bar]
        for saving in (gain.shorter, gain.gone):
            row += [format_estimate(one) for one in (saving.mean_s, saving.p90_s)]
        rows.append(row)
    return table(caption, [*head, f"{P90}, gone"], rows, "gains")


def tornado_table(cell: CellSummary) -> str:
    """Return the effect of each input on the mean makespan, with intervals."""
    share = f"{100 * SHARE:.0f} %"
    return table(
        f"{cell.label}: change of the mean makespan [s], the same draws",
        ["input", f"{share} less", f"{share} more"],
        [
            [escape_text(o.name), format_estimate(o.less_s), format_estimate(o.more_s)]
            for o in cell.tornado
        ],
        "named",
    )


def sobol_table(cell: CellSummary) -> str:
    """Return the Sobol indices of the inputs, with intervals."""
    return table(
        f"{cell.label}: share in the variance of the mean makespan",
        ["input", "alone", "alone and together with others"],
        [
            [escape_text(o.name), format_estimate(o.first), format_estimate(o.total)]
            for o in cell.sobol
        ],
        "named",
    )
