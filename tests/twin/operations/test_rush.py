"""Rush orders: products that are ordered while others are made come next of those that are not begun."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from benchmarks.operate import audited
from tests.planted import rows
from tests.twin.operations.operated import (
    operated,
    operated_by_program,
    planned,
    require_kept,
    require_resumed,
    require_safe,
)
from tests.twin.planning.test_variants import BOTH, mix
from tests.twin.written import loaded, refusal
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.section import PartsSection
from twin.throughput.throughput import run_product_times, seconds
from twin.trial.header import line_orders
from twin.trial.loaded_scenario import load

FEW = {"planning.shortcut_candidates": 0, "recovery.shortcuts": 0}
LONG = {"at_s": 5.0, "variant": "long", "due_s": 50.0}


def rushed(folder: Path, **products: Any) -> Path:
    """Return the file of two short kits, and a rush order of a long one."""
    order = ["short", "short", "long"]
    own = {"count": 2, "order": order, "due": [40.0, 60.0], "rush": [LONG]}
    return mix(folder, variants=BOTH, **(own | products))


def short_of(file: Path) -> Path:
    """Return the file without bolts and seals, so that little is planned."""
    document = yaml.safe_load(file.read_text())
    own = document["assembly"]
    own["steps"] = own["steps"][:2]
    own["parts"] = [p for p in own["parts"] if p["name"] in ("carrier", "nut")]
    own["sources"] = {name: own["sources"][name] for name in ("belt", "nuts")}
    file.write_text(yaml.safe_dump(document, sort_keys=False))
    return file


WRONG = rows(r"""
change                                                    | at                    | says
products.rush: [{variant: long, due_s: 9}]                | variant: long         | key 'at_s' is missing
products.rush: [{at_s: -1, variant: long, due_s: 9}]      | at_s: -1              | must be at least 0, not -1
products.rush: [{at_s: .inf, variant: long, due_s: 9}]    | at_s: .inf            | a finite number expected
products.rush: [{at_s: 1, count: 0, variant: long}]       | count: 0              | must be at least 1, not 0
products.rush: [{at_s: 1, varient: long}]                 | varient: long         | unknown key 'varient'; did you mean 'variant'?
products.rush: [{at_s: 1, variant: lang, due_s: 9}]       | count: 2              | the variant of each of rush must be one of short, long
products.rush: [{at_s: 1, due_s: 9}]                      | count: 2              | the variant of each of rush must be one of short, long
products.rush: [{at_s: 1, variant: long}]                 | count: 2              | give each of rush due_s where products are due
products.due: null                                        | count: 2              | give each of rush due_s where products are due, and else none
products.rush: 3                                          | rush: 3               | a list [..] expected, not 3
products.rush_after: [-1]                                 | - -1                  | must be at least 0, not -1
changeovers: [{duration: 5}]                              | - duration: 5         | leave it or products.rush out
parts.3.source: nuts; sources.seals: null                 | kind: feeder          | give each part a source of its own, or leave rush out
steps.1.after: [{step: carrier, at_least_s: 3}]           | place: nut            | least times and doors are of all variants, or leave rush out
steps.1.name: screwed; steps.2: {place: bolt, after: [{step: screwed, at_least_s: 3}]} | place: bolt | least times and doors are of all variants
processes: {baking: {duration: {kind: fixed, value_s: 3}, machine: oven}}; machines: {oven: {capacity: 2}} | - at_s: 5.0 | no batch is rushed: leave rush out, or write capacity: 1
execution.changes: [{at_s: 4, drop: [2]}]                 | - 2                   | leave drop or assembly.products.rush out
""")


@pytest.mark.parametrize(("change", "at", "says"), WRONG)
def test_what_cannot_be_rushed_is_said(
    tmp_path: Path, change: str, at: str, says: str
) -> None:
    document = yaml.safe_load(rushed(tmp_path).read_text())
    for one in change.split("; "):
        key, _, value = one.partition(": ")
        own = key if key.startswith("execution") else f"assembly.{key}"
        place, item = own.split("."), document
        for name in place[:-1]:
            item = item[int(name) if isinstance(item, list) else name]
        last: Any = int(place[-1]) if isinstance(item, list) else place[-1]
        item[last] = yaml.safe_load(value)
    own = document["assembly"]["sources"]
    document["assembly"]["sources"] = {k: v for k, v in own.items() if v}
    found = refusal(tmp_path, yaml.safe_dump(document, sort_keys=False))
    (problem,) = found.problems
    assert says in problem.message
    line = found.lines[problem.mark.line - 1].strip()
    assert line.removeprefix("- ") == at.removeprefix("- ")


def taken(section: PartsSection, source: str) -> list[str]:
    """Return the names of the parts of a source in the order in which steps pick them."""
    found = []
    for step in write_out_line(section, whole=True).section.steps:
        base = (step.place or "").partition(".")[0]
        if source in next(p.sources for p in section.parts if p.name == base):
            found.append(str(step.place))
    return found


@settings(max_examples=12, deadline=None)
@given(
    order=st.lists(st.sampled_from(["short", "long"]), min_size=1, max_size=6),
    rush=st.lists(st.sampled_from(["short", "long"]), min_size=1, max_size=3),
    spare=st.integers(0, 2),
    data=st.data(),
)
def test_sources_serve_the_same_parts_in_whichever_order_products_are_made(
    tmp_path_factory: pytest.TempPathFactory,
    order: list[str],
    rush: list[str],
    spare: int,
    data: st.DataObject,
) -> None:
    """Compare with lists: what the sources hold is as before, and so are all products before the rush."""
    both = BOTH if {*order} == {*BOTH} else {order[0]: {}}
    rush = [name if name in both else order[0] for name in rush]
    file = mix(
        tmp_path_factory.mktemp("rush"),
        **{"count": len(order) + 1, "order": order, "spare": spare, "variants": both},
        rush=[{"at_s": k, "variant": own} for k, own in enumerate(rush)],
        steps=["carrier", "nut", "bolt", "seal"]
        if len(both) == 1
        else ["carrier", {"place": "nut", "variants": ["long"]}, "bolt", "seal"],
    )
    kind = loaded(file.parent, file.read_text()).kind.written_out()
    count = len(order) + 1 + spare
    after: list[int] = []
    for _ in range(data.draw(st.integers(1, len(rush)))):
        after.append(data.draw(st.integers((after or [-1])[-1] + 1, count)))
        count += 1
    first, then = kind.with_rush(()), kind.with_rush(tuple(after))
    parts = [
        {(o.name, o.start.tobytes(), o.later) for o in own.objects()}
        for own in (first, then)
    ]
    assert parts[0] == parts[1]
    assert first.machines() == then.machines()
    for source in ("belt", "bolts", "nuts", "seals"):
        names = taken(then.section, source)
        assert names == [
            f"{names[0].partition('.')[0]}.{k}" for k in range(1, len(names) + 1)
        ]
        assert names == taken(first.section, source)
    # The order of the numbers, by insertion into a list.
    numbers = [*range(1, len(order) + 2)]
    numbers += range(len(order) + 2 + len(rush), len(order) + 2 + len(rush) + spare)
    for number, before in enumerate(after, start=len(order) + 2):
        numbers.insert(before, number)
    ends = [0, *then.product_ends()]
    assert [then.product_of(end) for end in ends[1:]] == numbers
    variants = [*first.variants()]
    assert variants[len(order) + 1 :][: len(rush)] == rush
    begun = then.product_ends()[after[0] - 1] if after[0] else 0
    steps = [
        write_out_line(own.section, whole=True).section.steps for own in (first, then)
    ]
    assert steps[0][:begun] == steps[1][:begun]
    lengths = [b - a for a, b in zip(ends, ends[1:], strict=False)]
    own = [3 + (variants[k - 1] == "long" or len(both) == 1) for k in numbers]
    assert lengths == own


def test_a_rush_order_comes_next_and_its_lateness_is_reported(tmp_path: Path) -> None:
    plan = planned(short_of(rushed(tmp_path)), **FEW)
    done, _ = operated(plan, 1)
    require_kept(done)
    assert done.rush_after == (1,)
    assert [version.cause.partition(";")[0] for version in done.versions] == [
        "1 rush product wanted"
    ]
    case = plan.scenario.varied({"assembly.products.rush_after": [1]})
    assert audited(done, case) == []
    due_s, _, variants, _ = line_orders(replace(plan, scenario=case))
    assert (due_s, variants) == ((40.0, 60.0, 50.0), ("short", "short", "long"))
    times = run_product_times(done.tpg, done.record, len(due_s))
    assert times is not None
    end = seconds(times.product_end_ns)[:, 0]
    assert np.argsort(end).tolist() == [0, 2, 1]
    placed = [t.object for t in done.tpg.tasks if t.kind == "place-down"]
    assert placed == ["carrier.1", "carrier.2", "nut.1", "carrier.3"]


@pytest.mark.nightly
def test_the_program_executes_rush_orders_and_continues_from_them(
    tmp_path: Path,
) -> None:
    file, out = rushed(tmp_path), tmp_path / "run"
    _, summary = operated_by_program(file, out)
    assert summary["operation"]["rush_after"] == [1]
    assert summary["line"]["products"] == 3
    assert summary["line"]["due"]["service_level"] > 0.3
    require_resumed(out)
    left = twin.plan(world=f"{out}@{0.6 * summary['makespan_s']}")
    require_safe(left.tpg)
    went = twin.run(left, out=tmp_path / "went-on", recording=False)
    assert (went.outcome, went.summary["audit"]["violations"]) == ("completed", [])


@pytest.mark.nightly
def test_a_study_with_rush_orders_replans_by_itself(tmp_path: Path) -> None:
    case = load(rushed(tmp_path)).varied(FEW)
    study = twin.study(case, replications=3, out=tmp_path / "study")
    assert study.summary["closed_loop"]
    (cell,) = study.summary["cells"]
    assert cell["line"]["products"] == 3
