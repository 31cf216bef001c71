"""Images of parts of levels: texel by texel, what the source shows there."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _colors
from nanite_rs._asset import TEXTURES
from nanite_rs._dilation import filled
from nanite_rs._export_textures import stored
from nanite_rs._rebaking import atlas, texels
from nanite_rs._rebaking.source import CHANNELS, COLOR, LIGHT, NORMAL, ORM, Source, dot, frames, mixed, unit
from nanite_rs.texture import Texture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from nanite_rs._rebaking.atlas import Charts
    from nanite_rs.material import Material

# Samples of a texel along a side, at most.
_MOST_SAMPLES: Final = 4


@dataclass
class Part:
    """A part of a level without coordinates."""

    material: int
    """What its material became."""
    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.uint32]
    area: float


@dataclass
class _Points:
    """Points of a part that are looked up together."""

    part: Part
    chart: Charts
    texels: NDArray[np.int64]
    """The texel that each lies in."""
    rows: NDArray[np.int64]
    """The triangle of the part,"""
    shares: NDArray[np.float64]
    """and the barycentric coordinates there."""
    texel: float
    """How far they are apart."""


def bake(
    parts: list[Part], members: list[Material], source: Source, wanted: list[float], size: int, threads: int
) -> tuple[list[dict[str, Any]], Material]:
    """Return an atlas for each part, as the core takes them, and the material that shows their image.

    Texels are as large as ``wanted``, or larger where the image would be of more than ``size`` a side. What they
    show does not depend on the number of threads.
    """
    charts, extent = atlas.pack([(part.vertices, part.faces) for part in parts], wanted, size)
    means, known = _means(parts, charts, extent, source, threads)
    look = _look(filled(means, known, atlas.PADDING), members)
    sides = np.array(extent, np.float64)
    atlases = [
        {
            "origins": one.origins,
            "uvs": np.ascontiguousarray(one.places / sides, np.float32),
            "faces": one.faces,
            "texel": one.texel,
        }
        for one in charts
    ]
    return atlases, look


def _means(
    parts: list[Part], charts: list[Charts], extent: tuple[int, int], source: Source, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return what texels show, rows from below (H, W, CHANNELS), and which show something."""
    width, height = extent
    count = width * height
    sums = np.zeros((CHANNELS, count), np.float32)
    hits = np.zeros(count, np.float32)
    finest = source.texel()

    def points() -> Iterator[_Points]:
        for part, chart in zip(parts, charts, strict=True):
            per_side = chart.texel / finest if finest > 0.0 else 1.0
            samples = min(max(round(per_side / 2.0), 1), _MOST_SAMPLES)
            grid = (width * samples, height * samples)
            for at, rows, shares in texels.covered(chart.places * samples, chart.faces, grid):
                texel = at // grid[0] // samples * width + at % grid[0] // samples
                yield _Points(part, chart, texel, rows, shares, chart.texel / samples)

    def shown(own: _Points) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        return own.texels, _values(own, source, extent)

    for texel, values in _in_order(shown, points(), threads):
        hits += np.bincount(texel, minlength=count)
        for k in range(CHANNELS):
            sums[k] += np.bincount(texel, values[:, k], minlength=count)
    means = (sums / np.maximum(hits, 1.0)).T.astype(np.float32)
    return means.reshape(height, width, CHANNELS), (hits > 0.0).reshape(height, width)


def _in_order(
    work: Callable[[_Points], tuple[NDArray[np.int64], NDArray[np.float32]]],
    items: Iterator[_Points],
    threads: int,
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Yield what comes of items, in their order, with few of them in memory."""
    waiting: deque[Future[tuple[NDArray[np.int64], NDArray[np.float32]]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _values(own: _Points, source: Source, extent: tuple[int, int]) -> NDArray[np.float32]:
    """Return what the source shows at points of a part, with normals in the frames of its triangles."""
    part, chart, rows, shares = own.part, own.chart, own.rows, own.shares
    vertices = chart.origins[chart.faces[rows]]
    corners = part.vertices[vertices]
    values = source.at(mixed(corners, shares), own.texel)
    normals = unit(mixed(part.normals[vertices], shares))
    places = chart.places[chart.faces[rows]] * [1.0, -1.0] + [0.0, extent[1]]
    along, side = frames(corners, places, normals)
    bent = values[:, NORMAL].astype(np.float64)
    values[:, NORMAL] = np.stack([dot(bent, axis) for axis in (along, side, normals)], axis=1)
    return values


def _look(means: NDArray[np.float32], members: list[Material]) -> Material:
    """Return the material that shows means: with an image where members differ, or have one."""
    first = members[0]
    pixels = means[::-1]

    def varies(*names: str) -> bool:
        of = [tuple(getattr(look, name) for name in names) for look in members]
        textured = [f"{name}_texture" for name in names] + ["metallic_roughness_texture"] * (
            "metallic" in names
        )
        return any(one != of[0] for one in of) or any(
            getattr(look, name, None) for look in members for name in textured
        )

    def file(slot: str) -> bytes | None:
        found = [texture.image.encoded() for look in members if (texture := getattr(look, slot)) is not None]
        return found[0] if found else None

    # Images of the source lie otherwise.
    out: dict[str, Any] = dict.fromkeys(TEXTURES)
    if varies("base_color"):
        holes = first.alpha_mode != "opaque"
        color = np.clip(pixels[..., COLOR][..., : 4 if holes else 3], 0.0, 1.0)
        color[..., :3] = _colors.to_srgb(color[..., :3])
        out["base_color_texture"] = _texture(color, file("base_color_texture"))
        out["base_color"] = (1.0, 1.0, 1.0)
    shaded = not first.unlit
    rough, shadowed = varies("metallic", "roughness"), any(look.occlusion_texture for look in members)
    if shaded and (rough or shadowed):
        orm = _texture(pixels[..., ORM], file("metallic_roughness_texture") or file("occlusion_texture"))
        if rough:
            out |= {"metallic_roughness_texture": orm, "metallic": 1.0, "roughness": 1.0}
        if shadowed:
            out |= {"occlusion_texture": orm, "occlusion_strength": 1.0}
    if shaded and varies("emissive"):
        most = np.maximum(pixels[..., LIGHT].max(axis=(0, 1)), 0.0)
        light = pixels[..., LIGHT] / np.maximum(most, 1e-30)
        out["emissive_texture"] = _texture(_colors.to_srgb(light), file("emissive_texture"))
        out["emissive"] = tuple(float(x) for x in most)
    if shaded:
        bent = pixels[..., NORMAL].astype(np.float64)
        size = np.linalg.norm(bent, axis=2, keepdims=True)
        bent = np.divide(bent, size, out=np.zeros_like(bent), where=size > 0.0)
        bent[size[..., 0] == 0.0] = (0.0, 0.0, 1.0)
        out |= {"normal_texture": _texture(0.5 * bent + 0.5, file("normal_texture")), "normal_scale": 1.0}
    return replace(first, **out)


def _texture(pixels: NDArray[Any], file: bytes | None) -> Texture:
    """Return a texture of numbers from 0 to 1: JPEG where the source's was."""
    whole = np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).astype(np.uint8)
    return Texture(stored(whole, file), wrap="clamp")
