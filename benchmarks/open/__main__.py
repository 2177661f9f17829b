"""``python -m benchmarks.open``: plan the tasks, judge every plan, and write the table."""

import argparse
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.open.entries import ENTRIES, CannotEnterError
from benchmarks.open.tasks import OpenTask, brought, chosen
from twin.judge.judge import Judgement, judge

HEAD = (
    "task",
    "entry",
    "planned s",
    "mean s",
    "P95 s",
    "contacts",
    "findings",
    "planning CPU s",
)


@dataclass(frozen=True)
class Row:
    """A plan and what became of it.

    Attributes:
        task: that it is a plan of.
        entry: who made it.
        found: what the judge says; None where there is no plan.
        why: there is none.
    """

    task: str
    entry: str
    found: Judgement | None
    why: str = ""

    def cells(self) -> list[str]:
        """Return the cells of its row."""
        if self.found is None:
            return [self.task, self.entry, *["-"] * 5, self.why]
        seconds = (self.found.planned_s, self.found.mean_s, self.found.p95_s)
        spent = self.found.planning_cpu_s
        return [
            self.task,
            self.entry,
            *("-" if s is None else f"{s:.2f}" for s in seconds),
            str(self.found.contacts),
            str(len(self.found.findings)),
            "-" if spent is None else f"{spent:.1f}",
        ]


def main() -> None:
    """Write plans, judge them, print the table."""
    asked = _arguments()
    tasks = list(chosen(asked.tasks, asked.size))
    if asked.scenario:
        tasks = [*(tasks if asked.tasks else ()), *map(brought, asked.scenario)]
    for task in tasks:
        _plan(task, asked.out / task.name, asked.entry)
    rows = [row for task in tasks for row in _judged(task, asked.out, asked.seeds)]
    lines = [HEAD, ["---"] * len(HEAD), *(row.cells() for row in rows)]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
    (asked.out / "table.md").write_text(table, encoding="utf-8")
    content = [
        {"task": row.task, "entry": row.entry, "why": row.why}
        | ({} if row.found is None else row.found.content())
        for row in rows
    ]
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    (asked.out / "table.json").write_text(text, encoding="utf-8")
    print(table)  # noqa: T201


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m benchmarks.open", description=__doc__)
    parser.add_argument(
        "tasks", nargs="*", help="names of tasks; all of --size without"
    )
    sizes = ("small", "middle", "large")
    parser.add_argument("--size", nargs="+", choices=sizes, default=["small"])
    names = [entry.name for entry in ENTRIES]
    parser.add_argument("--entry", nargs="*", choices=names, default=names)
    words = "scenario file of a further task, as twin import writes them"
    parser.add_argument("--scenario", nargs="*", type=Path, default=[], help=words)
    words = "folder of plans: <task>/<entry>.json; those that are there are judged as they are"
    parser.add_argument("--out", type=Path, default=Path("open-benchmark"), help=words)
    parser.add_argument("--seeds", type=int, default=5, help="executions under delays")
    return parser.parse_args()


def _plan(task: OpenTask, folder: Path, names: list[str]) -> None:
    """Write the plans of a task that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    loaded = task.load()
    for entry in ENTRIES:
        file = folder / f"{_stem(entry.name)}.json"
        refused = file.with_suffix(".txt")
        if entry.name not in names or file.exists():
            continue
        try:
            if not entry.possible:
                raise CannotEnterError(f"pip install {entry.needs}")
            document = entry.make(loaded)
        except CannotEnterError as error:
            refused.write_text(f"{entry.name}\n{error.message.splitlines()[0]}\n")
            continue
        refused.unlink(missing_ok=True)
        document["scenario"] = str(task.scenario)
        file.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _judged(task: OpenTask, out: Path, seeds: int) -> Iterator[Row]:
    loaded = task.load()
    for file in sorted((out / task.name).glob("*.json")):
        found = judge(file, loaded, seeds=seeds)
        yield Row(task.name, found.planner or file.stem, found)
    for file in sorted((out / task.name).glob("*.txt")):
        name, why = file.read_text().splitlines()[:2]
        yield Row(task.name, name, None, why)


def _stem(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


if __name__ == "__main__":
    main()
