"""PyBullet, imported without the line that it writes to standard error when it is loaded."""

from __future__ import annotations

from twin.host.silence import silenced

with silenced():
    import pybullet

__all__ = ["pybullet"]
