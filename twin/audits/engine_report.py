"""Line of ``twin doctor`` about the engine of the audit."""

from __future__ import annotations

from twin.audits.worlds.engines import INSTALL, engine_named


def report_engine() -> tuple[str, str]:
    """Return the name of the engine that audits use by default, and what installs the better one."""
    return engine_named(None), f"PyBullet, the audit's stronger witness: {INSTALL}"
