"""The report beside VAMP-MR: means over seeds, shares of published makespans, and curves."""

from pathlib import Path
from typing import Any

from benchmarks.peers import PEERS, draw_curves, table


def row(task: str, shortcut_s: float, seed: int, makespan_s: float) -> dict[str, Any]:
    return {
        "task": task,
        "shortcut_s": shortcut_s,
        "seed": seed,
        "cpu_s": 2.0 + shortcut_s,
        "makespan_s": makespan_s,
        "violations": None if task == "rss" else ["a touch"] * seed,
        "load": (1.0, 2.0),
        "commit": "abc123",
    }


ROWS = [
    row(task, shortcut_s, seed, 100.0 + 10.0 * seed - shortcut_s)
    for task in ("cliff", "rss")
    for shortcut_s in (PEERS[task].shortcut_s, 0.0)
    for seed in (0, 2)
]


def test_the_table_has_means_over_seeds_beside_published_figures() -> None:
    cliff, rss = (line for line in table(ROWS) if line.startswith(("| cliff", "| rss")))
    assert [cell.strip() for cell in cliff.split("|")[1:-1]] == [
        *("cliff", "11", "3.39", "159"),
        *("3.0 ± 0.0", "109.0 ± 14.1", "69%", "2.0 ± 0.0", "110.0 ± 14.1", "69%", "4"),
    ]
    assert rss.endswith("| not audited |")


def test_each_task_has_a_panel_of_curves(tmp_path: Path) -> None:
    picture = tmp_path / "peers.png"
    draw_curves(picture, ROWS, ROWS)
    head = picture.read_bytes()[:20]
    assert head.startswith(b"\x89PNG")
    assert int.from_bytes(head[16:20], "big") == 2 * 400
