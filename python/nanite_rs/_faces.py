"""Common parts of mesh readers: triangulated polygons, colours, and notes of what a mesh cannot hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors, _core
from nanite_rs._asset import Part, as_labels, has_area
from nanite_rs.exceptions import MeshError
from nanite_rs.material import Material

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from nanite_rs._asset import Asset, Notes, Source


def corner_numbers(
    name: str, values: NDArray[Any], lengths: NDArray[Any], points: int, first: int = 0
) -> NDArray[np.uint32]:
    """Return vertices of polygons as they are numbered here, or say in which polygon there is no such vertex.

    ``first`` is the number of the first polygon.
    """
    whole = values.dtype.kind in "iu" or bool((values == np.rint(values)).all())
    if len(values) and not (whole and values.min() >= 0 and values.max() < points):
        bad = ~((values >= 0) & (values < points) & (values == np.rint(values)))
        place = int(np.argmax(bad))
        face = int(np.searchsorted(np.cumsum(lengths), place, side="right"))
        raise MeshError(
            f"{name}: faces[{first + face}] refers to vertex {values[place]}, but there are {points} vertices"
        )
    return values.view(np.uint32) if values.dtype == np.int32 else np.ascontiguousarray(values, np.uint32)


def triangulated(
    name: str, points: NDArray[np.float64], corners: NDArray[np.uint32], counts: NDArray[np.uint32]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32] | slice, int]:
    """Return triangles as numbers of corners, which polygons they come from, and how many of these have none."""
    if (counts == 3).all():
        return np.arange(len(corners), dtype=np.uint32).reshape(-1, 3), slice(None), 0
    return _core.triangulate(name, points, corners, counts)


def colors_of(columns: list[NDArray[Any]]) -> NDArray[Any]:
    """Three or four columns of any type as (N, 4), in the narrowest dtype that holds them."""
    colors = wide_colors(columns, [largest(column) for column in columns])
    return _colors.narrowed(colors, _colors.ANY_DIGITS) if colors.dtype == np.float32 else colors


def wide_colors(columns: list[NDArray[Any]], most: list[float]) -> NDArray[Any]:
    """Three or four columns of any type as (N, 4) bytes or float32, of which the whole has such largest values."""
    parts = [_unit(column, value) for column, value in zip(columns, most, strict=True)]
    if len(parts) == 3:
        parts.append(np.full(len(parts[0]), 255, np.uint8))
    if all(part.dtype == np.uint8 for part in parts):
        return np.stack(parts, axis=1)
    parts = [part / np.float32(255) if part.dtype == np.uint8 else part for part in parts]
    return np.stack(parts, axis=1).astype(np.float32)


def largest(values: NDArray[Any]) -> float:
    """Return the largest value of a column of colours, 0 at least."""
    return float((np.nan_to_num(values, nan=1.0) if values.dtype.kind == "f" else values).max(initial=0))


def _unit(values: NDArray[Any], most: float) -> NDArray[Any]:
    """Return bytes unchanged, and other colours from 0 to 1, scaled by the range in use."""
    if values.dtype.kind == "f":
        values = np.nan_to_num(values, nan=1.0)
        most = 255.0 if most > 1.0 else 1.0
        return np.asarray(np.clip(values / most, 0.0, 1.0), np.float32)
    if values.dtype.itemsize == 1:
        return values.view(np.uint8)  # some write char and mean bytes
    if values.dtype.itemsize > 2 and most <= 255:
        return np.asarray(np.clip(values, 0, 255), np.uint8)
    return np.asarray(np.clip(values / 65535.0, 0.0, 1.0), np.float32)


def add_channels(
    into: dict[str, NDArray[Any]], found: Mapping[str, NDArray[Any]], notes: Notes, of: str
) -> None:
    """Take properties over, but for those that no channel can hold."""
    for name, values in found.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            notes.add(f"properties of {of} that are not finite", name)
        elif not fits_word(values):
            notes.add(f"properties of {of} that need 64 bits", name)
        else:
            into[name] = as_labels(name, values)


def fits_word(values: NDArray[Any]) -> bool:
    """Whether numbers are floats, or have room in 32 bits."""
    if values.dtype.kind not in "iu" or values.dtype.itemsize < 8:
        return True
    limits = np.iinfo(np.int32 if values.dtype.kind == "i" else np.uint32)
    return bool(values.min(initial=0) >= limits.min and values.max(initial=0) <= limits.max)


def exploded(source: Source, corners: NDArray[Any], triangles: NDArray[Any]) -> None:
    """Give every corner a vertex of its own. Equal ones are welded again by the build."""
    source.vertices = source.vertices[corners]
    if source.normals is not None:
        source.normals = source.normals[corners]
    if source.colors is not None:
        source.colors = source.colors[corners]
    source.uvs = [uv[corners] for uv in source.uvs]
    source.channels = {name: values[corners] for name, values in source.channels.items()}
    source.faces = triangles


def add(asset: Asset, name: str, parts: list[tuple[str, Source, Material | list[Material]]]) -> None:
    """Place an object of parts, as far as there is something to see of it."""
    kept = []
    for label, source, material in parts:
        _mend(source, asset.notes, label)
        if has_area(source.vertices, source.faces):
            kept.append(Part(label, source, material))
        elif len(source.faces):
            asset.notes.add("surfaces without area", label)
    if kept:
        asset.placed.append((name, len(asset.meshes), np.eye(4)))
        asset.meshes.append(kept)


def _mend(source: Source, notes: Notes, name: str) -> None:
    """Drop unused vertices without finite positions; replace normals and UVs that are not finite, with a note."""
    if not np.isfinite(source.vertices).all():
        used, faces = np.unique(source.faces, return_inverse=True)
        exploded(source, used, faces.reshape(-1, 3))
    if source.normals is not None and not np.isfinite(source.normals).all():
        notes.add("normals that are not finite, computed instead", name)
        source.normals = zero_where_not_finite(source.normals)
    for number, uv in enumerate(source.uvs):
        if not np.isfinite(uv).all():
            notes.add("texture coordinates that are not finite, zero instead", name)
            source.uvs[number] = zero_where_not_finite(uv)


def zero_where_not_finite(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return rows with zeros where one of the numbers is not finite."""
    fine = np.isfinite(rows).all(axis=1, keepdims=True)
    return np.where(fine, rows, np.float32(0))


def plain(source: Source) -> Material:
    """Return the look of what has no material: white where it has colours."""
    return Material() if source.colors is None else Material(base_color=(1.0, 1.0, 1.0))
