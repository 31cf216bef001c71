"""Folders of imposters: an image for each layer, and what they mean as JSON."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _images
from nanite_rs._imposters import octahedron, texels
from nanite_rs.exceptions import FileError, FormatError

if TYPE_CHECKING:
    from collections.abc import Callable

    from nanite_rs._imposters.bake import Layers
    from nanite_rs.imposters import Imposter

METADATA: Final = "imposter.json"
FORMAT: Final = "nanite_rs imposter"
VERSION: Final = 1
LEAST_VIEWS: Final = 3
LEAST_SIZE: Final = 4
LARGEST: Final = 8_192
"""Most texels of a side of an image: what every device takes as a texture."""
_CONVENTIONS: Final = {
    "images": "views x views pictures; rows from the top along v, columns along u; directions below",
    "directions": "place (u, v) = 2 k / (views - 1) - 1 in the square; with axes x, y, z of the map, z up: "
    "full_sphere: octahedral map, (x, y) = (u, v), z = 1 - |x| - |y|, folded where z < 0; else its upper half, "
    "x = (u + v) / 2, y = (u - v) / 2",
    "axes": "up y: x, y, z of the map are Z, X, Y of the mesh; up z: X, Y, Z",
    "picture": "orthographic, from outside towards the centre, 2 radii wide; up is that of the map, or its y axis "
    "where |z| >= 0.999",
    "base_color": "sRGB, and coverage as alpha, not multiplied",
    "normal": "of the mesh's space, -1..1 as 0..1",
    "depth": "distance behind the plane that touches the sphere in front, in radii, 0..2 as 0..1",
    "orm": "occlusion, roughness, metallic, linear",
}


def atlas(layer: Any) -> Any:
    """Return all views of a layer as one picture."""
    views, _, size = layer.shape[:3]
    return np.ascontiguousarray(layer.swapaxes(1, 2)).reshape(views * size, views * size, *layer.shape[4:])


def save(imposter: Imposter, folder: str) -> None:
    """Write a folder; each file takes its place when it is whole, what they mean last."""
    try:
        os.makedirs(folder, exist_ok=True)
    except (OSError, ValueError) as error:
        raise FileError(getattr(error, "errno", None) or 22, str(error), folder) from None
    files = {name: f"{name}.png" for name in texels.LAYERS}
    for name, file in files.items():
        _images.write_png(os.path.join(folder, file), atlas(imposter._layers[name]), {})
    said = {
        "format": FORMAT,
        "version": VERSION,
        "views": imposter.views,
        "size": imposter.size,
        "full_sphere": imposter.full_sphere,
        "up": imposter.up,
        "center": imposter.center.tolist(),
        "radius": imposter.radius,
        "files": files,
        "conventions": _CONVENTIONS,
    }
    with _images.beside(os.path.join(folder, METADATA)) as path:
        Path(path).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")


def opened(folder: str) -> tuple[Layers, dict[str, Any]]:
    """Return the layers, and views, size, full_sphere, up, center and radius."""
    path = os.path.join(folder, METADATA)
    data = _images.read_bytes(path)
    try:
        said = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: no JSON: {error}") from None
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise FormatError(f'{path}: its "format" is not "{FORMAT}"')
    if said.get("version") != VERSION:
        raise FormatError(f"{path}: version {said.get('version')!r}; this package reads {VERSION}")
    known = {name: _checked(path, said, name) for name in _CHECKS}
    views, size = known["views"], known["size"]
    if views * size > LARGEST:
        raise FormatError(f"{path}: {views} views of {size} texels exceed images of {LARGEST}")
    layers: Layers = {}
    for name, (count, dtype) in texels.LAYERS.items():
        file = said["files"].get(name) if isinstance(said.get("files"), dict) else None
        if not isinstance(file, str) or os.path.basename(file) != file or file in ("", os.curdir, os.pardir):
            raise FormatError(f'{path}: "files" has no name of a file of this folder for "{name}"')
        place = os.path.join(folder, file)
        # Grey of 16 bits included, which Pillow keeps.
        pixels = _images.read_plain(_images.read_bytes(place), place)
        want = (views * size, views * size, count)[: 2 + (count > 1)]
        if pixels.shape != want or pixels.dtype != dtype:
            raise FormatError(f"{place}: expected {want} of {dtype}, found {pixels.shape} of {pixels.dtype}")
        parts = pixels.reshape(views, size, views, size, *pixels.shape[2:])
        layers[name] = np.ascontiguousarray(parts.swapaxes(1, 2))
    return layers, known


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


_CHECKS: Final[dict[str, Callable[[Any], bool]]] = {
    "views": lambda value: _is_whole(value) and LEAST_VIEWS <= value <= LARGEST,
    "size": lambda value: _is_whole(value) and LEAST_SIZE <= value <= LARGEST and value.bit_count() == 1,
    "full_sphere": lambda value: isinstance(value, bool),
    "up": lambda value: isinstance(value, str) and value in octahedron.AXES,
    "center": lambda value: isinstance(value, list) and len(value) == 3 and all(map(_is_number, value)),
    "radius": lambda value: _is_number(value) and value > 0.0,
}


def _checked(path: str, said: dict[str, Any], name: str) -> Any:
    value = said.get(name)
    if not _CHECKS[name](value):
        raise FormatError(f'{path}: "{name}" is {value!r:.80}')
    return value
