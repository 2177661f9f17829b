"""Rigid bodies of a finished assembly, as closed triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class AssemblyBody:
    """A rigid body in its place in the finished assembly.

    Attributes:
        name: unique among the bodies.
        mesh: its surface, closed, in the frame of the finished assembly [m].
        density_kg_m3: of its material.
    """

    name: str
    mesh: trimesh.Trimesh
    density_kg_m3: float = 1000.0
