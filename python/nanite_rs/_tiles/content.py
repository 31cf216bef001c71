"""What a tile shows: its part of a cut, rounded to a grid, with skirts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _face_data
from nanite_rs._channels import CutChannels
from nanite_rs._export_parts import Arrays

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from nanite_rs import _core
    from nanite_rs._tiles.place import Place
    from nanite_rs.material import Material


@dataclass(frozen=True)
class Content:
    """A surface in the space of the tiles, and how far off it is."""

    surface: Arrays
    triangles: int
    """Without skirts."""
    bent: float
    """How far straight triangles are from what they would be there."""
    rounding: float
    """How far points that clipping made are from where they ought to be, in units of the mesh."""
    geodetic: NDArray[np.float64] | None
    """Longitudes and latitudes in radians, and heights, of its vertices, where the tiles are on the globe."""


def content(
    piece: _core.Piece,
    materials: tuple[Material, ...],
    place: Place,
    origin: NDArray[np.float64],
    skirt: float,
) -> Content | None:
    """Return what a tile shows; nothing where it is empty.

    Skirts hang along the planes that it was clipped at: strips that leave its border against the normals, as long
    as ``skirt``, and face away from the tile. ``origin`` is what positions of the mesh are float32 about.
    """
    if not len(piece.faces):
        return None
    layout, _ = _face_data.layout(rows.name for rows in piece.channels)
    numbers = piece.face_materials
    vertices, normals = place.applied(piece.vertices, piece.normals)
    surface = Arrays(
        vertices=vertices,
        faces=piece.faces,
        normals=normals,
        fine_colors=piece.colors,
        uvs=piece.uvs,
        face_materials=numbers if layout is None or numbers is None else layout.materials_of(numbers),
        materials=materials,
        channels=_mixed(CutChannels(piece.channels), piece.weights),
    )
    if skirt > 0.0 and len(piece.borders):
        surface = _with_skirts(surface, piece.borders, skirt)
    return Content(
        surface=surface,
        triangles=len(piece.faces),
        bent=place.bent(vertices, piece.faces),
        rounding=_rounding(piece, origin),
        geodetic=place.geodetic(surface.vertices.astype(np.float64, copy=False)),
    )


def _rounding(piece: _core.Piece, origin: NDArray[np.float64]) -> float:
    """Points where edges cross planes are rounded to float32, those where two planes do twice."""
    made = piece.vertices[piece.weights[:, 0] != 1.0]
    most = float(np.abs(made - origin).max(initial=0.0))
    return float(np.nextafter(2.0 * 3.0**0.5 * 2.0**-24 * most * (1.0 + 1e-9), np.inf)) if most else 0.0


def _mixed(rows: Mapping[str, NDArray[Any]], weights: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
    """Return channels at vertices that are made of three each: means of floats, labels of what weighs most."""
    out = {}
    for name in rows:
        values = rows[name]
        three = values.reshape(len(weights), 3, *values.shape[1:])
        if values.dtype.kind == "f":
            # What is one vertex keeps its value, whatever the two others hold.
            wide = weights.reshape(len(weights), 3, *[1] * (values.ndim - 1))
            sums = np.where(wide == 0.0, 0.0, three * wide).sum(axis=1)
            out[name] = sums.astype(values.dtype)
        else:
            out[name] = three[np.arange(len(weights)), weights.argmax(axis=1)]
    return out


def _with_skirts(surface: Arrays, borders: NDArray[np.uint32], length: float) -> Arrays:
    """Return a surface with strips along edges, each of which comes with its face."""
    edges, faces = borders[:, :2].astype(np.int64), borders[:, 2]
    top, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    count = len(surface.vertices)
    first, second = edges.T
    below = count + ends
    strips = np.concatenate(
        [
            np.stack([second, first, below[:, 0]], axis=1),
            np.stack([second, below[:, 0], below[:, 1]], axis=1),
        ]
    ).astype(np.int32)
    rows = np.concatenate([np.arange(count), top])
    numbers = surface.face_materials
    vertices = surface.vertices[rows]
    down = surface.normals[top].astype(np.float64)
    size = np.linalg.norm(down, axis=1, keepdims=True)
    vertices[count:] -= length * down / np.where(size > 0.0, size, 1.0)
    return replace(
        surface,
        vertices=vertices,
        faces=np.concatenate([surface.faces, strips]),
        normals=surface.normals[rows],
        fine_colors=None if surface.fine_colors is None else surface.fine_colors[rows],
        uvs=[uv[rows] for uv in surface.uvs],
        face_materials=None if numbers is None else np.concatenate([numbers, np.tile(numbers[faces], 2)]),
        channels={name: surface.channels[name][rows] for name in surface.channels},
    )
