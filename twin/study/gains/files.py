"""``gains.json`` and ``gains.csv``: what is worth fixing, as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from twin.host.atomic import write_json, write_text
from twin.study.gains.gains import SHORTER, CellGains, Gain, Saving
from twin.study.replications.experiment import Experiment

JSON, CSV = "gains.json", "gains.csv"


def write_gains(
    folder: Path, experiment: Experiment, cells: Sequence[CellGains]
) -> None:
    """Write what is worth fixing in every cell of a study, as JSON and as CSV.

    Raises:
        OutputError: a file cannot be written.
    """
    write_json(folder / JSON, _content(experiment, cells))
    text = io.StringIO()
    rows = list(_rows(experiment, cells))
    varied = list(experiment.variants[0])
    names = ["policy", *varied, "replications", "rank", "kind", "many"]
    names += ["name", "robot", "task"]
    for less in ("shorter", "gone"):
        for statistic in ("mean", "p90"):
            name = f"{less}_{statistic}_s"
            names += [name, f"{name}_low", f"{name}_high"]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    write_text(folder / CSV, text.getvalue())


def _rows(
    experiment: Experiment, cells: Sequence[CellGains]
) -> Iterator[list[str | int | float | None]]:
    for (policy, variant), cell in zip(experiment.cells, cells, strict=True):
        for rank, gain in enumerate(cell.gains, start=1):
            lever = gain.lever
            row: list[str | int | float | None] = [policy, *map(str, variant.values())]
            row += [cell.replications, rank, lever.kind, str(lever.many).lower()]
            row += [lever.name, lever.robot, lever.task]
            for saving in (gain.shorter, gain.gone):
                for interval in (saving.mean, saving.p90):
                    content = interval.content()
                    row += [content[key] for key in ("estimate", "low", "high")]
            yield row


def _content(experiment: Experiment, cells: Sequence[CellGains]) -> dict[str, Any]:
    return {
        "confidence": experiment.precision.confidence,
        "shorter": SHORTER,
        "cells": [
            {
                "policy": policy,
                "variant": dict(variant),
                "replications": cell.replications,
                "engine": cell.engine,
                "gains": [_gain(gain) for gain in cell.gains],
            }
            for (policy, variant), cell in zip(experiment.cells, cells, strict=True)
        ],
    }


def _gain(gain: Gain) -> dict[str, Any]:
    lever = gain.lever
    return {
        "kind": lever.kind,
        "many": lever.many,
        "name": lever.name,
        "robot": lever.robot,
        "task": lever.task,
        "shorter": _saving(gain.shorter),
        "gone": _saving(gain.gone),
    }


def _saving(saving: Saving) -> dict[str, Any]:
    return {"mean_s": saving.mean.content(), "p90_s": saving.p90.content()}
