"""Machines with capacity work at batches: which parts are in them, and what waits for what."""

from __future__ import annotations

import copy
import heapq
import json
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.parts.assembly import MachineWork
from planning.tasks.task import Handling
from scheduling.graph.rollout import earliest_times
from scheduling.verification.verify import verify_plan
from tests.planted import rows
from tests.twin.operations.random_operations import problems_of
from tests.twin.scenarios.executed import executed
from tests.twin.scenarios.ovens import OVEN
from tests.twin.written import loaded
from twin.audits.run_auditor import audit_execution
from twin.document.validation import InvalidScenarioError
from twin.kinds.parts.batch_starts import closed_batches, waits_in_batches
from twin.kinds.parts.batches import order_in_batches
from twin.kinds.parts.built import assembly_of
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.section import PartsSection, StepSection
from twin.kinds.parts.sources import ProductsSection
from twin.operations.api import operate
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, read_plan
from twin.trial.planning import plan_scenario, plan_until_final
from twin.trial.run_plan import write_plan


def varied(folder: Path, text: str) -> Scenario:
    """Return the cell with other values of its assembly, merged key by key; null takes a key away."""
    document = yaml.safe_load(OVEN)

    def merge(old: dict[str, Any], new: dict[str, Any]) -> None:
        for key, value in new.items():
            if value is None:
                old.pop(key, None)
            elif isinstance(value, dict) and isinstance(old.get(key), dict):
                merge(old[key], value)
            else:
                old[key] = value

    merge(document["assembly"], copy.deepcopy(yaml.safe_load(text)))
    return loaded(folder, yaml.safe_dump(document))


def simulated_starts(
    arrivals: Sequence[float], bakes: Sequence[float], capacity: int
) -> list[tuple[int, float]]:
    """Return size and start of each run of an oven that waits until it is full, or nothing more comes, by events."""
    events = [(t, 0, k) for k, t in enumerate(arrivals)]
    heapq.heapify(events)
    waiting, coming, busy = 0, len(arrivals), False
    found: list[tuple[int, float]] = []
    while events:
        now, kind, _ = heapq.heappop(events)
        busy = busy and kind == 0
        waiting, coming = waiting + (kind == 0), coming - (kind == 0)
        if not busy and waiting and (waiting >= capacity or not coming):
            size = min(waiting, capacity)
            found.append((size, now))
            busy, waiting = True, waiting - size
            heapq.heappush(events, (now + bakes[len(found) - 1], 1, 0))
    return found


PRODUCT = [StepSection.model_validate(own) for own in (
    {"place": "a", "at": {"fixture": "rack"}},
    {"process": "baking", "at": {"part": "a"}},
    {"place": "a"},
)]  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.integers(1, 6),
    gaps=st.lists(st.integers(1, 50), min_size=1, max_size=20),
    bakes=st.lists(st.integers(1, 100), min_size=20, max_size=20),
)
def test_batches_start_as_in_an_event_simulation(
    capacity: int, gaps: list[int], bakes: list[int]
) -> None:
    """Chains and edges of the written-out order give the same batches at the same times as events do."""
    arrivals = np.cumsum(gaps).astype(float).tolist()
    order = order_in_batches([PRODUCT] * len(gaps), {"baking": capacity})
    batches = [own for own in order if own[0][1] == 1]
    end, found = 0.0, []
    for batch, bake in zip(batches, bakes, strict=False):
        start = max([end, *(arrivals[product] for product, _ in batch)])
        found.append((len(batch), start))
        end = start + bake
    times = [float(bake) for bake in bakes]
    assert found == simulated_starts(arrivals, times, capacity)


def timed_batches(
    arrivals: Sequence[float], bakes: Sequence[float], capacity: int, longest: float
) -> list[tuple[int, float]]:
    """Return size and start of each run of an oven with a timer from the first part, which nothing is put into meanwhile.

    Parts come in turn. The oven starts with the last part that comes before it is full or its time is over.
    """
    found: list[tuple[int, float]] = []
    queue, free = list(arrivals), 0.0
    while queue:
        inside = [max(free, queue.pop(0))]
        while queue and len(inside) < capacity:
            put_in = max(free, queue[0])
            if put_in > inside[0] + longest:
                break
            inside.append(put_in)
            queue.pop(0)
        found.append((len(inside), inside[-1]))
        free = inside[-1] + bakes[len(found) - 1]
    return found


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.integers(2, 6),
    gaps=st.lists(st.integers(1, 50), min_size=1, max_size=20),
    bakes=st.lists(st.integers(1, 100), min_size=20, max_size=20),
    longest=st.integers(1, 120),
)
def test_batches_are_closed_as_by_a_timer(
    capacity: int, gaps: list[int], bakes: list[int], longest: int
) -> None:
    """Plan by plan, with put-ins that each plan moves, since they wait for the runs before."""
    arrivals = np.cumsum(gaps).astype(float).tolist()
    sizes: tuple[int, ...] | None = ()
    passes = 0
    while sizes is not None:
        given_sizes, free, found, waits = sizes, 0.0, [], []
        order = order_in_batches(
            [PRODUCT] * len(gaps), {"baking": capacity}, {"baking": given_sizes}
        )
        batches = [own for own in order if own[0][1] == 1]
        for batch, bake in zip(batches, bakes, strict=False):
            put_in = [max(free, arrivals[product]) for product, _ in batch]
            found.append((len(batch), max(put_in)))
            waits.append([max(put_in) - own for own in put_in])
            free = max(put_in) + bake
        sizes, passes = closed_batches(waits, longest), passes + 1
    assert found == timed_batches(arrivals, bakes, capacity, longest)
    assert passes <= 1 + sum(size < capacity for size, _ in found)


@settings(max_examples=40, deadline=None)
@given(
    batches=st.lists(
        st.lists(st.integers(0, 30), min_size=1, max_size=4), min_size=1, max_size=5
    ),
    longest=st.integers(1, 30),
)
def test_a_batch_is_closed_before_the_first_part_that_is_too_late(
    batches: list[list[int]], longest: int
) -> None:
    """In whatever order parts are put in, by however many robots."""

    def kept(waits: list[int]) -> bool:
        return all(abs(a - b) <= longest for a in waits for b in waits)

    sizes = closed_batches(batches, longest)
    if sizes is None:
        assert all(map(kept, batches))
        return
    *before, size = sizes
    assert before == [len(own) for own in batches[: len(before)]]
    assert all(map(kept, batches[: len(before)]))
    late = batches[len(before)]
    assert kept(late[:size])
    assert not kept(late[: size + 1])


STEPS = {
    "p": {"place": "a", "at": {"fixture": "rack"}},
    "a": {"process": "baking", "at": {"part": "a"}},
    "b": {"process": "baking", "at": {"part": "b"}},
    "w": {"process": "washing", "at": {"part": "a"}},
}


@settings(max_examples=150, deadline=None)
@given(
    products=st.lists(st.text("pabw", max_size=6), max_size=9),
    sizes=st.tuples(st.integers(2, 4), st.integers(2, 4)),
)
def test_every_step_is_done_once_in_order_and_batches_hold(
    products: list[str], sizes: tuple[int, int]
) -> None:
    capacity = {"baking": sizes[0], "washing": sizes[1]}
    steps = [[StepSection.model_validate(STEPS[k]) for k in own] for own in products]
    order = order_in_batches(steps, capacity)
    number = {own: k for k, group in enumerate(order) for own in group}
    assert len(number) == sum(map(len, order)) == sum(map(len, products))
    for product, own in enumerate(steps):
        for k, (first, then) in enumerate(pairwise(own)):
            a, b = number[product, k], number[product, k + 1]
            assert a < b or (a == b and first.process == then.process and first != then)
    for group in order:
        kinds = {steps[product][k].process or "" for product, k in group}
        places = [(product, steps[product][k].at) for product, k in group]
        parts = [(product, at and at.part) for product, at in places]
        assert len(kinds) == 1
        assert len(group) == 1 or len(parts) == len({*parts}) <= capacity[kinds.pop()]


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    """Four products, two in the oven at a time."""
    folder = tmp_path_factory.mktemp("oven")
    return plan_scenario(loaded(folder, OVEN), folder)


def test_an_oven_is_shut_for_both_parts(plan: PlanResult, tmp_path: Path) -> None:
    """The run of a batch comes between all that is put in and all that is taken out, in proof and audit."""
    tpg = plan.tpg
    assert verify_plan(tpg).problems == ()
    trial = executed(plan.scenario.sections, tpg, tmp_path / "run")
    assert trial.summary["line"]["products"] == 4
    rollout, spans = earliest_times(tpg), defaultdict(list)
    for chain, start, end in zip(tpg.chains, rollout.start, rollout.end, strict=True):
        for index in dict.fromkeys(chain.task.tolist()):
            own, task = chain.task == index, tpg.tasks[index]
            span = float(start[own].min()), float(end[own].max())
            spans[task.kind, task.object].append(span)
    runs = [*spans["baking", "blank.1"], *spans["baking", "blank.3"]]
    for k in range(1, 5):
        begins, ends = runs[(k - 1) // 2]
        assert spans["place-down", f"blank.{k}"][0][1] <= begins
        assert ends <= spans["pick", f"blank.{k}"][1][0]
    door = [h for h in tpg.handlings if h.object.startswith("oven.door")]
    shut = {h.object for h in door if h.holder is None}
    assert shut == {h.object for h in door if h.holder == Handling.GONE}
    assert len(shut) == 2


SLOW_TRAY = "{kind: tray, pose: {xyz_m: [-0.35, -0.33, 0.015]}, grid: {counts: [1, 3], pitch_m: [0, 0.07]}, refill_s: 60}"
SHELF = {"counts": [4, 1], "pitch_m": [0.036, 0]}


def clocked(
    folder: Path, seconds: float, count: int, more: str = "{}"
) -> LoadedScenario:
    """Return the cell with an oven for four that starts so long after its first part, and a slow tray for three."""
    document = yaml.safe_load(OVEN)
    parts = document["assembly"]
    parts["sources"]["blanks"] = yaml.safe_load(SLOW_TRAY)
    parts["machines"]["oven"] |= {"capacity": 4, "start_after_s": seconds}
    parts["parts"][0]["size_m"] = [0.025, 0.025, 0.03]
    at = {"pose": {"xyz_m": [-0.02, 0, 0.015]}, "grid": SHELF}
    parts["steps"][0] |= {"name": "loaded", "at": parts["steps"][0]["at"] | at}
    parts["products"] |= {"count": count, **yaml.safe_load(more)}
    document["planning"]["shortcut_candidates"] = 0
    return LoadedScenario(loaded(folder, yaml.safe_dump(document)), folder)


def ovens_batches(scenario: LoadedScenario) -> tuple[int, ...]:
    section = scenario.sections.assembly
    assert isinstance(section, PartsSection)
    return section.machines["oven"].batches


def test_an_oven_starts_before_it_is_full(tmp_path: Path) -> None:
    """The fourth part comes too late for the first three; a saved plan says so for the file from which it was made."""
    case = clocked(tmp_path, 45.0, 4)
    first, plan = plan_scenario(case), plan_until_final(case)
    section = case.sections.assembly
    assert isinstance(section, PartsSection)
    ((*waits, last),) = waits_in_batches(section, first.tpg)["oven"]
    assert [max(waits) - wait > 45.0 for wait in (*waits, last)] == [False] * 3 + [True]
    assert ovens_batches(plan.scenario) == (3,)
    assert verify_plan(plan.tpg).problems == ()
    runs = [task.object for task in plan.tpg.tasks if task.kind == "baking"]
    assert runs == ["blank.1", "blank.4"]
    assert [window.most for window in plan.tpg.windows] == [45.0] * 4
    for name, own in (("whole", first), ("closed", plan)):
        (tmp_path / name).mkdir()
        write_plan(own, tmp_path / name)
        again = read_plan(tmp_path / name, case)
        assert ovens_batches(again.scenario) == ovens_batches(own.scenario)


@pytest.mark.nightly
@pytest.mark.parametrize("more", ["{}", "{variants: {a: {}, b: {}}, order: [a, b]}"])
def test_runs_of_an_oven_that_starts_by_the_clock(more: str, tmp_path: Path) -> None:
    """The audit finds nothing, and no window of a run is broken at nominal times."""
    case = clocked(tmp_path, 45.0, 8, more)
    plan = plan_until_final(case)
    assert ovens_batches(plan.scenario) == (3, 3)
    assert verify_plan(plan.tpg).problems == ()
    trial = executed(plan.scenario.sections, plan.tpg, tmp_path / "run")
    found = trial.summary["windows"]
    assert [own["within_s"] for own in found] == [45.0] * 8
    assert not any(own["broken"] for own in found)
    operated = operate(case, out=tmp_path / "operated", recording=False)
    assert operated.passed
    assert ovens_batches(operated.plan.scenario) == (3, 3)


def steps_of(scenario: Scenario) -> list[tuple[str, str]]:
    """Return what the steps of a plan's first products do, and at which part."""
    section = scenario.assembly
    assert isinstance(section, PartsSection)
    steps = assembly_of(write_out_line(section)).steps
    return [
        (step.process, "+".join(step.parts))
        if isinstance(step, MachineWork)
        else ("place", getattr(step, "part", ""))
        for step in steps
    ]


def test_the_last_batch_is_smaller(tmp_path: Path) -> None:
    own = varied(tmp_path, "products: {count: 3}")
    kind = assembly_kind(own.assembly).written_out()
    found = steps_of(own)
    assert [what for do, what in found if do == "baking"] == [
        "blank.1+blank.2",
        "blank.3",
    ]
    assert kind.steps() == len(found) == 8
    assert [kind.product_of(k) for k in range(1, 9)] == [1, 2, 2, 1, 2, 3, 3, 3]


def test_only_products_of_a_variant_are_baked_and_take_places(tmp_path: Path) -> None:
    own = varied(
        tmp_path, "products: {count: 5, variants: {a: {}, b: {}}, order: [a, b]}"
    )
    assert isinstance(own.assembly, PartsSection)
    load, bake, unload = own.assembly.steps
    only = {"variants": ("a",)}
    section = own.assembly.changed(
        steps=(load.changed(**only), bake.changed(**only), unload)
    )
    line = write_out_line(section)
    assert [k for k, _ in line.origins] == [1, 2, 3, 3, 1, 3, 4, 5, 5, 5]
    at = [step.at.pose for step in line.section.steps if step.at and step.at.fixture]
    assert [pose and pose.xyz_m[0] for pose in at] == [0.0, 0.08, 0.0]
    kind = assembly_kind(section).written_out()
    assert [kind.product_of(k) for k in range(1, 11)] == [k for k, _ in line.origins]


def test_parts_of_one_assembly_are_baked_together(tmp_path: Path) -> None:
    own = varied(tmp_path, """
sources: null
products: null
parts:
  - {name: a, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [-0.2, 0.3, 0.055]}, goal: {xyz_m: [0, -0.2, 0.015]}}
  - {name: b, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [-0.16, 0.3, 0.055]}, goal: {xyz_m: [0, -0.3, 0.015]}}
  - {name: c, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [-0.24, 0.3, 0.055]}, goal: {xyz_m: [0, -0.1, 0.015]}}
steps:
  - {process: baking, at: {part: a}, name: one}
  - {process: baking, at: {part: b}, name: two}
  - {process: baking, at: {part: c}, name: three}
  - {place: a, after: [two]}
  - b
  - {place: c, after: [three]}
""")  # fmt: skip
    assert steps_of(own)[:2] == [("baking", "a+b"), ("baking", "c")]
    assert isinstance(own.assembly, PartsSection)
    steps = write_out_line(own.assembly).section.steps
    assert [[x.step for x in step.follows] for step in steps] == [
        [],
        [],
        ["one"],
        [],
        ["three"],
    ]


@settings(max_examples=60, deadline=None)
@given(
    orders=st.lists(
        st.tuples(
            st.integers(1, 4),
            st.sampled_from("ab"),
            st.integers(-2, 2),
            st.integers(0, 9),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_orders_of_high_priority_come_first_then_those_due_first(
    orders: list[tuple[int, str, int, int]],
) -> None:
    keys = ("count", "variant", "priority", "due_s")
    count = sum(own[0] for own in orders)
    own = ProductsSection.model_validate(
        {
            "count": count,
            "variants": {"a": {}, "b": {}},
            "orders": tuple(dict(zip(keys, one, strict=True)) for one in orders),
        }
    )
    left = [
        (-priority, due, k, v)
        for k, (n, v, priority, due) in enumerate(orders)
        for _ in range(n)
    ]
    for variant, due in zip(own.sequence(count), own.due_s(), strict=True):
        first = min(left)
        left.remove(first)
        assert (variant, due) == (first[3], first[1])


@pytest.mark.parametrize(
    ("assembly", "message"),
    rows(r"""
assembly                              | says
{machines: {oven: {capacity: 0}}}     | oven.capacity: must be at least 1, not 0
{machines: {oven: {capacity: 1000}}}  | oven.capacity: must be at most 100, not 1000
{machines: {oven: {capacity: 2.5}}}   | oven.capacity: a whole number expected
{machines: {oven: {capacity: 4}}}     | blank has 2 of 4 places.*capacity: 2
{products: {count: 1001}}             | in whole batches: write 1000 or 1002
{products: {spare: 2}}                | no batch is spare: leave spare out, or write capacity: 1
{products: null, order: find}         | in the order of the steps: leave order out
{products: null}                      | one product after another: give products
{steps: [{place: blank, at: {fixture: rack, grid: {counts: [0, 1], pitch_m: [0.1, 0]}}}]} | at.grid.counts\[0\]: must be at least 1
{steps: [{place: blank, at: {fixture: rack, frame: nest}}, {process: baking, at: {part: blank}}, blank]} | blank has 1 of 2 places
{processes: {baking: {unattended: true}}} | processes.baking: .*not both
{products: {orders: [{count: 3}]}}    | products: orders are of 3 products: write count: 3
{products: {orders: [{count: 4, variant: a}]}} | the variant of each of the orders must be none
{products: {orders: [{count: 3, due_s: 5}, {count: 1}]}} | give due_s for each of the orders, or for none
{products: {orders: [{count: 4, due_s: 5}], due: {first_s: 1, every_s: 1}}} | give due_s for each of the orders
{products: {orders: [{count: 4, variant: a}], variants: {a: {}}, order: [a]}} | and neither order nor due
{changeovers: [{machine: oven, duration: 5}]} | products of a batch alternate: leave changeovers out
{products: {orders: [{count: 4}], variants: {a: 1}}} | must be one of a
{machines: {oven: {start_after_s: 0}}} | oven.start_after_s: must be greater than 0, not 0
{machines: {oven: {start_after_s: soon}}} | oven.start_after_s: a number expected
{machines: {oven: {start_after_s: 10}}} | :\d+:\d+: start_after_s of oven counts from the step that puts a part there: give that step and its name
{machines: {oven: {start_after_s: 10, capacity: 1}}} | :21:22: start_after_s is of batches \(capacity\) .* not of 0: leave it out
{machines: {oven: {batches: [1, 3]}}} | must be at most capacity, 2, not 3
{machines: {oven: {batches: [0]}}} | oven.batches\[0\]: must be at least 1
{machines: {oven: {batches: 2}}} | oven.batches: a list
{machines: {oven: {batches: [1]}}, products: {count: 501}} | at most 500 products are made in batches of several sizes: leave batches out
{machines: {oven: {batches: [1]}}, steps: [{place: blank, at: {fixture: rack, frame: nest, grid: {counts: [2, 1], pitch_m: [0.08, 0]}}}, {process: baking, at: {part: blank}}, {place: blank, at: {fixture: rack, frame: nest, grid: {counts: [2, 1], pitch_m: [0.08, 0]}}}, {process: baking, at: {part: blank}}, blank]} | batches is of batches \(capacity\) of one run of one process in a product, not of 2: leave it out
{machines: {oven: {start_after_s: 10}}, sources: null, parts: [{name: blank, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [-0.2, 0.3, 0.055]}, goal: {xyz_m: [0, -0.2, 0.015]}}], products: null, steps: [{process: baking, at: {part: blank}}, blank]} | :\d+:\d+: start_after_s of oven counts from the step that puts a part there: give that step and its name
{products: {orders: [{count: 4, priority: 1000}]}} | orders\[0\].priority: must be at most 100, not 1000
"""),
)
def test_batches_that_cannot_be_are_refused(
    assembly: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidScenarioError, match=message):
        varied(tmp_path, assembly)


@pytest.mark.nightly
def test_the_audit_looks_at_every_part_of_a_batch(
    plan: PlanResult, tmp_path: Path
) -> None:
    own, run = plan.scenario.sections, tmp_path / "run"
    executed(own, plan.tpg, run)
    log = run / "events.jsonl"
    events = [json.loads(line) for line in log.read_text().splitlines()]
    for event in events:
        if event.get("robot") == "oven" and event["kind"] == "completed":
            event["t_s"] += 60.0
    log.write_text("".join(json.dumps(event) + "\n" for event in events))
    report = audit_execution(own, run, ordered=True, finished=True)
    words = [v.detail for v in report.violations if v.kind == "process"]
    for k in range(1, 5):
        assert any(f"and blank.{k} lies there from" in own for own in words)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(40))
def test_operations_with_batches(seed: int) -> None:
    found, _ = problems_of("oven", seed)
    assert found == []
