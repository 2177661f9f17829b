"""Fingerprints of a run: what its plan and its events are, small enough to be committed.

A hash of the bytes would be stricter, but not the same on every processor: BLAS and the vector
units of numpy choose their instructions by the CPU, and the last bits of a sum go with them. What
is discrete (node kinds, edges, who waits for whom) is therefore hashed, array by array, and what
is measured (joint angles, times, poses) is added up with a weight a value and compared within a
tolerance. A value that moves by a thousandth shows in the sum; the last bit of one does not, on
whichever side of a rounding limit it may fall.
"""

import json
from collections.abc import Mapping
from hashlib import sha256
from math import fsum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

TOLERANCE = 1e-9
"""Difference of two sums that counts as none, as a share of their terms' absolute sum."""

Print = dict[str, Any]


def run_fingerprint(folder: Path) -> dict[str, Print]:
    """Return the fingerprint of each array of ``plan.npz`` and each field of ``events.jsonl``."""
    with np.load(folder / "plan.npz", allow_pickle=False) as archive:
        arrays = {f"plan.npz {name}": archive[name] for name in sorted(archive.files)}
    lines = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()
    # Robot by robot: what two of them do at the same time may be written either way round.
    events = sorted(map(json.loads, lines), key=lambda event: str(event["robot"]))
    for field in events[0]:
        arrays[f"events.jsonl {field}"] = np.array([event[field] for event in events])
    return {name: fingerprint(values) for name, values in arrays.items()}


def fingerprint(values: npt.NDArray[Any]) -> Print:
    """Return type and shape of an array with its hash or, of floats, its weighted sum."""
    about: Print = {"dtype": values.dtype.kind, "shape": list(values.shape)}
    if values.dtype.kind != "f":
        content = json.dumps(values.ravel().tolist()).encode()
        return about | {"sha256": sha256(content).hexdigest()}
    # Fractions of multiples of the golden ratio: spread evenly, and the same everywhere.
    weights = np.modf(np.arange(1, values.size + 1) * 0.6180339887498949)[0]
    terms = weights * values.ravel()
    return about | {"sum": fsum(terms), "scale": fsum(np.abs(terms))}


def differences(
    found: Mapping[str, Print], committed: Mapping[str, Print]
) -> list[str]:
    """Return one line for each array or field that is not what it was."""
    out = []
    for name in sorted({*found, *committed}):
        if name not in found or name not in committed:
            out.append(f"{name}: {'new' if name in found else 'gone'}")
        elif not _agree(found[name], committed[name]):
            out.append(f"{name}: {_words(committed[name])} -> {_words(found[name])}")
    return out


def _agree(one: Print, other: Print) -> bool:
    if "sum" not in one or "sum" not in other or one["shape"] != other["shape"]:
        return one == other
    return bool(abs(one["sum"] - other["sum"]) <= TOLERANCE * (1.0 + other["scale"]))


def _words(about: Print) -> str:
    value = about["sum"] if "sum" in about else about["sha256"][:16]
    return f"{about['dtype']}{about['shape']} {value}"
