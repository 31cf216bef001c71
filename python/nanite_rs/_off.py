"""OFF as meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nanite_rs import _colors, _core
from nanite_rs._asset import Asset, Source
from nanite_rs._faces import add, exploded, plain, triangulated

if TYPE_CHECKING:
    from pathlib import Path


def read(name: str, data: bytes, folder: Path | None, *, drop_bad_textures: bool) -> Asset:
    """Read an OFF file: OFF, and C, N and ST in front of it.

    Colours of faces become those of vertices where these have none.
    """
    del folder, drop_bad_textures  # it refers to nothing
    found = _core.read_off(name, data)
    asset = Asset(name)
    source = Source(found["positions"], np.zeros((0, 3), np.int64))
    source.normals = found["normals"]
    source.colors = None if found["colors"] is None else _colors.narrowed(found["colors"], _colors.ANY_DIGITS)
    source.uvs = [] if found["uvs"] is None else [found["uvs"]]
    corners, counts = found["corners"], found["counts"]
    triangles, polygons, without = triangulated(name, source.vertices, corners, counts)
    colors = found["face_colors"]
    if colors is not None and source.colors is None:
        exploded(source, corners, triangles)
        source.colors = np.repeat(_colors.narrowed(colors, _colors.ANY_DIGITS), counts, axis=0)
    else:
        source.faces = corners[triangles]
        if colors is not None:
            source.face_channels["color"] = colors[polygons]
    for count, what in (
        (without, "faces of fewer than three corners"),
        (found["more"], "vertices with more numbers than the keyword says"),
        (found["by_table"], "colours of faces that are numbers of a table"),
        (found["behind"], "words behind the last face"),
    ):
        if count:
            asset.notes.add(f"{count} {what}")
    add(asset, "mesh", [("mesh", source, plain(source))])
    return asset
