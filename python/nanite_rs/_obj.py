"""Wavefront OBJ as meshes: objects by name, each with a part for every material."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors, _core, _mtl
from nanite_rs._asset import Asset, Source, fitted
from nanite_rs._faces import add, plain

if TYPE_CHECKING:
    from pathlib import Path

    from nanite_rs.material import Material


def read(name: str, data: bytes, folder: Path | None, *, drop_bad_textures: bool) -> Asset:
    """Read an OBJ file and the MTL files that it names.

    Instances are its objects (``o``), or its groups (``g``) where there are no objects; groups within objects are
    the face channel ``group`` (-1 before the first), and smoothing groups ``smoothing_group``, where a part has
    several.
    """
    found = _core.read_obj(name, data)
    asset = Asset(name)
    materials = _mtl.read(
        name, found["libraries"], folder, drop_bad_textures=drop_bad_textures, notes=asset.notes
    )
    for what, count in found["left"]:
        asset.notes.add(f"{count} {what}")
    names = [_mtl.label(raw) for raw in found["materials"]]
    for label in names if materials else []:
        if label not in materials:
            asset.notes.add("materials that no MTL file has", label)
    objects: dict[int, list[tuple[str, Source, Material | list[Material]]]] = {}
    for row in found["parts"]:
        label = _object(found, row["object"])
        source = _source(row)
        material = None
        if row["material"] is not None:
            key = names[row["material"]]
            label = f"{label}, material {key!r}"
            material = materials.get(key)
        look = plain(source) if material is None else fitted(material, key, len(source.uvs), asset.notes)
        objects.setdefault(row["object"], []).append((label, source, look))
    if found["groups"] and any("group" in s.face_channels for own in objects.values() for _, s, _ in own):
        asset.notes.add("names of groups within objects, whose faces have numbers in their place")
    for number, parts in objects.items():
        add(asset, _object(found, number), parts)
    return asset


def _object(found: dict[str, Any], number: int) -> str:
    names: list[str] = found["objects"]
    return (names[number] if number < len(names) else "") or "mesh"


def _source(row: dict[str, Any]) -> Source:
    source = Source(row["positions"], row["faces"], normals=row["normals"])
    source.uvs = [] if row["uvs"] is None else [row["uvs"]]
    if row["colors"] is not None:
        source.colors = _colors.narrowed(row["colors"], _colors.ANY_DIGITS)
    for name, key in (("group", "groups"), ("smoothing_group", "smoothing")):
        numbers = row[key]
        if numbers is not None and (numbers != numbers[0]).any():
            source.face_channels[name] = numbers.astype(np.int32)
    return source
