"""Parser of JSON documents of bounded size."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

MOST_VALUES = 4_000_000
"""Greatest number of values in a JSON document; each takes some 100 bytes in memory."""

_SURROGATE = re.compile(r"\\ud[89a-f]", re.IGNORECASE)


def parse_json(content: bytes | str, parse_float: Callable[[str], Any] = float) -> Any:
    """Return the value of a JSON document of bounded size.

    Args:
        content: the document.
        parse_float: returns the value of a number that is not whole.

    Raises:
        ValueError: it is no JSON; it has too many values, is nested too deeply, names a key of an
            object twice, says NaN or Infinity, or has half of a surrogate pair.
    """
    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
    except UnicodeDecodeError as error:  # whose representation has the whole content
        raise ValueError(f"not UTF-8 (byte {error.start})") from None
    if sum(map(text.count, ",[{")) > MOST_VALUES:
        raise ValueError(f"it has more than {MOST_VALUES} values")
    try:
        found = json.loads(
            text,
            object_pairs_hook=_with_unique_keys,
            parse_float=parse_float,
            parse_constant=_refuse_constant,
        )
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if _SURROGATE.search(text) is not None:
        try:
            json.dumps(found, ensure_ascii=False, default=str).encode()
        except UnicodeEncodeError:  # no file and no terminal takes it
            raise ValueError("a text has half of a surrogate pair") from None
    return found


def _with_unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = Counter(name for name, _ in pairs)
        twice = names.most_common(1)[0][0]
        raise ValueError(f"key {twice[:100]!r} is given twice")
    return found


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is no number")
