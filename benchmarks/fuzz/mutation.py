"""Random damage to documents, texts, bytes and arrays."""

import copy
import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

NASTY: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 3, 7, 1000, -50),
    *(10**9, 10**18, 2**63, -(2**63) - 1, 10**40),
    *(0.5, -0.5, 1e-6, 1e-12, 5e-324, 1e-308, 1e9, 1e30, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf"), 0.1 + 0.2, 1e999),
    *("", " ", "x", "0", "1e3", "nan", "true", "null", "a" * 300, "a" * 70_000),
    *("\x00", "a\x00b", "\x1b[31m", "\u202e", "\ud7ff\U0001f916", "../../etc", "/dev/zero"),
    *("/dev/null", "/", ".", "~", "%s%n", "${HOME}", "<x>", "{}", "[]", "*", "&a", "!!x"),
    *([], {}, [[]], [None], [1, 2, 3], ["x"], {"": 0}, {"kind": "x"}, {"file": "/dev/zero"}),
)  # fmt: skip
"""Values that programs trip over."""

Path = tuple[Any, ...]


def mutate_document(value: Any, rng: random.Random, most: int = 3) -> Any:
    """Return a document of mappings, lists and scalars with one to ``most`` random changes."""
    value = copy.deepcopy(value)
    for _ in range(rng.randint(1, most)):
        value = _changed(value, rng)
    return value


def _changed(root: Any, rng: random.Random) -> Any:
    places = [path for path in _paths(root) if path]
    if not places:
        return rng.choice(NASTY)
    *parents, key = rng.choice(places)
    holder = root
    for entry in parents:
        holder = holder[entry]
    old = holder[key]
    change = rng.choice(
        ("replace", "scale", "scale", "delete", "repeat", "swap", "add", "wrap")
    )
    if change == "scale" and isinstance(old, int | float) and not isinstance(old, bool):
        factor = rng.choice((-1, 0, 0.1, 0.5, 0.9, 1.1, 2, 10, 1000, 1e-3, 1e-9, 1e9))
        scaled = old * factor
        whole = isinstance(old, int) and abs(scaled) < 1e15
        holder[key] = round(scaled) if whole else scaled
    elif change == "delete":
        del holder[key]
    elif change == "repeat" and isinstance(holder, list):
        holder[key:key] = [copy.deepcopy(old) for _ in range(rng.choice((1, 1, 2, 50)))]
    elif change == "swap":
        other = root
        *others, last = rng.choice(places)
        for entry in others:
            other = other[entry]
        holder[key] = copy.deepcopy(other[last])
    elif change == "add" and isinstance(holder, dict):
        holder[
            rng.choice(
                ("x", "kind", "file", "name", "size_m", "", "<<", str(key) + "s")
            )
        ] = rng.choice(NASTY)
    elif change == "wrap":
        for _ in range(rng.choice((1, 2, 3, 3, 150))):
            old = [old] if rng.random() < 0.7 else {"x": old}
        holder[key] = old
    else:
        holder[key] = copy.deepcopy(rng.choice(NASTY))
    return root


def _paths(value: Any, path: Path = ()) -> list[Path]:
    out = [path]
    if isinstance(value, dict):
        for key, entry in value.items():
            out += _paths(entry, (*path, key))
    elif isinstance(value, list):
        for k, entry in enumerate(value):
            out += _paths(entry, (*path, k))
    return out


def mutate_bytes(content: bytes, rng: random.Random, most: int = 4) -> bytes:
    """Return bytes with random flips, cuts, repetitions and insertions."""
    for _ in range(rng.randint(1, most)):
        at = rng.randrange(len(content) + 1)
        size = min(rng.choice((1, 1, 2, 8, 100, 5000)), len(content) - at)
        piece = content[at : at + size]
        replacement = rng.choice((
            b"", bytes(rng.randrange(256) for _ in range(size)), piece * 2, piece[::-1],
            b"\x00" * size, b"\xff\xfe", b"\n", b"[" * 2000, b"-", b"1e999", b"9" * 5000, b"0x" + b"f" * 4000, b"'",
            b"{", b"}", b":", b"<", b">", b"/", "\u00e9".encode("latin-1"), piece.upper(),
        ))  # fmt: skip
        content = content[:at] + replacement + content[at + size :]
    return content


def mutate_array(values: npt.NDArray[Any], rng: random.Random) -> npt.NDArray[Any]:
    """Return an array of another type, shape or content."""
    out = values.copy()
    flat = out.reshape(-1)
    if flat.size and out.dtype.kind in "iuf" and rng.random() < 0.7:
        entry: Any = rng.choice((0, -1, 1, -50, 10**6, 2**31, 2**62, -(2**62)))
        if out.dtype.kind == "f":
            entry = rng.choice(
                (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 1e6, -1.0, 0.0)
            )
        limits = np.iinfo(out.dtype) if out.dtype.kind in "iu" else None
        if limits is not None:
            entry = min(max(entry, limits.min), limits.max)
        if rng.random() < 0.2:
            flat[:] = entry
        else:
            flat[rng.randrange(flat.size)] = entry
        return out
    changes: Sequence[Callable[[], npt.NDArray[Any]]] = (
        lambda: flat,
        lambda: out[:-1],
        lambda: out[:0],
        lambda: np.concatenate([out, out]) if out.ndim else np.array([out, out]),
        lambda: out[..., None],
        lambda: out.astype(np.float32) if out.dtype.kind in "iuf" else out,
        lambda: out.astype(np.int64) if np.all(np.isfinite(out)) else out,
        lambda: out.astype(str),
        lambda: out[::-1],
        lambda: np.array(0.0),
        lambda: np.array(["x"]),
        lambda: np.array([], dtype=np.complex128),
    )
    try:
        return np.asarray(rng.choice(changes)())
    except (TypeError, IndexError, ValueError):
        return np.array(7)
