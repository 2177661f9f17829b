"""The chart keeps to the grammar of Mermaid's Gantt charts and shows the run."""

from __future__ import annotations

import re
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import pytest

from tests.twin.exports.exported_runs import exported, toy_run
from twin.exports.timelines import _plain
from twin.run.run_record import ExecutionRecord
from twin.trial.run_result import RunResult

_TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}"
_TEXT = r"[^:;#,%{}\n]+"
_BAR = re.compile(
    rf"    (?P<label>{_TEXT}?) :(?:(?P<tag>active|done|crit), )?(?P<start>{_TIME}), (?P<end>{_TIME})"
)
_HEADER = [
    re.compile("gantt"),
    re.compile(rf"    title {_TEXT}"),
    re.compile("    dateFormat YYYY-MM-DDTHH:mm:ss.SSS"),
    re.compile("    axisFormat %H:%M:%S"),
]
_KEYWORDS = re.compile(
    r"(gantt|title|section|dateFormat|axisFormat|tickInterval|todayMarker|inclusiveEndDates"
    r"|topAxis|excludes|includes|weekday|weekend|click|accTitle|accDescr|call|href)\b"
)

Bar = tuple[str, str, int, int]


def read_chart(content: bytes) -> dict[str, list[Bar]]:
    """Return label, tag, start and end [ms] of the bars of each section."""
    lines = content.decode("utf-8").splitlines()
    for line, rule in zip(lines, _HEADER, strict=False):
        assert rule.fullmatch(line), line
    sections: dict[str, list[Bar]] = {}
    bars: list[Bar] = []
    for line in lines[len(_HEADER) :]:
        if found := re.fullmatch(rf"    section ({_TEXT})", line):
            bars = sections.setdefault(found[1], [])
            continue
        bar = _BAR.fullmatch(line)
        assert bar, line
        assert not _KEYWORDS.match(bar["label"]), line
        bars.append(
            (bar["label"], bar["tag"] or "", _ms(bar["start"]), _ms(bar["end"]))
        )
    return sections


def _ms(text: str) -> int:
    passed = datetime.fromisoformat(text) - datetime(2000, 1, 1)
    return round(passed.total_seconds() * 1000)


@pytest.fixture
def case(tmp_path: Path) -> tuple[RunResult, ExecutionRecord]:
    return toy_run(tmp_path)


def test_bars_show_what_robots_did(case: tuple[RunResult, ExecutionRecord]) -> None:
    recorded, run = case
    sections = read_chart(exported(recorded, "mermaid")["gantt.mmd"])
    assert list(sections) == [chain.robot for chain in recorded.tpg.chains]
    least_ms = run.makespan_ns / 1e6 * 0.005
    for k, chain in enumerate(recorded.tpg.chains):
        bars = sections[chain.robot]
        assert bars[-1][3] == run.end_ns[k][-1] // 10**6
        for before, after in pairwise(bars):
            assert before[3] <= after[2] <= before[3] + least_ms + 2
            assert after[3] > after[2]
        labels = {label for label, tag, *_ in bars if tag in ("", "active")}
        long = [
            m
            for m in set(chain.task.tolist())
            if run.duration_ns[k][chain.task == m].sum() > 10**6
        ]
        assert labels == {recorded.tpg.tasks[m].label for m in long}
        waits = [w for w in run.waits() if w.chain == k]
        seen = sum(w.end_ns - w.start_ns > 2e6 * least_ms for w in waits)
        shown = [bar for bar in bars if bar[0] == "waiting"]
        assert len(shown) >= seen > 0 or not seen
        assert all(tag == "done" for _, tag, *_ in shown)


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("place a: b; c", "place a b c"),
        ("50 % {x} #1, 2", "50 x 1 2"),
        ("section one", "- section one"),
        ("click", "- click"),
        ("", "-"),
        ("HOME with left_2x4", "HOME with left_2x4"),
    ],
)
def test_labels_mean_nothing_to_mermaid(text: str, plain: str) -> None:
    assert _plain(text) == plain
