"""Function ``twin.load``, and the validated scenario with its source file that it returns."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import ScenarioError
from twin.document.validation import parse_document
from twin.document.yaml_text import YamlDocument, scenario_text
from twin.host.arguments import checks_arguments
from twin.reading.checks import execution_problems, find_problems
from twin.reading.scenario_file import parse_scenario, read_scenario
from twin.registry import FIGURES
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.scenario.shipped import scenario_path
from twin.scenario.variations import apply_variation, is_of_execution

if TYPE_CHECKING:
    from twin.scenario.sections.kind import AssemblySection

PathOrName = str | PathLike[str]
"""Path of a file or folder."""


@dataclass(frozen=True)
class LoadedScenario:
    """A valid scenario and its source.

    Attributes:
        sections: the content: cell, assembly, planning, execution.
        folder: where relative paths in it start.
        written: its file; None for one that is in no file of its own, as that of a manifest.
    """

    sections: Scenario
    folder: Path = Path()
    written: YamlDocument | None = None

    @cached_property
    def document(self) -> YamlDocument:
        """Source text for positions in messages; rendered from the content if there is no file."""
        if self.written is not None:
            return self.written
        # JSON is YAML, too: findings have the position of their key.
        text = json.dumps(resolve_scenario(self.sections), indent=2)
        return parse_document(self.folder / f"{self.name}.yaml", text)

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.sections.name

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots."""
        return tuple(robot.name for robot in self.sections.cell.robots)

    @property
    def steps(self) -> int:
        """Number of steps of the assembly."""
        from twin.scenario.sections.kind import assembly_kind

        return assembly_kind(self.sections.assembly).steps()

    @checks_arguments
    def varied(self, values: Mapping[str, Any]) -> LoadedScenario:
        """Return the scenario with the values of some keys replaced.

        Args:
            values: by key: a dotted path from the top, such as
                ``cell.robots.left.base.xyz_m.0``, whose entries of lists are named by position
                or name; a key of the execution section, such as ``stalls.rate_per_h``; or
                ``robots``, for how many there are.

        Raises:
            ScenarioError: there is no such key, or a value does not fit.
        """
        if not values:
            return self
        sections = apply_variation(self.sections, values)
        alone = all(map(is_of_execution, values))
        problems = execution_problems if alone else find_problems
        found = dict.fromkeys(text for _, text in problems(sections, self.folder))
        if found:
            said = "; ".join(found)
            raise ScenarioError(f"cannot vary {', '.join(values)}: {said}")
        return replace(self, sections=sections)

    def with_assembly(self, section: AssemblySection | None) -> LoadedScenario:
        """Return the scenario with another section of its assembly, unchanged where that is None."""
        changed = {} if section is None else {"assembly": section}
        return replace(self, sections=self.sections.changed(**changed))

    def resolved(self) -> dict[str, Any]:
        """Return the content with every default filled in, as JSON would hold it."""
        return resolve_scenario(self.sections)

    def __repr__(self) -> str:
        """Return a one-line description; ``resolved`` has the whole content."""
        from twin.scenario.sections.kind import assembly_kind

        kind = assembly_kind(self.sections.assembly)
        size = f"{len(self.robots)} robots, {kind.steps()} steps, {kind.supply()}"
        return f"<scenario {self.name!r} of kind {self.sections.assembly.kind}: {size}>"

    def _repr_html_(self) -> str:
        from twin.host.cards import card, inline_picture

        rows = [
            ("robots", ", ".join(self.robots)),
            ("assembly", f"{self.sections.assembly.kind}, {self.steps} steps"),
            ("seed", str(self.sections.seed)),
        ]
        if self.sections.description:
            rows.insert(0, ("description", self.sections.description))
        page = card(self.name, rows)
        if "cell" not in FIGURES:
            return page
        return page + inline_picture(FIGURES.load("cell")(self.sections, self.folder))


AnyScenario = PathOrName | Mapping[str, Any] | LoadedScenario
"""A scenario, its content, the path of its file, or the name of one that comes with the program."""


@checks_arguments
def load(scenario: AnyScenario) -> LoadedScenario:
    """Read and check a scenario file.

    Args:
        scenario: path of the YAML file, or the name of a scenario that comes with the program
            (``twin scenarios``); or what such a file contains, with paths from the current folder. One that was loaded
            before is returned as it is.

    Raises:
        InvalidScenarioError: with every problem found, each at its line and column.
        ScenarioError: there is neither such a file nor a scenario of that name.
    """
    if isinstance(scenario, LoadedScenario):
        return scenario
    if isinstance(scenario, Mapping):
        path = Path("scenario.yaml")
        sections, document = parse_scenario(path, scenario_text(dict(scenario), ""))
        return LoadedScenario(sections, path.parent, document)
    path = scenario_path(Path(scenario))
    sections, document = read_scenario(path)
    return LoadedScenario(sections, path.parent, document)
