"""Tasks of the open benchmark: which there are, how large, and how further ones are brought in."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from twin.trial.loaded_scenario import LoadedScenario, load

Size = Literal["small", "middle", "large"]


@dataclass(frozen=True)
class OpenTask:
    """A task.

    Attributes:
        name: in tables.
        scenario: that comes with the program, or a file.
        size: of the work: up to 15, 60 or more steps.
        source: where it comes from.
    """

    name: str
    scenario: Path
    size: Size
    source: str

    def load(self) -> LoadedScenario:
        """Return its scenario."""
        return load(self.scenario)


TASKS: tuple[OpenTask, ...] = (
    OpenTask(
        "cliff", Path("cliff"), "small", "LEGO, after APEX-MR's task of that name"
    ),
    OpenTask(
        "stairs", Path("stairs"), "small", "LEGO, after APEX-MR's task of that name"
    ),
    OpenTask("gearbox", Path("gearbox"), "small", "parts, tools that are changed"),
    OpenTask("tray", Path("tray"), "small", "parts into a tray"),
    OpenTask("tower", Path("tower"), "small", "construction, after Hartmann et al."),
    OpenTask(
        "taskboard", Path("taskboard"), "middle", "parts, after the boards of NIST"
    ),
    OpenTask("truss", Path("truss"), "middle", "bars that are welded"),
    OpenTask("wall", Path("wall"), "middle", "construction, after Hartmann et al."),
    OpenTask(
        "bridge", Path("bridge"), "middle", "LEGO, after APEX-MR's task of that name"
    ),
    OpenTask("kitting", Path("kitting"), "large", "a line with a conveyor and feeders"),
    OpenTask(
        "vessel", Path("vessel"), "large", "LEGO, after APEX-MR's task of that name"
    ),
)
"""Those that come with the program."""


def chosen(names: list[str], sizes: list[str]) -> Iterator[OpenTask]:
    """Yield the tasks of some names, or of some sizes.

    Raises:
        SystemExit: there is no task of a name.
    """
    known = {task.name: task for task in TASKS}
    for name in names:
        if name not in known:
            raise SystemExit(f"no task {name!r}; there are {', '.join(known)}")
        yield known[name]
    if not names:
        yield from (task for task in TASKS if task.size in sizes)


def brought(file: Path) -> OpenTask:
    """Return the task of a scenario file, such as twin import writes."""
    steps = load(file).steps
    size: Size = "small" if steps <= 15 else "middle" if steps <= 60 else "large"
    return OpenTask(file.stem, file.resolve(), size, str(file.name))
