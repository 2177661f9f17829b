"""What all tests may ask for, and who runs which of them when."""

from __future__ import annotations

import faulthandler
import functools
import gc
import os
import signal
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis
import pytest
from hypothesis.vendor.pretty import for_type_by_name
from xdist.scheduler import LoadScopeScheduling

# Tests run side by side: threads of linear algebra would only be in each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")

FEW_EXAMPLES = 3
"""Property tests that try no more than these try them all by day, others a third of what they say."""

SETTINGS = "_hypothesis_internal_use_settings"
"""Attribute in which hypothesis keeps the settings of a property test."""

NIGHTLY_S = 7200
"""Longest time of a test that tries more than by day [s]."""

if TYPE_CHECKING:
    from tests.planned_once import PlannedOnce
    from tests.shipped_runs import ShippedRuns


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--nightly",
        action="store_true",
        help="tests marked nightly, too, and more examples of each property test",
    )
    parser.addoption(
        "--nightly-only",
        action="store_true",
        help="like --nightly, without the tests that try no more than by day",
    )
    parser.addoption(
        "--examples",
        type=int,
        default=3,
        metavar="FACTOR",
        help="with --nightly: examples of a property test, as a multiple of what it states (3)",
    )
    parser.addoption(
        "--examples-time",
        type=float,
        default=float("inf"),
        metavar="SECONDS",
        help="with --nightly: time after which a property test begins no further round of examples",
    )


def pytest_configure(config: pytest.Config) -> None:
    # How long an example takes tells of the machine: of kernels that it compiles, of what else it does.
    hypothesis.settings.register_profile("whenever", deadline=None)
    hypothesis.settings.load_profile("whenever")
    # Processes of xdist have the width of a terminal, which tables of commands would keep to.
    os.environ.pop("COLUMNS", None)
    # All of a plan is megabytes, and what was found would not be told.
    for_type_by_name(
        "twin.trial.plan_result", "PlanResult", lambda plan, to, _: to.text(repr(plan))
    )
    if "PYTEST_XDIST_WORKER" in os.environ:
        from tests.kernels import compile_once

        compile_once(Path(config.cache.mkdir("kernels")))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Put the longest files first; leave what is for the night to it, most examples, too."""
    from tests.longest import ranks

    known = ranks()
    items.sort(key=lambda item: known.get(item.nodeid.split("::")[0], len(known)))
    nightly_only = config.getoption("--nightly-only")
    nightly = nightly_only or config.getoption("--nightly")
    if nightly_only:
        _deselect(config, items, lambda item: not _tries_more_at_night(item))
    elif not nightly:
        _deselect(config, items, lambda item: bool(item.get_closest_marker("nightly")))
    rounds = {
        test: _set_examples_of_day(test, config.getoption("--examples"))
        for test in {getattr(item, "function", None) for item in items}
        if hasattr(test, SETTINGS)
    }
    for item in items if nightly else ():
        if item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(NIGHTLY_S))
        if isinstance(item, pytest.Function) and item.function in rounds:
            limit_s = config.getoption("--examples-time")
            item.obj = _in_rounds(item.obj, rounds[item.function], limit_s)


def _set_examples_of_day(test: Any, factor: int) -> int:
    """Let a property test try as many examples as by day; return how often it does at night.

    Args:
        test: the test, with settings of hypothesis.
        factor: examples at night, as a multiple of what the test states.
    """
    own = getattr(test, SETTINGS)
    many: int = own.max_examples
    by_day = max(min(many, FEW_EXAMPLES), many // 3)
    setattr(test, SETTINGS, hypothesis.settings(own, max_examples=by_day))
    return -(-factor * many // by_day)


def _in_rounds(
    test: Callable[..., None], rounds: int, limit_s: float
) -> Callable[..., None]:
    """Return a property test that is tried several times, with other examples each.

    Hypothesis has no limit of time: a test that is slow begins no further round after it.
    """

    @functools.wraps(test)
    def repeated(**given: Any) -> None:
        end = time.monotonic() + limit_s
        for _ in range(rounds):
            test(**given)
            if time.monotonic() > end:
                break

    return repeated


def _deselect(
    config: pytest.Config,
    items: list[pytest.Item],
    leaves_out: Callable[[pytest.Item], bool],
) -> None:
    """Take the tests that a predicate names out of the list, and report them as deselected."""
    out = {item for item in items if leaves_out(item)}
    config.hook.pytest_deselected(items=sorted(out, key=str))
    items[:] = [item for item in items if item not in out]


def _tries_more_at_night(item: pytest.Item) -> bool:
    """Return whether a test is marked nightly, or is a property test, whose examples increase."""
    function = getattr(item, "function", None)
    return bool(item.get_closest_marker("nightly")) or hasattr(function, SETTINGS)


class HangingTestError(BaseException):
    """A test takes longer than it may.

    No ``Exception``: property tests would try the example again, and wait for ever.
    """


@pytest.hookimpl(wrapper=True)
def pytest_timeout_set_timer(
    item: pytest.Item, settings: Any
) -> Generator[None, object, object]:
    """Let the timer show the stacks of all threads and end the test."""
    done = yield

    def end(number: int, frame: object) -> None:
        faulthandler.dump_traceback()
        raise HangingTestError(f"{item.nodeid} takes more than {settings.timeout:g} s")

    if settings.method == "signal":
        signal.signal(signal.SIGALRM, end)
    return done


def pytest_collection_finish() -> None:
    """Let the search for garbage leave alone what was imported, which stays."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    gc.unfreeze()


class _Scopes(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Keeps a file's tests in one process, as they share what they plan; commands of docs do not."""

    def _split_scope(self, nodeid: str) -> str:
        if nodeid.startswith("tests/docs/test_commands.py"):
            return nodeid
        return str(super()._split_scope(nodeid))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """Return who says which tests run in which process."""
    config.option.loadscopereorder = False
    return _Scopes(config, log)


@pytest.fixture(scope="session")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> ShippedRuns:
    """Return the runs of the shipped scenarios, which all processes of a session share."""
    from tests.shipped_runs import ShippedRuns

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return ShippedRuns(folder / "shipped")


@pytest.fixture(scope="session")
def planned_once() -> PlannedOnce:
    """Return what plans the motions of any scenario once."""
    from tests.planned_once import PlannedOnce

    return PlannedOnce()
