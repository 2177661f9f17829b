"""The same results whoever computes them, and however often they are interrupted."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import TwinError
from tests.twin.drawn_runs import VARIED
from tests.twin.driven_toys import driven_tpg
from tests.twin.studies.study_toys import toy_workload
from tests.twin.twin_toys import random_tpg
from twin.engine.execution_model import ExecutionModel
from twin.studies.folder import write_replications
from twin.studies.plans import bulk_until_ns
from twin.studies.replications import runner
from twin.studies.replications.block_results import (
    BlockResult,
    blocks_done,
    read_block,
)
from twin.studies.replications.executors import InProcess, open_executor
from twin.studies.replications.experiment import Block, Experiment
from twin.studies.replications.runner import run_replications
from twin.studies.replications.statistics import Precision
from twin.studies.replications.workload import (
    Engines,
    Workload,
    compute_block,
    pack_workload,
)
from twin.uncertainty.disturbances import (
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.skill_durations import SkillDurations

TWO = Experiment(("asynchronous", "sequential"), replications=70)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "BULK_BLOCK", 16)
    monkeypatch.setattr(runner, "EVENTS_BLOCK", 8)


def _loads() -> list[Workload]:
    return [toy_workload(), toy_workload(policy="sequential")]


def _given(executor: Executor) -> Callable[[], AbstractContextManager[Executor]]:
    return lambda: nullcontext(executor)


def _in_process() -> AbstractContextManager[Executor]:
    return open_executor(workers=0)


def _run(opened: Callable[[], AbstractContextManager[Executor]], folder: Path) -> bytes:
    """Run both by some pools, and return their table."""
    run_replications(TWO, _loads(), folder, opened)
    return _table(folder)


def _table(folder: Path, experiment: Experiment = TWO) -> bytes:
    path = folder.with_suffix(".parquet")
    write_replications(path, experiment, folder)
    return path.read_bytes()


class _Dying(InProcess):
    """Gives up after some blocks, as a machine does that is switched off."""

    def __init__(self, blocks: int) -> None:
        self.left = blocks

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kw: Any) -> Future[Any]:
        if self.left == 0:
            raise KeyboardInterrupt
        self.left -= 1
        return super().submit(fn, *args, **kw)


def test_an_interrupted_study_goes_on_where_it_was(tmp_path: Path) -> None:
    computed: list[Block] = []
    for blocks in (1, 3, 0, 2):
        before = set(blocks_done(tmp_path / "parts"))
        with pytest.raises(KeyboardInterrupt):
            _run(_given(_Dying(blocks)), tmp_path / "parts")
        new = set(blocks_done(tmp_path / "parts")) - before
        assert not new & set(computed)
        computed += new
    parts = _run(_in_process, tmp_path / "parts")
    assert parts == _run(_in_process, tmp_path / "whole")


def _die_once(marker: Path, packed_workload: Any, block: Block) -> Any:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return compute_block(packed_workload, block)


class _Murderous(Executor):
    """A pool, one of whose workers is killed in the middle of its first block."""

    def __init__(self, pool: Executor, marker: Path) -> None:
        self.pool, self.marker = pool, marker

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kw: Any) -> Future[Any]:
        return self.pool.submit(_die_once, self.marker, *args, **kw)


@pytest.mark.nightly
def test_pools_give_what_one_process_gives_though_a_worker_is_killed(
    tmp_path: Path,
) -> None:
    """The first pool breaks in its first block; a second one does what is left."""

    @contextmanager
    def pool() -> Iterator[Executor]:
        with open_executor(workers=2) as executor:
            yield _Murderous(executor, tmp_path / "killed")

    parts = _run(pool, tmp_path / "parts")
    assert (tmp_path / "killed").exists()
    assert parts == _run(_in_process, tmp_path / "whole")


class _Refusing(_Dying):
    """A pool that notices a dead worker as it is given its next block."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kw: Any) -> Future[Any]:
        if self.left == 0:
            raise BrokenExecutor("a worker died")
        return super().submit(fn, *args, **kw)


def test_no_block_is_lost_that_a_broken_pool_refuses(tmp_path: Path) -> None:
    pools = iter((0, 1, 0, 100))
    parts = _run(lambda: nullcontext(_Refusing(next(pools))), tmp_path / "parts")
    assert parts == _run(_in_process, tmp_path / "whole")


def test_sampling_goes_on_until_the_mean_is_known(tmp_path: Path) -> None:
    rule = Precision(relative_half_width=0.03, least=20, most=2000)
    experiment = Experiment(("asynchronous",), precision=rule)
    reports: list[tuple[float, float]] = []
    count = run_replications(
        experiment,
        [toy_workload()],
        tmp_path / "blocks",
        _in_process,
        lambda stage, done, total: reports.append((done, total)),
    )
    done = sorted(blocks_done(tmp_path / "blocks"), key=lambda block: block.first)
    assert sum(block.count for block in done) == count
    rows = [read_block(tmp_path / "blocks", block).rows for block in done]
    sample = np.concatenate([row.makespan_ns for row in rows]) * 1e-9
    assert 20 < count < 2000
    assert rule.reached(sample)
    assert not rule.reached(sample[: int(count / 1.6)])
    assert [number for number, _ in reports] == sorted(n for n, _ in reports)
    assert all(done <= total for done, total in reports)


def test_workers_stay_from_one_step_of_sampling_to_the_next(tmp_path: Path) -> None:
    """Opened once, though one asks again and again whether the mean is known; none for nothing."""
    rule = Precision(relative_half_width=0.001, least=20, most=300)
    experiment = Experiment(("asynchronous",), precision=rule)
    opened: list[str] = []

    @contextmanager
    def own() -> Iterator[Executor]:
        opened.append("opened")
        with _in_process() as executor:
            yield executor
        opened.append("closed")

    assert len(list(experiment.targets())) > 2
    count = run_replications(experiment, _loads()[:1], tmp_path / "a", own)
    assert count > list(experiment.targets())[1]
    assert opened == ["opened", "closed"]
    run_replications(experiment, _loads()[:1], tmp_path / "a", own)
    assert opened == ["opened", "closed"]


def assert_same_results(ours: BlockResult, theirs: BlockResult) -> None:
    columns = ours.rows.columns(), theirs.rows.columns()
    for name in columns[0].keys() - {"engine"}:
        assert columns[0][name].tolist() == columns[1][name].tolist(), name
    for part in ("tally", "products", "workers"):
        ours_of, theirs_of = (vars(getattr(own, part)) for own in (ours, theirs))
        for name, values in ours_of.items():
            assert np.array_equal(values, theirs_of[name]), name


def line_workload(seed: int, *, driven: bool, stalls: int = 0) -> Workload:
    """Return a workload of two products that robots make, within limits of acceleration or not."""
    toy = driven_tpg if driven else random_tpg
    tpg = toy(seed, dofs=(2, 2, 3), tasks=12, nodes_per_transit=9, edges=24)
    works = np.flatnonzero([task.kind != "transit" for task in tpg.tasks])
    products = np.zeros(len(tpg.tasks), dtype=np.int64)
    products[works] = np.arange(len(works)) % 2 + 1
    stands = Stalls(count_per_robot=stalls, duration_s=(0.1, 3.0))
    disturbances = Disturbances(stalls=stands)
    model = ExecutionModel(SkillDurations(VARIED.models), disturbances=disturbances)
    return Workload(replace(tpg, products=products), model, 5)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from([0, 0, 2]))
def test_engines_fill_the_same_rows(seed: int, driven: bool, stalls: int) -> None:
    load = line_workload(seed, driven=driven, stalls=stalls)
    bulk = Engines(load).compute(Block(0, 3, 6))
    events = Engines(replace(load, reasons=("asked",))).compute(Block(0, 3, 6))
    assert (bulk.rows.engine, events.rows.engine) == ("bulk", "events")
    assert_same_results(bulk, events)
    assert bulk.tally.slack_ns.min() >= 0
    assert bulk.tally.slack_ns.max() > 0


@pytest.mark.parametrize("driven", [False, True])
def test_stops_that_no_replication_comes_to_leave_the_bulk_engine(driven: bool) -> None:
    load, block = line_workload(4, driven=driven), Block(0, 0, 6)
    ends = np.sort(Engines(load).compute(block).rows.makespan_ns)
    for end, engine in ((ends[-1] + 1, "bulk"), (ends[-1], "events")):
        stop = EmergencyStop(at_s=end / 1e9, duration_s=5.0)
        model = replace(
            load.execution, disturbances=Disturbances(emergency_stops=(stop,))
        )
        own = replace(load, execution=model, reasons=("stops",))
        until = bulk_until_ns(own.tpg, model)
        assert until == end
        found = Engines(replace(own, bulk_until_ns=until)).compute(block)
        assert found.rows.engine == engine
        assert_same_results(found, Engines(own).compute(block))
    early = EmergencyStop(at_s=1.0, duration_s=5.0)
    model = replace(load.execution, disturbances=Disturbances(emergency_stops=(early,)))
    assert bulk_until_ns(load.tpg, model) == 0


def test_failed_tasks_are_rows_and_lose_no_other(tmp_path: Path) -> None:
    failing = Disturbances(
        failures={"pick": SkillFailure(probability=0.3, retries=0, retry=None)}
    )
    experiment = Experiment(("asynchronous",), replications=40)
    loads = [toy_workload(seed=9, disturbances=failing)]
    run_replications(experiment, loads, tmp_path / "blocks", _in_process)
    _table(tmp_path / "blocks", experiment)
    table = pq.read_table(tmp_path / "blocks.parquet").to_pydict()
    outcomes = table["outcome"]
    assert set(outcomes) == {"completed", "failed"}
    for outcome, makespan, wait in zip(
        outcomes, table["makespan_s"], table["wait_total_s"], strict=True
    ):
        assert makespan > 0
        assert np.isnan(wait) == (outcome == "failed")


class _Broken:
    """A model that cannot be drawn from in one replication of ten."""

    mean, sd, minimum = 1.0, 0.0, 1.0

    def ppf(self, u: Any) -> Any:
        if np.any(u < 0.02):
            raise ArithmeticError("no quantile")
        return np.ones_like(u)


def test_a_replication_that_raises_is_a_row_with_its_error() -> None:
    load = toy_workload()
    models = load.execution.durations.models
    broken: dict[str, Any] = {**models, "pick": _Broken(), "place-up": _Broken()}
    own = Workload(load.tpg, ExecutionModel(SkillDurations(broken)), 5)
    rows = compute_block(pack_workload(own), Block(0, 0, 60)).rows
    wrong = rows.outcome == "error"
    assert 0 < np.count_nonzero(wrong) < 60
    assert all("ArithmeticError: no quantile" in text for text in rows.error[wrong])
    assert all(rows.outcome[~wrong] == "completed")
    well = compute_block(
        pack_workload(own), Block(0, int(np.flatnonzero(~wrong)[0]), 1)
    ).rows
    assert well.makespan_ns[0] == rows.makespan_ns[~wrong][0]


def test_workers_that_keep_dying_end_the_study(tmp_path: Path) -> None:
    with pytest.raises(TwinError, match="--resume"):
        _run(_given(_Refusing(0)), tmp_path / "blocks")
