"""Encoder for CDR, the binary format of ROS 2 messages.

Numbers are little-endian, and each is aligned to its own size.
"""

from __future__ import annotations

import struct

import numpy as np

from planning.transforms import Array
from twin.durations.nanoseconds import NANOSECONDS

_ENCAPSULATION = b"\x00\x01\x00\x00"


class CdrMessage:
    """A message that is written field by field, in the order of its definition."""

    def __init__(self) -> None:
        self._data = bytearray(_ENCAPSULATION)

    @property
    def data(self) -> bytes:
        """The bytes written so far."""
        return bytes(self._data)

    def numbers(self, form: str, *values: float) -> None:
        """Write numbers of a form of ``struct``: B for bytes and bools, i, I or f."""
        self._align(struct.calcsize(form))
        self._data += struct.pack(f"<{len(values)}{form}", *values)

    def count(self, length: int) -> None:
        """Write the length of a sequence or a string."""
        self.numbers("I", length)

    def float64(self, values: Array) -> None:
        """Write numbers of double precision, without their count."""
        if values.size:
            self._align(8)
            self._data += np.ascontiguousarray(values, dtype="<f8").tobytes()

    def string(self, value: str) -> None:
        """Write a string."""
        encoded = value.encode() + b"\x00"
        self.count(len(encoded))
        self._data += encoded

    def strings(self, values: tuple[str, ...]) -> None:
        """Write a sequence of strings."""
        self.count(len(values))
        for value in values:
            self.string(value)

    def sequence(self, values: Array | None) -> None:
        """Write a sequence of numbers of double precision; None is an empty one."""
        self.count(0 if values is None else values.size)
        if values is not None:
            self.float64(values)

    def time(self, t_ns: int) -> None:
        """Write a time or a duration [ns]."""
        seconds, rest = divmod(t_ns, NANOSECONDS)
        self.numbers("i", seconds)
        self.numbers("I", rest)

    def header(self, t_ns: int, frame: str) -> None:
        """Write a ``std_msgs/Header``."""
        self.time(t_ns)
        self.string(frame)

    def _align(self, size: int) -> None:
        """Fill up with zeros; sizes count from behind the header."""
        self._data += bytes(-(len(self._data) - len(_ENCAPSULATION)) % size)
