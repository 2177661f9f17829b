"""Products of several variants: their sequence, what is written out of them, and their plans."""

import json
from bisect import bisect_left
from collections import Counter
from itertools import accumulate
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.tasks.assembly import Assembly
from planning.tasks.task_graph import task_graph
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.assembly_section import assembly_section
from tests.planted import planted
from tests.twin.operations.operated import operated, require_safe
from tests.twin.planning.test_lines import KITTING, planned
from tests.twin.written import refusal, written
from twin.audits.expectations import scenario_expectations
from twin.host.progress import StageWatch
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.variants import repeated_sequence, sequence_by_shares
from twin.planning.pipeline import plan_motions
from twin.reading.scenario_file import load_scenario
from twin.runs.execution_record import ExecutionRecord
from twin.runs.summary import summarize_run
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.throughput.throughput import line_summary
from twin.trial.loaded_scenario import load
from twin.trial.planning import plan_scenario
from twin.trial.simulation import execute

TENDING = KITTING.with_name("machine_tending.yaml")
TRAY = {
    "kind": "tray",
    "pose": {"xyz_m": [-0.35, -0.37, 0.075]},
    "grid": {"counts": [1, 2], "pitch_m": [0.05, 0.06]},
    "refill_s": 3.0,
}
STEPS = ["carrier", {"place": "nut", "variants": ["long"]}, "bolt", "seal"]
"""Kits with and without a nut."""

BOTH: dict[str, Any] = {"short": {}, "long": {}}


def mix(
    folder: Path,
    *,
    steps: list[Any] = STEPS,
    assembly: dict[str, Any] | None = None,
    **products: Any,
) -> Path:
    """Return the file of the kitting line with kits of two variants and bolts from a tray."""
    document = yaml.safe_load(KITTING.read_text())
    document["planning"]["shortcut_candidates"] = 100
    document["assembly"]["sources"]["bolts"] = TRAY
    document["assembly"]["steps"] = steps
    own = {"leave_s": 1.0, "variants": {"short": 0.7, "long": 0.3}}
    document["assembly"]["products"] = {"count": 4, **own, **products}
    document["assembly"] |= assembly or {}
    return written(folder, yaml.safe_dump(document, sort_keys=False))


def section_of(scenario: Scenario) -> PartsSection:
    return assembly_section(scenario, PartsSection)


@given(
    st.dictionaries(st.sampled_from("abcd"), st.floats(0, 5), min_size=1),
    st.integers(0, 30),
    st.integers(0, 2**63 - 1),
)
@example({"a": 5e-324, "b": 0.0}, 5, 0)
@settings(max_examples=30, deadline=None)
def test_a_drawn_sequence_is_that_of_fewer_products_and_more(
    shares: dict[str, float], count: int, seed: int
) -> None:
    if not sum(shares.values()):
        shares["e"] = 1.0
    found = sequence_by_shares(shares, count, seed)
    assert found == sequence_by_shares(shares, 40, seed)[:count]
    assert all(shares[name] > 0.0 for name in found)


def test_variants_are_drawn_by_their_shares() -> None:
    counts = Counter(sequence_by_shares({"a": 14, "none": 0, "b": 6}, 5000, 1))
    # Within four standard deviations of a binomial.
    assert abs(counts["a"] - 3500) < 4 * np.sqrt(5000 * 0.7 * 0.3)
    assert counts["a"] + counts["b"] == 5000
    assert repeated_sequence("aab", 7) == tuple("aabaaba")


@given(st.lists(st.sampled_from(["short", "long"]), min_size=1, max_size=9), st.data())
@settings(max_examples=15, deadline=None)
def test_sources_serve_in_the_order_of_the_sequence(
    sequence: list[str], data: st.DataObject
) -> None:
    document = yaml.safe_load(KITTING.read_text())["assembly"]
    steps = [
        {"place": name, "variants": own} if own else name
        for name in ("carrier", "bolt", "nut", "seal")
        for own in [data.draw(st.sampled_from([None, ["long"]]))]
    ]
    document["sources"]["bolts"] = TRAY
    for part in document["parts"][1:3]:  # both from the tray
        part["source"] = "bolts"
    products = {"count": len(sequence), "order": sequence}
    document |= {"steps": ["carrier", *steps[1:]], "products": products}
    products["variants"] = {name: {} for name in sequence}
    line = write_out_line(PartsSection.model_validate_json(json.dumps(document)))
    wanted, later, refills = list[str](), set[str](), dict[int, str]()
    slot, emptied = 0, 0
    tray = ["bolt", "nut"]
    for product, variant in enumerate(sequence, start=1):
        for step in document["steps"]:
            name = step if isinstance(step, str) else step["place"]
            if not isinstance(step, str) and variant not in step["variants"]:
                continue
            wanted.append(f"{name}.{product}")
            if name in tray:
                if slot >= 2:
                    later.add(wanted[-1])
                if slot >= 2 and slot % 2 == 0:
                    refills[emptied] = wanted[-1]
                slot, emptied = slot + 1, len(wanted)
    assert [step.place for step in line.section.steps] == wanted
    assert {n for n in line.later if n.split(".")[0] in tray} == later
    found = {k: refill.parts[0][0] for k, refill in line.supply.refills.items()}
    own = {k: name for k, name in found.items() if name.split(".")[0] in tray}
    assert own == refills
    assert [f"{n}" for n, _ in line.origins] == [name.split(".")[1] for name in wanted]
    for refill in line.supply.refills.values():
        assert len(refill.parts) <= 2


def test_one_variant_is_written_out_as_a_line_without_variants(tmp_path: Path) -> None:
    def line(**products: Any) -> Any:
        file = mix(tmp_path, steps=["carrier", "nut", "bolt", "seal"], **products)
        found = write_out_line(section_of(load_scenario(file)), whole=True)
        return found, found.section.model_dump(exclude={"products"})

    with_variant, one = line(count=5, variants={"only": 1})
    without, other = line(count=5, variants={})
    assert one == other
    same = ("supply", "later", "period", "origins", "numbers", "jobs")
    for key in same:
        assert str(getattr(with_variant, key)) == str(getattr(without, key))


def test_what_refers_to_steps_of_other_variants_does_not_count(tmp_path: Path) -> None:
    steps = [
        "carrier",
        {"place": "nut", "variants": ["long"]},
        {"place": "bolt", "after": ["nut", "carrier"], "until": "seal"},
        {"place": "seal", "variants": ["long"]},
    ]
    pairs = {
        "joined": [["carrier", "nut"], {"parts": ["carrier", "bolt"], "by": "seal"}],
        "fits": [{"parts": ["nut", "bolt"], "press_m": 0.001}],
    }
    own = section_of(load_scenario(mix(tmp_path, steps=steps, assembly=pairs)))
    short, long = own.of_variant("short"), own.of_variant("long")
    assert [[x.step for x in step.follows] for step in short.steps] == [[], ["carrier"]]
    assert short.steps[1].until is None
    assert not short.joined
    assert not short.fits
    assert [[x.step for x in step.follows] for step in long.steps][2] == [
        "nut",
        "carrier",
    ]
    assert long.steps[2].until == "seal"
    assert (len(long.joined), len(long.fits)) == (2, 1)


class Steps(Assembly):
    """An assembly of products of different lengths, of which only the numbers of steps are known."""

    steps = 0
    built = None

    def expand(self, *_: Any) -> Any:
        raise NotImplementedError


@given(st.lists(st.integers(1, 4), min_size=1, max_size=6), st.integers(0, 25))
@settings(max_examples=40, deadline=None)
def test_products_are_counted_by_their_steps(lengths: list[int], count: int) -> None:
    ends = list(accumulate(lengths))
    product_of = [k for k, n in enumerate(lengths) for _ in range(n)]
    own = Steps(None, product_ends=ends)  # type: ignore[arg-type]
    own.__dict__["steps"] = ends[-1]
    first = set(product_of[:count])
    assert own.with_whole_products(count) == sum(lengths[k] for k in first) or not count
    whole = [k for k in first if ends[k] <= count]
    assert own.whole_products(count) == len(whole)
    steps = [k for k in range(1, ends[-1] + 1) if k % 3 == count % 3]
    assert own.count_products(steps) == len({product_of[k - 1] for k in steps})
    assert bisect_left(ends, ends[-1]) == len(lengths) - 1


def test_due_times_are_those_of_each_variant(tmp_path: Path) -> None:
    due = {"short": (10.0, 5.0), "long": (20.0, 7.0)}
    variants = {
        name: {"due": {"first_s": first, "every_s": every}}
        for name, (first, every) in due.items()
    }
    order = ["short", "long", "long"]
    own = load_scenario(mix(tmp_path, count=5, order=order, variants=variants))
    assert assembly_kind(own.assembly).due()[0] == (10.0, 20.0, 27.0, 15.0, 34.0)


PRESS = {
    "machines": {"press": {}},
    "processes": {
        "pressing": {"duration": {"kind": "fixed", "value_s": 2.0}, "machine": "press"}
    },
    "changeovers": [
        {"machine": "press", "durations": {"short": {"long": 20.0}}},
        {"by": "fitter", "duration": {"kind": "uniform", "low_s": 5.0, "high_s": 6.0}},
    ],
}
"""A press that is changed over from short kits to long ones, and a person who changes the nest over."""


@pytest.fixture(scope="module")
def made(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Scenario, TemporalPlanGraph, ExecutionRecord]:
    """Return four kits of both variants in turn, their plan, proved as a whole, and a run."""
    folder = tmp_path_factory.mktemp("mix")
    press = {"process": "pressing", "at": {"part": "bolt"}}
    about: dict[str, Any] = {"order": ["short", "long"], "variants": BOTH}
    file = mix(folder, steps=[*STEPS[:3], press, STEPS[3]], assembly=PRESS, **about)
    own = load_scenario(file)
    tpg = planned(own, folder)
    return own, tpg, execute(own, tpg, folder)


def test_a_mix_goes_through_both_engines_and_all_proofs(
    made: tuple[Scenario, TemporalPlanGraph, ExecutionRecord],
) -> None:
    own, tpg, run = made
    kind = assembly_kind(own.assembly)
    assert kind.variants() == ("short", "long") * 2
    assert list(kind.product_ends()) == [4, 9, 13, 18]
    placed = [str(t.object) for t in tpg.tasks if t.kind == "place-down"]
    assert [name for name in placed if name.startswith("nut")] == ["nut.2", "nut.4"]
    assert len(set(placed)) == len(placed) == 14
    for task, number in zip(tpg.tasks, tpg.products.tolist(), strict=True):
        if task.kind == "place-down":
            assert str(task.object).endswith(f".{number}")
    figures = line_summary(tpg, run, *kind.due())
    assert figures is not None
    assert figures["products"] == 4
    machines = summarize_run(tpg, run, own.name)["machines"]
    assert machines["press"]["busy_s"] == pytest.approx(4 * 2.0)
    assert scenario_expectations(own).places == ()


def test_changeovers_take_place_between_variants(
    made: tuple[Scenario, TemporalPlanGraph, ExecutionRecord],
) -> None:
    _, tpg, run = made
    span: dict[int, tuple[float, float]] = {}
    for chain, begins, ends in zip(tpg.chains, run.start_ns, run.end_ns, strict=True):
        for node, task in enumerate(chain.task.tolist()):
            begin = span.get(task, (begins[node] / 1e9, 0))[0]
            span[task] = begin, ends[node] / 1e9
    named = [
        (t.kind, t.robot, t.object, span[t.index]) for t in tpg.tasks if t.index in span
    ]
    changes = {
        (who, item): own for kind, who, item, own in named if kind == "change-over"
    }
    # The press from the first to the second and from the third to the fourth, the nest between all.
    assert sorted(changes) == [
        ("fitter", "carrier.2"),
        ("fitter", "carrier.3"),
        ("fitter", "carrier.4"),
        ("press", "carrier.2"),
        ("press", "carrier.4"),
    ]
    places = {item: own for kind, _, item, own in named if kind == "place-down"}
    works = [own for kind, _, _, own in named if kind == "pressing"]
    gone = [own[1] for kind, _, _, own in named if kind == "leave"]
    for (who, item), (begin, end) in changes.items():
        number = int(str(item).split(".")[1])
        if who == "fitter":
            assert gone[number - 2] <= begin
            assert 5.0 <= end - begin <= 6.0
            assert end <= min(
                t for name, (_, t) in places.items() if str(name).endswith(f".{number}")
            )
        else:
            assert works[number - 2][1] <= begin
            assert end - begin == pytest.approx(20.0)
            assert end <= works[number - 1][0]


def test_a_machine_is_changed_over_while_no_part_is_in_it() -> None:
    document = yaml.safe_load(TENDING.read_text())
    parts = document["assembly"]
    for step in parts["steps"][2:4]:
        step["variants"] = ["clean"]
    parts["changeovers"] = [{"machine": m, "duration": 9.0} for m in ("mill", "washer")]
    order = ["clean", "clean", "rough", "clean", "rough"]
    parts["products"] |= {
        "count": 5,
        "variants": {"clean": {}, "rough": {}},
        "order": order,
    }
    line = write_out_line(PartsSection.model_validate_json(json.dumps(parts)))
    found = line.supply.changeovers
    # Steps of clean ones are 1 to 5, 6 to 10 and 14 to 18, of rough ones 11 to 13 and 19 to 21. The mill is free
    # once the blank is put elsewhere. Both before and after the rough one the washer does the same.
    assert [(c.machine, c.part, sorted(c.after), sorted(c.before)) for c in found] == [
        ("mill", "blank.3", [8], [11]),
        ("mill", "blank.4", [13], [14]),
        ("mill", "blank.5", [16], [19]),
    ]
    assert line.machines().count("mill") == 1


MISTAKES = planted(r"""
mistake | what is written | in place of | what is said
a share below 0 | short: -0.7 | short: 0.7 | short: must be at least 0
no share | "short: 0, long: 0}" | "short: 0.7, long: 0.3}" | no variant has a share above 0
a share that is no number | short: true | short: 0.7 | variants.short: a mapping
an unknown key | short: {part: 0.7} | short: 0.7 | unknown key 'part'
an unknown variant of a step | variants: [lang] | variants: [long] | did you mean 'long'? (valid: short, long)
no variant of a step | variants: [] | variants: [long] | variants
an unknown variant in the order | order: [short, lang, long] | leave_s: 1.0 | did you mean 'long'? (valid: short, long)
a variant that is never made | "order: [long], variants: {short: {}, long: {}}" | "variants: {short: 0.7, long: 0.3}" | order has no short
a share beside an order | order: [short, long] | leave_s: 1.0 | order says how many there are: leave share out
an unknown order | order: drwn | leave_s: 1.0 | order
a variant without steps | "variants: {short: 0.7, long: 0.3, none: 1}, places: {counts: [1, 1], pitch_m: [1, 1]}" | "variants: {short: 0.7, long: 0.3}" | no step of none puts a part in its place
order without variants | "order: [short]" | "variants: {short: 0.7, long: 0.3}" | order and seed are of variants
variants of steps alone | start_up: 0 | "variants: {short: 0.7, long: 0.3}" | there are no variants: give products.variants
too many products | count: 5001 | count: 4 | at most 5000 products of several variants
a count below 1 | count: -3 | count: 4 | count: must be at least 1
due of one variant | short: {due: {first_s: 1, every_s: 1}} | short: 0.7 | give due for each of the variants
a part that other products lack | "hold: nut, place: seal" | "place: seal" | of variant short no step puts nut in its place
an order that is found | "order: find, steps" | steps | list them in that order
the best of none | "order: best, count: 4, variants: {short: 1, long: 0.01}" | "count: 4, leave_s: 1.0, variants: {short: 0.7, long: 0.3}" | of 4 products none is of long by its share
lateness without cycle times | "order: best, objective: lateness, due: {first_s: 9, every_s: 9}" | leave_s: 1.0 | give short cycle_s
lateness without due times | "variants: {short: {cycle_s: 3}, long: {cycle_s: 3}}, order: best, objective: lateness" | "variants: {short: 0.7, long: 0.3}" | nothing can be late: give due
an objective of no search | objective: lateness | leave_s: 1.0 | objective is of order: best
too much to be compared | "order: best, count: 5000" | "count: 4" | order: best compares more than
a changeover from a file | "changeovers: [{duration: {kind: empirical, csv: none.csv}}], products: {order: best, " | "products: {" | order: best needs durations of changeovers without files
a changeover without a time | "changeovers: [{by: fitter}], steps" | steps | Give duration or durations
a changeover of no machine | "changeovers: [{machine: mill, duration: 3}], steps" | steps | there are no machines: leave machine out
a changeover of an unknown variant | "changeovers: [{durations: {short: {lang: 3}}}], steps" | steps | did you mean 'long'? (valid: short, long)
a changeover twice | "changeovers: [{by: ann, duration: 3}, {by: bob, duration: 3}], steps" | steps | changeovers.0 is of the whole cell already
a changeover that robots make | "changeovers: [{robots: [left], duration: 3}], steps" | steps | unknown key 'robots'
a changeover by a robot | "changeovers: [{by: left, duration: 3}], steps" | steps | the name 'left' is that of a robot
a changeover that takes no time | "changeovers: [{duration: 0}], steps" | steps | duration
parts that are alike | "goals: [{xyz_m: [0, 0, 0.08]}]" | "goal: {xyz_m: [0, 0, 0.08]}" | products of several variants have none
""")


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_with_its_place(mistake: str, tmp_path: Path) -> None:
    new, old, said = MISTAKES[mistake]
    steps = [
        {"place": name, "variants": ["long"] if name == "nut" else ["short", "long"]}
        for name in ("carrier", "nut", "bolt", "seal")
    ]
    file = mix(tmp_path, steps=steps)
    text = yaml.safe_dump(
        yaml.safe_load(file.read_text()),
        sort_keys=False,
        default_flow_style=True,
        width=100_000,
    )
    problem = refusal(tmp_path, text, (old, new)).problems
    assert any(said in f"{p.message}" for p in problem), [p.message for p in problem]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(4))
def test_a_mix_is_operated(seed: int, tmp_path: Path) -> None:
    press = {"process": "pressing", "at": {"part": "bolt"}}
    about: dict[str, Any] = {"count": 5, "spare": 3, "variants": BOTH, "seed": seed}
    file = mix(tmp_path, steps=[*STEPS[:3], press, STEPS[3]], assembly=PRESS, **about)
    losses = {"failures.pick": {"probability": 0.15, "loses": 0.8}}
    window = {"window": {"steps": 4, "least": 2}} if seed % 2 else {}
    some = load(file).varied({**losses, **window})
    done, _ = operated(plan_scenario(some, keep=True), seed)
    require_safe(done.tpg)
    kind = assembly_kind(some.sections.assembly).written_out()
    ends = [0, *kind.product_ends()]
    placed = Counter(t.step for t in done.tpg.tasks if t.kind == "place-down")
    whole = {
        k
        for k in range(1, len(ends))
        if not done.given_up.keys() & {*range(ends[k - 1] + 1, ends[k] + 1)}
        and any(placed[n] for n in range(ends[k - 1] + 1, ends[k] + 1))
    }
    assert len(whole) == 5 or done.record.outcome != "completed"
    assert {*done.tpg.products.tolist()} - {0} == whole


def _waits(tasks: Any, pairs: Any) -> set[tuple[str, str]]:
    """Return the closure of waits between tasks and of the order of each robot, by names of tasks."""
    names = [f"{task.robot}: {task.kind} {task.object} {task.step}" for task in tasks]
    graph: nx.DiGraph[int] = nx.DiGraph(task_graph(tasks, pairs).edges)
    return {(names[a], names[b]) for a, b in nx.transitive_closure_dag(graph).edges}


def test_products_planned_once_wait_as_if_all_were_planned(tmp_path: Path) -> None:
    change = [
        {"by": "setter", "durations": {"short": {"long": 8}, "long": {"short": 5}}}
    ]
    order = ["short", "short", "long", "long"]
    file = mix(tmp_path, order=order, variants=BOTH, count=7)
    text = yaml.safe_load(file.read_text())
    text["assembly"]["changeovers"] = change
    text["planning"]["shortcut_candidates"] = 0
    own = load_scenario(written(tmp_path, yaml.safe_dump(text, sort_keys=False)))
    assert len(own.kind.units()) < 7
    tpg = plan_scenario(own, tmp_path).tpg
    every = plan_motions(own, tmp_path, StageWatch(), whole=True).motion_plan
    assert _waits(tpg.tasks, tpg.dependencies) == _waits(
        every.tasks, every.dependencies
    )
    slow = connect_nodes(DerivedTpg(tpg))
    assert np.array_equal(tpg.edges, slow.edges)
