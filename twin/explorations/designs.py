"""Cell designs found by an exploration, as starting points of new scenarios (``twin init --from``)."""

from __future__ import annotations

from pathlib import Path


def begin_named_design(target: Path, source: str) -> Path | None:
    """Write the scenario file of a design if ``source`` names a design.

    Args:
        target: a YAML file, or a folder.
        source: as in ``twin init --from``: ``explored#3`` or the folder of an exploration, or the name of a scenario.

    Returns:
        The file of the scenario; None where the source names no design.

    Raises:
        OutputError, RequestError: as ``begin_design``.
    """
    if "#" not in source and not (Path(source) / "journal.jsonl").is_file():
        return None
    # Slow to import; most scenarios are begun with others.
    from twin.explorations.design_scenario import begin_design

    return begin_design(target, source)
