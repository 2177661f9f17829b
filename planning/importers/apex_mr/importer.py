"""Import of task files as the authors of APEX-MR publish them, as a scenario.

Expected in the folder: ``assembly_tasks/<task>.json``, ``env_setup/env_setup_<task>.json``,
``lego_library.json``, ``plate_calibration.json`` and ``robot_properties/``; ``steps/`` only for
the prescribed stock, ``user_config.json`` only for other twist angles than usual. The result is
the plain content of a scenario file.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from planning.errors import ScenarioError
from planning.importers.apex_mr.brick_steps import (
    brick_names,
    published_bricks,
    published_steps,
    published_stock,
)
from planning.importers.apex_mr.published_cell import (
    published_plates,
    published_robots,
    published_twists,
    table_below,
)
from planning.importers.apex_mr.task_files import Notes, read_json


def available_tasks(folder: Path) -> tuple[str, ...]:
    """Return the tasks in a folder of published files, sorted."""
    tasks = _task_folder(folder) / "assembly_tasks"
    return tuple(sorted(f.stem for f in tasks.glob("*.json")))


def import_apex_mr(
    folder: Path,
    task: str,
    *,
    prescribed_stock: bool = False,
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Read one published task.

    Args:
        folder: holds the published files, or is the repository that has them in
            ``config/lego_tasks``.
        task: name of the task, such as ``"cliff"``.
        prescribed_stock: take the stock brick of each step as published, from
            ``steps/<task>_seq.json`` where there is one, instead of leaving it to the planner.
        note: called with a line for everything that is not taken over: keys that say nothing
            to us, prescribed bricks that the stock no longer has to give.

    Returns:
        A scenario as plain dictionaries, lists, strings and numbers, in the shape of a
        scenario file.

    Raises:
        ScenarioError: a file is missing or cannot be read as described; names file and key,
            and the tasks there are.
    """
    folder = _task_folder(Path(folder))
    tasks = available_tasks(folder)
    if task not in tasks:
        raise ScenarioError(f"no published task {task!r} in {folder}", choices=tasks)
    notes = Notes()
    library = read_json(folder / "lego_library.json")
    names = brick_names(library)
    robots = published_robots(folder)
    plates = published_plates(folder, notes)
    stock = published_stock(_stock_file(folder, task), names, notes)
    sequence = folder / "assembly_tasks" / f"{task}.json"
    chosen = folder / "steps" / f"{task}_seq.json"
    if prescribed_stock and chosen.exists():
        sequence = chosen
    steps = published_steps(sequence, names, stock if prescribed_stock else None, notes)
    bricks = published_bricks(library, names, notes)
    for line in notes.lines():
        note(line)
    return {
        "version": 1,
        "name": re.sub(r"[^A-Za-z0-9_.-]", "_", task),
        "seed": 0,
        "cell": {"robots": robots, "fixtures": [table_below(robots, plates)]},
        "assembly": {
            "kind": "lego",
            **plates,
            "bricks": bricks,
            "stock": stock,
            "steps": steps,
            **published_twists(folder),
        },
    }


def _task_folder(folder: Path) -> Path:
    inner = folder / "config" / "lego_tasks"
    if not (folder / "assembly_tasks").is_dir() and inner.is_dir():
        return inner
    return folder


def _stock_file(folder: Path, task: str) -> Path:
    path = folder / "env_setup" / f"env_setup_{task}.json"
    if not path.exists():
        others = sorted(path.parent.glob("env_setup_*.json"))
        raise ScenarioError(
            f"{path}: cannot be read: task {task!r} comes without a stock",
            choices=tuple(p.stem.removeprefix("env_setup_") for p in others),
        )
    return path
