"""Bodies of an assembly sorted by shape: those that are alike are parts of one type."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count

import numpy as np

from planning.bounds import LONGEST_NAME
from planning.cad.exact_forms import BoxForm, ExactForm, exact_form
from planning.cad.glb_bodies import CadBody
from planning.cad.same_shape import ALIKE, pose_of
from planning.transforms import Array, Transform, inverse, translation

_GENERIC = re.compile(
    r"=>\[.*|(?:solid|compound|shell|nauo)?[\d_:.\[\]-]*|open cascade step translator.*",
    re.IGNORECASE,
)
"""Names that programs make up."""

_LETTERS = re.compile(r"[^A-Za-z0-9_-]+")
_FALLBACK = "part"
_RESERVED = ("true", "false", "null", "yes", "no", "on", "off", "world")


@dataclass(frozen=True, eq=False)
class Placed:
    """A body with its unique valid name, and the pose of the frame of its type in the assembly."""

    name: str
    body: CadBody
    pose: Transform

    @cached_property
    def vertices(self) -> Array:
        """Corners of its triangles in the assembly, shape (v, 3) [m]."""
        at = self.body.pose
        return np.asarray(self.body.vertices @ at[:3, :3].T + at[:3, 3])


@dataclass(frozen=True, eq=False)
class PartType:
    """Bodies of one shape and colour.

    Attributes:
        name: unique among the types.
        form: what the shape is exactly; None for a mesh.
        frame: pose of the frame of the type in the frame of the first body.
        placed: the bodies.
    """

    name: str
    form: ExactForm | None
    frame: Transform
    placed: list[Placed]

    @cached_property
    def vertices(self) -> Array:
        """Corners of its mesh in the frame of the type, shape (v, 3) [m]."""
        to_type = inverse(self.frame)
        own = self.placed[0].body.vertices
        return np.asarray(own @ to_type[:3, :3].T + to_type[:3, 3])

    @property
    def triangles(self) -> Array:
        """Corners of the triangles of its mesh in the frame of the type, shape (f, 3, 3) [m]."""
        return np.asarray(self.vertices[self.placed[0].body.faces])

    @property
    def is_milled(self) -> bool:
        """Whether it is a mesh whose faces are all along one axis of its frame or across it: such are cut at once."""
        if self.form is not None:
            return False
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        across = np.cross(b - a, c - a)
        size = np.linalg.norm(across, axis=1)
        along = np.abs(across[size > 1e-12]) / size[size > 1e-12][:, None]
        either = (along < 1e-3) | (along > 1.0 - 1e-3)
        return bool(either.all(axis=0).any())

    @property
    def volume(self) -> float:
        """Volume of one of them [m^3]."""
        return self.placed[0].body.volume

    def pose_at(
        self, body: CadBody, exact: tuple[ExactForm, Transform] | None
    ) -> Transform | None:
        """Return the pose of the type's frame in the assembly at which it is a body; None if it is of another type."""
        if self.placed[0].body.colour != body.colour:
            return None
        if self.form is None and exact is None:
            same = pose_of(self.placed[0].body, body)
            return None if same is None else body.pose @ same @ self.frame
        if self.form is None or exact is None:
            return None
        pose = self.form.match(exact[0], ALIKE)
        return pose if pose is None else self.form.upright(body.pose @ exact[1] @ pose)


def sort_by_shape(bodies: Sequence[CadBody]) -> list[PartType]:
    """Return the types of the bodies of an assembly, in the order of the file."""
    names = unique_names(readable_name(body.names) for body in bodies)
    found: list[PartType] = []
    for name, body in zip(names, bodies, strict=True):
        exact = exact_form(body)
        poses = ((own, own.pose_at(body, exact)) for own in found)
        known, pose = next((p for p in poses if p[1] is not None), (None, None))
        if known is None or pose is None:
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            form: ExactForm | None = None
            pose = body.pose @ translation(*(0.5 * (low + high)))
            if exact is not None:
                form, pose = exact[0], body.pose @ exact[1]
                if isinstance(form, BoxForm):
                    form, pose = form.aligned(pose)
                else:
                    pose = form.upright(pose)
            frame = inverse(body.pose) @ pose
            known = PartType(readable_name(body.names), form, frame, [])
            found.append(known)
        known.placed.append(Placed(name, body, pose))
    return with_unique_names(found)


def with_unique_names(
    types: Iterable[PartType], taken: Iterable[str] = ()
) -> list[PartType]:
    """Return types with names that are different, and none of those that are taken."""
    known = list(types)
    names = unique_names([own.name for own in known], taken)
    return [replace(own, name=name) for own, name in zip(known, names, strict=True)]


def readable_name(names: Iterable[str]) -> str:
    """Return a valid name of a body: that of its product, or of its instance where a program made that one up."""
    for name in names:
        plain = unicodedata.normalize("NFKD", _decoded(name))
        plain = plain.encode("ascii", "ignore").decode()
        if _GENERIC.fullmatch(plain.strip()):
            continue
        plain = _LETTERS.sub("_", plain).strip("_-")
        if not plain:
            continue
        if not plain[0].isalpha() or plain.lower() in _RESERVED:
            plain = f"{_FALLBACK}_{plain}"
        return plain[: LONGEST_NAME - 8].strip("_-")
    return _FALLBACK


def _decoded(name: str) -> str:
    """Return a name whose UTF-8 was read as Latin-1 as it was written."""
    try:
        return name.encode("latin-1").decode("utf-8")
    except UnicodeError:
        return name


def unique_names(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return the names with ``_2``, ``_3`` and so on behind those that were there before."""
    out: list[str] = []
    used = {name.lower() for name in taken}
    for name in names:
        others = (f"{name}_{number}" for number in count(2))
        own = next(n for n in chain([name], others) if n.lower() not in used)
        used.add(own.lower())
        out.append(own)
    return out
