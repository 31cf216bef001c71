"""Pictures by which to judge leaves: the tree before and after, and outlines over their image."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _images
from nanite_rs._preview import picture
from nanite_rs.renderer import Renderer
from nanite_rs.texture import both_ways, wrapped
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from nanite_rs._asset import Source
    from nanite_rs._foliage.convert import Converted
    from nanite_rs.material import Material

# Of a checker behind what is transparent, and of outlines.
_GREY = (96, 128)
_LINE = (255, 0, 128)


def of_tree(source: Source, made: dict[str, Any], size: int) -> dict[str, NDArray[np.uint8]]:
    """Return pictures of cards, of geometry, and of its triangles."""
    out = {}
    whole = TriangleMesh(source.vertices, source.faces)
    with Renderer(size, size, backend="cpu") as renderer:
        for name, arrays in (("cards", source.arrays()), ("geometry", made)):
            drawn = {k: v for k, v in arrays.items() if k not in ("channels", "face_channels")}
            frame = picture(renderer, TriangleMesh(**drawn), samples=4, elevation=10.0, framed=whole)
            out[name] = frame.color
        out["triangles"] = frame.view("triangles")
    return out


def of_outlines(look: Material, converted: Converted, size: int) -> NDArray[np.uint8]:
    """Return the part of an image that leaves show, over a checker, with its outlines."""
    import shapely
    from PIL import Image, ImageDraw

    assert look.base_color_texture is not None  # noqa: S101  it has outlines
    rgba = np.asarray(
        Image.fromarray(_bytes(look.base_color_texture.image.pixels)).convert("RGBA"), np.float32
    )
    low, high = _seen(converted)
    scale = size / max(*(high - low), 1.0)
    x, y = (np.arange(int((high[k] - low[k]) * scale)) / scale + low[k] for k in (0, 1))
    ways = both_ways(look.base_color_texture.wrap)
    column, row = (
        wrapped(np.floor(at).astype(np.int64), size, way)
        for at, size, way in zip((x, y), rgba.shape[1::-1], ways, strict=True)
    )
    own = rgba[row[:, None], column[None, :]]
    check = (np.arange(len(y))[:, None] // 8 + np.arange(len(x))[None, :] // 8) % 2
    alpha = own[..., 3:] / 255.0
    base = own[..., :3] * alpha + np.array(_GREY, np.float32)[check][..., None] * (1.0 - alpha)
    drawn = Image.fromarray(base.astype(np.uint8))
    pen = ImageDraw.Draw(drawn)
    for ring in shapely.get_parts(shapely.get_parts(shapely.boundary(converted.outlines.polygons))):
        pen.line([tuple(at) for at in (shapely.get_coordinates(ring) - low) * scale], fill=_LINE)
    return np.array(drawn, np.uint8)


def _seen(converted: Converted) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import shapely

    left, top, right, bottom = shapely.total_bounds(converted.outlines.polygons)
    return np.array([left, top]), np.array([right, bottom])


def _bytes(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    if pixels.dtype.kind == "f":
        pixels = np.clip(pixels, 0.0, 1.0) * 255.0
    elif pixels.dtype == np.uint16:
        pixels = pixels / 257.0
    return np.asarray(np.rint(pixels), np.uint8)


def file_name(name: str) -> str:
    """Return a name that any file system takes."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "leaves"


def write(pictures: dict[str, NDArray[np.uint8]], folder: Path) -> list[str]:
    """Write pictures as PNG, and return their paths."""
    paths = []
    for name, shown in pictures.items():
        paths.append(str(folder / f"{name}.png"))
        _images.write_png(paths[-1], shown, {})
    return paths
