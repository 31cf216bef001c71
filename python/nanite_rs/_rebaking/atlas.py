"""New texture coordinates, by xatlas: surfaces cut into charts, which are packed into one image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PADDING: Final = 2
"""Texels between charts, which sampling between texels, and one halving, needs."""
# Part of an image that charts cover, about: small ones have much around them.
_FILL = 0.45


@dataclass(frozen=True)
class Charts:
    """A surface in an image."""

    origins: NDArray[np.uint32]
    """(V,): the vertex of the surface that each vertex was."""
    faces: NDArray[np.uint32]
    """(M, 3): those of the surface, in their order, over these vertices."""
    places: NDArray[np.float64]
    """(V, 2): where they are in the image: texels from its lower left corner."""
    texel: float
    """The size of a texel on the surface."""


def module() -> Any:
    """Return xatlas.

    Raises
    ------
    DependencyError
        It is missing.
    """
    try:
        import xatlas
    except ImportError as error:
        raise _advice.missing("rebake", "xatlas") from error
    return xatlas


def areas(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Return the area of each face."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def texel(areas: Sequence[float], relative: Sequence[float], size: int) -> float:
    """Return the texel with which surfaces of these areas fit an image, if theirs are larger by these ratios."""
    return math.sqrt(sum(a / r**2 for a, r in zip(areas, relative, strict=True)) / _FILL) / size


def pack(
    surfaces: Sequence[tuple[NDArray[np.float64], NDArray[np.uint32]]], texels: Sequence[float], size: int
) -> tuple[list[Charts], tuple[int, int]]:
    """Cut surfaces into charts, with texels of these sizes, and pack all of them into one image.

    It has at most ``size`` texels a side. Where they need more room, texels are as much larger. Returns the
    charts of each, and width and height.
    """
    xatlas = module()
    atlas = xatlas.Atlas()
    for (vertices, faces), one in zip(surfaces, texels, strict=True):
        about = (vertices - vertices.mean(axis=0)) / one
        atlas.add_mesh(about.astype(np.float32), np.ascontiguousarray(faces))
    charts = xatlas.ChartOptions()
    charts.fix_winding = True
    how = xatlas.PackOptions()
    how.texels_per_unit = 1.0
    how.padding = PADDING
    how.bilinear = True
    # Turned charts are mirrored, and some renderers take normals for what they are in others.
    how.rotate_charts = False
    atlas.generate(charts, how)
    packed = np.array([atlas.width, atlas.height])
    shrunk = max(float(packed.max()) / size, 1.0)
    width, height = (max(math.ceil(side / shrunk), 1) for side in packed)
    out = []
    for number, one in enumerate(texels):
        origins, faces, uvs = atlas[number]
        # Width and height are rounded up, and texels are square.
        places = uvs.astype(np.float64) * packed / shrunk
        out.append(Charts(origins.astype(np.uint32), faces.astype(np.uint32), places, one * shrunk))
    return out, (width, height)
