"""Configurations of a robot by number, for tables of motions between them."""

from __future__ import annotations

from planning.transforms import Array


class NumberedConfigurations:
    """Configurations of a robot; equal ones have the same number, and HOME has number 0.

    Args:
        home: HOME of the robot, shape (n,).

    Attributes:
        items: the configurations, by number.
    """

    def __init__(self, home: Array) -> None:
        self.items = [home]
        self._number = {home.tobytes(): 0}

    def number(self, item: Array) -> int:
        """Return the number of a configuration, shape (n,); a new one is added."""
        found = self._number.setdefault(item.tobytes(), len(self.items))
        if found == len(self.items):
            self.items.append(item)
        return found
