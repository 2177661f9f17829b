"""Plans, recoveries and findings are the same whatever messages say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import pytest

from planning.errors import TwinError
from planning.steps.skill import Obstruction
from planning.tasks.assignment import Rejection
from scheduling.graph.plan_files import plan_sha256
from tests.twin.checks.test_check import CELL
from tests.twin.operations.operated import STACK, lost, operated, planned
from tests.twin.written import checked, written
from twin.checks.finding import Finding
from twin.engine.narrator import Narrator
from twin.operations.ledger import LedgerDraft
from twin.operations.person import Ask, Question
from twin.runs.events import EventCode

PARTS = CELL.replace("  parts:", "  grips: {positions: 2}\n  parts:")
"""Two parts, whose first grips are out of reach for one of two arms."""

WALL = (
    (Path(__file__).parents[1] / "scenarios/construction/wall.yaml")
    .read_text(encoding="utf-8")
    .replace("count: 5", "count: 2")
    .replace("columns: 9, courses: 4", "columns: 2, courses: 1")
)

ASKED = {"recovery.ask": {"answer_s": 3, "helps": 0.5}, "recovery.again": 1}

TEXTS = (
    *((Obstruction, ("words",)), (Rejection, ("what", "reason"))),
    *((Finding, ("message",)), (Question, ("words",)), (Ask, ("words",))),
)
"""Classes with texts for people, and which of their attributes these are."""


@contextmanager
def other_messages() -> Iterator[None]:
    """Replace every message by another one, always the same."""
    with pytest.MonkeyPatch.context() as patch:
        for kind, names in TEXTS:
            patch.setattr(kind, "__init__", _with_texts(kind.__init__, names))
        patch.setattr(TwinError, "__init__", _with_message(TwinError.__init__))
        patch.setattr(LedgerDraft, "give_up", _with_reason(LedgerDraft.give_up))
        patch.setattr(Narrator, "emit", _with_detail(Narrator.emit))
        yield


OTHER = "other words"


def _with_texts(init: Any, names: tuple[str, ...]) -> Any:
    @wraps(init)
    def other(self: object, *args: Any, **options: Any) -> None:
        init(self, *args, **options)
        for name in names:
            object.__setattr__(self, name, OTHER)

    return other


def _with_message(init: Any) -> Any:
    @wraps(init)
    def other(self: TwinError, message: str, **options: Any) -> None:
        init(self, OTHER, **options)

    return other


def _with_reason(give_up: Any) -> Any:
    return lambda self, step, why: give_up(self, step, OTHER)


def _with_detail(emit: Any) -> Any:
    @wraps(emit)
    def other(
        self: Narrator,
        kind: str,
        chain: int = -1,
        node: int = -1,
        name: str = "",
        detail: str = "",
        **options: Any,
    ) -> None:
        said = detail if detail in [*EventCode] else OTHER
        emit(self, kind, chain, node, name, said, **options)

    return other


def results(file: Path, chance: float, seed: int) -> dict[str, Any]:
    """Return what planning and operating an assembly come to, without any texts."""
    plan = planned(file)
    done, events = operated(plan, seed, **lost(chance), **ASKED)
    return {
        "plan": plan_sha256(plan.tpg),
        "executed": plan_sha256(done.tpg),
        "outcome": done.record.outcome,
        "ended": done.ended and done.ended.code,
        "given up": sorted(done.given_up),
        "asked": [(ask.step, ask.object, ask.helps) for ask in done.asks],
        "events": [
            (e.t_ns, e.robot, e.kind, e.task, e.node, e.object, e.code) for e in events
        ],
    }


@pytest.mark.parametrize(
    ("text", "chance", "seed"),
    [(PARTS, 0.6, 4), (STACK, 0.3, 2)],
    ids=["parts", "lego"],
)
def test_recoveries_are_the_same(
    tmp_path: Path, text: str, chance: float, seed: int
) -> None:
    file = written(tmp_path, text)
    before = results(file, chance, seed)
    assert {"failed", "recovered"} <= {event[2] for event in before["events"]}
    assert before["given up"]
    assert before["asked"]
    with other_messages():
        assert results(file, chance, seed) == before


@pytest.mark.parametrize(
    ("text", "change"),
    [
        (CELL, ("[-0.2, -0.3, 0.0155]", "[-0.2, -0.21, 0.0155]")),
        (CELL, ("[0, 0.4, 0.1155]", "[0, 2.4, 0.1155]")),
        (STACK, ("xyz_m: [0.44, 0, 1.1145]", "xyz_m: [0.44, 0.62, 1.1145]")),
        (WALL, ("turn_rad: 0.5", "turn_rad: 0.01")),
    ],
    ids=["overlap", "part", "bricks", "wall"],
)
def test_findings_are_at_the_same_keys(
    tmp_path: Path, text: str, change: tuple[str, str]
) -> None:
    file = written(tmp_path, text, change)

    def found() -> set[tuple[Any, ...]]:
        return {(f.at, f.error, f.at_start) for f in checked(file).findings}

    before = found()
    assert any(error for _, error, _ in before)
    with other_messages():
        assert found() == before
