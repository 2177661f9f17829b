"""What the keys of sections mean, from the docstrings of their classes: hover help of editors."""

from __future__ import annotations

import re
from inspect import cleandoc
from typing import Any

from pydantic import BaseModel

_ATTRIBUTES = re.compile(r"^Attributes:\n((?:[ ]+.*\n?|\n)*)", re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+(?:, \w+)*): ")
_OR = re.compile(r"; or(?: else)?$")
_CODE = re.compile(r"``([^`]+)``")


def described(schema: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of a section whose properties say what they mean.

    Args:
        schema: of the section itself, without references at its top.
        model: its class.
    """
    about = summary(model)
    meanings = attributes(model)
    names = {field.alias or name: name for name, field in model.model_fields.items()}
    properties = {}
    for key, part in schema.get("properties", {}).items():
        words = meanings.get(names.get(key, key))
        if "const" in part and isinstance(part["const"], str):
            words = f"`{part['const']}`: {about.split('. ')[0].rstrip('.')}."
        properties[key] = part if words is None else {**part, "description": words}
    return {**schema, "description": about, "properties": properties}


def summary(model: type[BaseModel]) -> str:
    """Return what the docstring of a class says before its attributes, in one paragraph."""
    text = _ATTRIBUTES.split(cleandoc(model.__doc__ or ""))[0]
    return _plain(text.split("\n\nRaises:")[0])


def attributes(model: type[BaseModel]) -> dict[str, str]:
    """Return the meanings of the attributes of a class and of its bases, by name."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        match = _ATTRIBUTES.search(cleandoc(base.__doc__ or "") + "\n")
        if match is None or base is BaseModel:
            continue
        names: list[str] = []
        for line in match[1].splitlines():
            entry = _ENTRY.match(line)
            if entry is not None:
                names = entry[1].split(", ")
                told = ", ".join(f"``{name}``" for name in names)
                start = "" if len(names) == 1 else f"{told}: "
                found |= dict.fromkeys(names, start + line[entry.end() :])
            else:
                found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return {name: _plain(words) for name, words in found.items()}


def _plain(text: str) -> str:
    """Return a docstring's text in one line, code in single quotes as Markdown has it."""
    words = " ".join(_CODE.sub(r"`\1`", text).split())
    words = _OR.sub(".", words)
    return words[:1].upper() + words[1:]
