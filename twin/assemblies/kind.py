"""What the twin asks of an assembly, whatever it is made of."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.tasks.work import AssemblyWork
from twin.scenario.document.problems import Problem
from twin.scenario.document.yaml_text import KeyPath, YamlDocument

ASSIGNMENT = "who does what"
"""Name of the stage that finds the candidates and chooses, for progress displays."""


@dataclass(frozen=True)
class Prepared:
    """An assembly that can be assigned and planned.

    Attributes:
        assembly: the data of its kind, such as a ``LegoAssembly``.
        work: what the planner needs of it.
    """

    assembly: Any
    work: AssemblyWork


class Stages(Protocol):
    """Measures and reports the stages of planning."""

    def stage(
        self, key: str, label: str | None = None
    ) -> AbstractContextManager[object]:
        """Return a context that adds its time to a stage.

        Args:
            key: of the stage in the summary.
            label: for the progress display, None where it is shown already.
        """
        ...


class AssemblyKind(Protocol):
    """The section of an assembly in a scenario, and how it becomes work."""

    def steps(self) -> int:
        """Return the number of steps."""
        ...

    def supply(self) -> str:
        """Return in words what there is to build with."""
        ...

    def names(self) -> Iterable[tuple[KeyPath, str]]:
        """Return the names of the objects it brings, each with its key in the file."""
        ...

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the objects it brings, each once."""
        ...

    def reserved(self, name: str) -> str | None:
        """Return what of its own has a name that nothing else may have, None if nothing."""
        ...

    def problems(self, document: YamlDocument) -> list[Problem]:
        """Return what cannot be as it is written."""
        ...

    def fixtures(self) -> tuple[Fixture, ...]:
        """Return the fixtures it brings."""
        ...

    def objects(self) -> tuple[CellObject, ...]:
        """Return the objects it brings."""
        ...

    def prepare(self, cell: Workcell, stages: Stages) -> Prepared:
        """Find every way to do every step.

        Args:
            cell: built of the same scenario.
            stages: told how long what takes.

        Raises:
            TwinError: the assembly cannot be built as it is.
        """
        ...
