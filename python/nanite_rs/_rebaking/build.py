"""Building with images of their own for levels that seams would stop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core
from nanite_rs._export_parts import Arrays
from nanite_rs._progress import reporter
from nanite_rs._rebaking import atlas, classes
from nanite_rs._rebaking.bake import Part, bake
from nanite_rs._rebaking.source import Source
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from nanite_rs._progress import Progress
    from nanite_rs.material import Material

# Parts share an image until they have so many times fewer triangles: coarse levels need little of it.
_SHARED: Final = 8


def is_asked_for(arrays: dict[str, Any], given: Mapping[str, Any], looks: tuple[Material, ...]) -> bool:
    """Whether a mesh has what can be baked anew: texture coordinates and images.

    Raises
    ------
    ArgumentError
        Faces have channels: lines between them stay as they are.
    """
    if not arrays["uvs"] or not classes.has_images(looks):
        return False
    if given.get("face_channels"):
        raise ArgumentError('face_channels: rebake="auto" merges faces of all kinds; leave one of them out')
    return True


def build(
    arrays: dict[str, Any],
    options: dict[str, Any],
    looks: tuple[Material, ...],
    size: int,
    progress: Progress,
) -> tuple[_core.Mesh, tuple[Material, ...]]:
    """Build; return the mesh and its looks: those given, and those that show what was baked.

    Images are at most ``size`` a side.

    Raises
    ------
    DependencyError
        xatlas is missing.
    ArgumentError
        Face materials have numbers that leave none for others.
    """
    atlas.module()
    kinds = classes.of_faces(looks, arrays["face_materials"])
    numbers = (kinds.first, kinds.first + len(kinds.members))
    with reporter(progress, "building") as report:
        grown = _core.Unbaked(
            arrays, options=options, classes=kinds.pairs(), numbers=numbers, progress=report
        )
    parts = [_part(found) for found in grown.surfaces()]
    if not parts:
        return grown.finish([]), looks
    source = Source(_surface(arrays, kinds.looks), kinds)
    shown, baked = list(kinds.looks), {}
    threads = options["threads"] or _core.num_threads()
    with reporter(progress, "baking") as report:
        for rows in _by_material(parts):
            members = [kinds.look(number) for number in kinds.members[parts[rows[0]].material - kinds.first]]
            texel = _texels([parts[k] for k in rows], source.texel(), size)
            for band in _bands([len(parts[k].faces) for k in rows]):
                own = [parts[rows[k]] for k in band]
                atlases, look = bake(own, members, source, [texel[k] for k in band], size, threads)
                for k, one in zip(band, atlases, strict=True):
                    baked[rows[k]] = one | {"material": len(shown)}
                shown.append(look)
                if report is not None:
                    report(len(baked), len(parts))
    return grown.finish([baked[k] for k in range(len(parts))]), tuple(shown)


def _part(found: dict[str, Any]) -> Part:
    areas = atlas.areas(found["vertices"], found["faces"])
    return Part(
        material=found["material"],
        vertices=found["vertices"],
        normals=found["normals"].astype(np.float64),
        faces=found["faces"],
        area=float(areas.sum()),
    )


def _by_material(parts: list[Part]) -> list[list[int]]:
    materials = sorted({part.material for part in parts})
    return [[k for k, part in enumerate(parts) if part.material == material] for material in materials]


def _bands(triangles: list[int]) -> list[range]:
    """Return which parts share an image, finest first."""
    out, first = [], 0
    for k, count in enumerate(triangles):
        if k and count * _SHARED <= triangles[first]:
            out.append(range(first, k))
            first = k
    return [*out, range(first, len(triangles))]


def _texels(parts: list[Part], finest: float, size: int) -> list[float]:
    """Return texels of parts, finest first, so that an image of ``size`` a side holds the first band.

    All triangles have about as many; none are below ``finest``.
    """
    triangles = [len(part.faces) for part in parts]
    relative = [math.sqrt(triangles[0] / count) for count in triangles]
    band = _bands(triangles)[0]
    first = atlas.texel([parts[k].area for k in band], [relative[k] for k in band], size)
    return [max(finest, first) * r for r in relative]


def _surface(arrays: dict[str, Any], looks: tuple[Material, ...]) -> Arrays:
    """The source as a surface."""
    vertices, faces = np.asarray(arrays["vertices"]), np.asarray(arrays["faces"])
    normals = arrays["normals"]
    return Arrays(
        vertices=vertices,
        faces=faces.astype(np.int32),
        normals=_smooth(vertices, faces) if normals is None else normals,
        uvs=arrays["uvs"],
        face_materials=arrays["face_materials"],
        materials=looks,
    )


def _smooth(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.float32]:
    """Return normals, weighted with areas; vertices at one position have the same."""
    _, places = np.unique(vertices, axis=0, return_inverse=True)
    places = places.reshape(-1)
    corners = vertices[faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack(
        [np.bincount(places[faces].reshape(-1), np.repeat(across[:, k], 3)) for k in range(3)], axis=1
    )
    size = np.linalg.norm(sums, axis=1, keepdims=True)
    normals = np.divide(sums, size, out=np.zeros_like(sums), where=size > 0.0)
    return np.asarray(normals[places], np.float32)
