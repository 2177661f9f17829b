"""Files ``gains.json`` and ``gains.csv``: how much interventions would reduce the makespan.

An *intervention* shortens a part of the plan, such as a skill or a wait; a *cell* of a study is one policy
with one variant of the inputs.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from twin.host.atomic_files import write_json, write_text
from twin.studies.gains.gains import (
    INTERVENTION_FIELDS,
    SHORTER,
    CellGains,
    gain_content,
)
from twin.studies.replications.experiment import Experiment

JSON, CSV = "gains.json", "gains.csv"


def write_gains(
    folder: Path, experiment: Experiment, cells: Sequence[CellGains]
) -> None:
    """Write the reductions of the makespan by interventions in every cell of a study, as JSON and as CSV.

    Raises:
        OutputError: a file cannot be written.
    """
    content = {
        "confidence": experiment.precision.confidence,
        "shorter": SHORTER,
        "cells": [
            {
                "policy": policy,
                "variant": dict(variant),
                "replications": cell.replications,
                "engine": cell.engine,
                "gains": [gain_content(gain) for gain in cell.gains],
            }
            for (policy, variant), cell in zip(experiment.cells, cells, strict=True)
        ],
    }
    write_json(folder / JSON, content)
    names = [
        "policy",
        *experiment.variants[0],
        "replications",
        "rank",
        *INTERVENTION_FIELDS,
    ]
    for less, statistic in product(("shorter", "gone"), ("mean_s", "p90_s")):
        names += [f"{less}_{statistic}{bound}" for bound in ("", "_low", "_high")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for (policy, variant), cell in zip(experiment.cells, cells, strict=True):
        own = [policy, *map(str, variant.values()), cell.replications]
        for rank, gain in enumerate(cell.gains, start=1):
            figures = gain_content(gain)
            row = [*own, rank, *(figures[key] for key in INTERVENTION_FIELDS)]
            row[len(own) + 2] = str(gain.intervention.many).lower()
            for less, statistic in product(("shorter", "gone"), ("mean_s", "p90_s")):
                interval = figures[less][statistic]
                row += [interval[key] for key in ("estimate", "low", "high")]
            writer.writerow(row)
    write_text(folder / CSV, text.getvalue())
