"""Tables of planted mistakes, one a line: what is written in place of what, and what is said of it."""

import json


def rows(table: str) -> list[tuple[str, ...]]:
    """Return the rows of a table below its head, cells between bars; ``"\\n.."`` is JSON."""
    return [
        tuple(
            json.loads(cell) if cell.startswith('"') else cell
            for cell in (cell.strip() for cell in line.split(" | "))
        )
        for line in table.strip().splitlines()[1:]
    ]


def planted(table: str) -> dict[str, tuple[str, ...]]:
    """Return the rows of such a table by their first cells."""
    found = rows(table)
    named = {name: rest for name, *rest in found}
    assert len(named) == len(found), "a mistake is planted twice"
    return {name: tuple(rest) for name, rest in named.items()}
