"""CDR, the form that messages of ROS 2 have in a file: little-endian, plain, aligned to own size."""

from __future__ import annotations

import struct

import numpy as np

from planning.transforms import Array
from twin.durations import NANOSECONDS

_HEADER = b"\x00\x01\x00\x00"


class CdrMessage:
    """A message that is written field by field, in the order of its definition."""

    def __init__(self) -> None:
        self._data = bytearray(_HEADER)

    @property
    def data(self) -> bytes:
        """What has been written so far."""
        return bytes(self._data)

    def uint8(self, value: int) -> None:
        """Write a byte; a bool is one too."""
        self._data.append(value)

    def int32(self, value: int) -> None:
        """Write a signed integer."""
        self._align(4)
        self._data += struct.pack("<i", value)

    def uint32(self, value: int) -> None:
        """Write an unsigned integer; the length of a sequence is one too."""
        self._align(4)
        self._data += struct.pack("<I", value)

    def float32(self, *values: float) -> None:
        """Write numbers of single precision."""
        self._align(4)
        self._data += struct.pack(f"<{len(values)}f", *values)

    def float64(self, values: Array) -> None:
        """Write numbers of double precision, without their count."""
        if values.size:
            self._align(8)
            self._data += np.ascontiguousarray(values, dtype="<f8").tobytes()

    def string(self, value: str) -> None:
        """Write a string."""
        encoded = value.encode() + b"\x00"
        self.uint32(len(encoded))
        self._data += encoded

    def strings(self, values: tuple[str, ...]) -> None:
        """Write a sequence of strings."""
        self.uint32(len(values))
        for value in values:
            self.string(value)

    def sequence(self, values: Array | None) -> None:
        """Write a sequence of numbers of double precision; None is an empty one."""
        self.uint32(0 if values is None else values.size)
        if values is not None:
            self.float64(values)

    def time(self, t_ns: int) -> None:
        """Write a time or a duration [ns]."""
        seconds, rest = divmod(t_ns, NANOSECONDS)
        self.int32(seconds)
        self.uint32(rest)

    def header(self, t_ns: int, frame: str) -> None:
        """Write a ``std_msgs/Header``."""
        self.time(t_ns)
        self.string(frame)

    def _align(self, size: int) -> None:
        """Fill up with zeros; sizes count from behind the header."""
        self._data += bytes(-(len(self._data) - len(_HEADER)) % size)
