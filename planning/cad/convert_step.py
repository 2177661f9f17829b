"""Script that converts a STEP file to GLB, run as a process of its own: see ``step_file``.

Reads the STEP file from standard input, and writes the GLB to the path that is its first argument. The other
arguments are the greatest deviation of the triangles from the surface [mm], and the limits of the process: memory
[bytes], time of the processor [s] and size of the GLB [bytes]. It imports nothing of this program.
"""

from __future__ import annotations

import sys
from pathlib import Path

ANGLE = 0.3
"""Greatest angle between neighbouring edges on round surfaces [rad]: 21 sides at least."""

NO_MEMORY = 3
"""Exit code: the limit of memory was reached."""


def _limit(memory: int, seconds: int, size: int) -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    for kind, most in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, size),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(kind, (most, most))


def main() -> int:
    """Convert standard input, and return the exit code."""
    target, deviation = Path(sys.argv[1]), float(sys.argv[2])
    content = sys.stdin.buffer.read()
    _limit(*(int(text) for text in sys.argv[3:6]))
    import cascadio

    try:
        found = cascadio.load(
            content,
            file_type="step",
            tol_linear=deviation,
            tol_angular=ANGLE,
            include_brep=True,
            use_parallel=False,
        )
        target.write_bytes(found)
    except MemoryError:
        return NO_MEMORY
    return 0


if __name__ == "__main__":
    sys.exit(main())
