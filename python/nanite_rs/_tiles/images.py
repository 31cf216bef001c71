"""Textures of a tile: the parts of images that its faces show, as fine as its error lets anybody see."""

from __future__ import annotations

import hashlib
import math
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs._export_parts import COLORS, Arrays, pieces, textures
from nanite_rs._export_textures import halved, halvings, stored
from nanite_rs._tiles.target import IMAGES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._export_parts import Piece
    from nanite_rs._tiles.target import Target
    from nanite_rs.material import Material
    from nanite_rs.texture import Image, Texture, Wrap

MARGIN: Final = 2
"""Texels around what is shown."""
ALONE: Final = 8192
"""Bytes below which an image is in the file of each tile."""
WORTH: Final = 0.7
"""An image is cut where this part of its texels, or less, is left."""
SCATTERED: Final = 0.5
"""Charts are put together anew where this part of the box around them, or less, is left."""
ALIGNED: Final = 4
"""Charts lie at multiples of so many texels, so that two smaller versions of an image are the same, too."""
MOST_CHARTS: Final = 4096
"""Charts of a piece that are put together anew, at most: each has its margin."""


class Smaller:
    """Images of a mesh, and these halved so and so often: each is made and written once."""

    def __init__(self, materials: tuple[Material, ...], target: Target) -> None:
        self._known: dict[tuple[int, int, bool], tuple[Image, Image]] = {}
        self._lock = threading.Lock()
        # By number; images that are kept have no other's.
        self._whole = {id(texture.image) for look in materials for _, texture in textures(look)}
        self._target, self._written = target, dict[str, int]()

    @property
    def size(self) -> int:
        """Bytes of the images that were written."""
        return sum(self._written.values())

    def shared(self, image: Image, data: bytes, ending: str) -> str | None:
        """Write an image that other tiles show as a whole, too; return its name beside them."""
        if id(image) not in self._whole or len(data) < ALONE:
            return None
        name = f"{IMAGES}/{hashlib.sha256(data).hexdigest()[:20]}.{ending}"
        with self._lock:
            if name not in self._written:
                self._target.write(name, data)
                self._written[name] = len(data)
        return name

    def of(self, image: Image, times: int, color: bool) -> Image:
        """Return a halved image."""
        if times == 0:
            return image
        key = id(image), times, color
        with self._lock:
            if key not in self._known:
                # The image is kept, so that no other has its number.
                self._known[key] = image, halved(image, times, color)
                self._whole.add(id(self._known[key][1]))
            return self._known[key][1]


def cropped(surface: Arrays, per_unit: float | None, smaller: Smaller) -> Arrays:
    """Return a surface whose images have what its faces show.

    ``per_unit`` is how many texels a unit of length needs; None keeps all.
    """
    if not any(True for look in surface.materials for _ in textures(look)):
        return surface
    looks = list(surface.materials)
    moved: dict[int, tuple[Piece, list[NDArray[np.float32]]]] = {}
    for piece in pieces(surface):
        slots = dict(textures(piece.material))
        if not slots:
            continue
        images = {
            slot: smaller.of(
                texture.image,
                0 if per_unit is None else halvings(surface, piece, texture, per_unit),
                slot in COLORS,
            )
            for slot, texture in slots.items()
        }
        chart = _Charts.of(surface, piece, slots, images)
        if chart is not None:
            own: dict[str, Any] = {
                slot: chart.texture(texture, images[slot]) for slot, texture in slots.items()
            }
            moved[piece.number] = piece, chart.uvs(surface, piece)
        else:
            own = {slot: _cut(surface, piece, texture, images[slot]) for slot, texture in slots.items()}
        looks[piece.number] = replace(piece.material, **own)
    if moved:
        surface = _separated(surface, moved)
    return replace(surface, materials=tuple(looks))


# ------------------------------------------------------------------------------------------ one rectangle


def _places(surface: Arrays, piece: Piece, texture: Texture) -> NDArray[np.float64] | None:
    """Return where the vertices of a piece are on an image, in its sides, from its upper left corner."""
    if texture.uv_set >= len(surface.uvs):
        return None
    uv = surface.uvs[texture.uv_set][piece.used].astype(np.float64)
    rows = np.array(texture._rows())
    places: NDArray[np.float64] = uv @ rows[:, :2].T + rows[:, 2]
    return places if np.isfinite(places).all() else None


def _window(low: float, high: float, count: int, wrap: str) -> tuple[int, int] | None:
    """Return the first texel and the number of those that a range shows; None where all are needed."""
    first, last = math.floor(low * count) - MARGIN, math.ceil(high * count) + MARGIN
    if wrap == "clamp":
        first, last = max(first, 0), min(last, count)
        # What lies beyond the edge shows the edge.
        first, last = min(first, count - 1), max(last, 1)
        last = max(last, first + 1)
    return (first, last - first) if last - first < count else None


def _texels(first: int, size: int, count: int, wrap: str) -> NDArray[np.int64]:
    """Return the rows, or columns, of a window."""
    at = np.arange(first, first + size)
    if wrap == "repeat":
        return at % count
    if wrap == "mirror":
        at %= 2 * count
        return np.minimum(at, 2 * count - 1 - at)
    return np.clip(at, 0, count - 1)


def _cut(surface: Arrays, piece: Piece, texture: Texture, image: Image) -> Texture:
    """Return a texture with what a piece shows of an image; its transform says where that is."""
    whole = replace(texture, image=image)
    places = _places(surface, piece, texture)
    if places is None or texture.rotation:
        return whole
    width, height = image.size
    columns = _window(*_range(places[:, 0]), width, texture.wrap[0])
    rows = _window(*_range(places[:, 1]), height, texture.wrap[1])
    x, across = columns or (0, width)
    y, down = rows or (0, height)
    if across * down > WORTH * width * height:
        return whole
    pixels = image.pixels[
        np.ix_(_texels(y, down, height, texture.wrap[1]), _texels(x, across, width, texture.wrap[0]))
    ]
    scale = width / across, height / down
    ways: tuple[Wrap, Wrap] = texture.wrap  # type: ignore[assignment]
    wrap = (ways[0] if columns is None else "clamp", ways[1] if rows is None else "clamp")
    return replace(
        texture,
        image=stored(np.ascontiguousarray(pixels), image.encoded()),
        wrap=wrap,
        offset=(
            (texture.offset[0] - x / width) * scale[0],
            (texture.offset[1] - y / height) * scale[1],
        ),
        scale=(texture.scale[0] * scale[0], texture.scale[1] * scale[1]),
    )


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values.min()), float(values.max())


# -------------------------------------------------------------------------------------------- many charts


class _Charts:
    """The charts of a piece, put together anew: rectangles of texels that are moved as they are."""

    def __init__(
        self,
        uv_set: int,
        size: tuple[int, int],
        chart: NDArray[np.int64],
        source: NDArray[np.int64],
        target: NDArray[np.int64],
        extent: tuple[int, int],
    ) -> None:
        self._uv_set, self._size, self._chart = uv_set, size, chart
        # (N, 4): x, y, width, height, and (N, 2): where they go.
        self._source, self._target, self._extent = source, target, extent

    @classmethod
    def of(
        cls, surface: Arrays, piece: Piece, slots: dict[str, Texture], images: dict[str, Image]
    ) -> _Charts | None:
        """Find charts; None where a rectangle does as well, or textures lie on the surface in several ways."""
        first = next(iter(slots.values()))
        plain = all(
            texture.uv_set == first.uv_set
            and texture.offset == (0.0, 0.0)
            and texture.scale == (1.0, 1.0)
            and not texture.rotation
            for texture in slots.values()
        )
        places = _places(surface, piece, first) if plain else None
        if places is None or places.min() < 0.0 or places.max() > 1.0:
            return None
        width, height = (max(image.size[k] for image in images.values()) for k in (0, 1))
        # All images have the same texels, or some of them fewer, evenly.
        if any(width % image.size[0] or height % image.size[1] for image in images.values()):
            return None
        coarse = max(max(width // image.size[0], height // image.size[1]) for image in images.values())
        number, chart = _components(piece.faces, len(piece.used))
        if not 2 <= number <= MOST_CHARTS:
            return None
        unit = coarse * ALIGNED
        size = np.array([width, height])
        if (size % unit).any():
            return None
        low, high = np.full((number, 2), np.inf), np.full((number, 2), -np.inf)
        np.minimum.at(low, chart, places)
        np.maximum.at(high, chart, places)
        # Whole texels of the coarsest image, and of smaller versions of it, so that all are moved alike.
        margin = MARGIN * coarse
        start = np.clip(np.floor((low * size - margin) / unit).astype(np.int64), 0, None)
        stop = np.minimum(np.ceil((high * size + margin) / unit).astype(np.int64), size // unit)
        extent = np.maximum(stop - start, 1)
        box = np.prod(stop.max(axis=0) - start.min(axis=0))
        if int(np.prod(extent, axis=1).sum()) > SCATTERED * float(box):
            return None
        target, used = _shelves(extent)
        if np.prod(used) > SCATTERED * float(box):
            return None
        source = np.concatenate([start * unit, extent * unit], axis=1)
        return cls(
            first.uv_set, (width, height), chart, source, target * unit, (used[0] * unit, used[1] * unit)
        )

    def texture(self, texture: Texture, image: Image) -> Texture:
        """Return a texture with the charts of an image."""
        shrink = self._size[0] // image.size[0], self._size[1] // image.size[1]
        pixels = image.pixels
        out = np.zeros(
            (self._extent[1] // shrink[1], self._extent[0] // shrink[0], pixels.shape[2]), pixels.dtype
        )
        for (x, y, w, h), (to_x, to_y) in zip(self._source.tolist(), self._target.tolist(), strict=True):
            across, down = (w // shrink[0], h // shrink[1])
            part = pixels[y // shrink[1] :, x // shrink[0] :][:down, :across]
            out[to_y // shrink[1] :, to_x // shrink[0] :][: part.shape[0], : part.shape[1]] = part
        return replace(texture, image=stored(out, image.encoded()), wrap="clamp")

    def uvs(self, surface: Arrays, piece: Piece) -> list[NDArray[np.float32]]:
        """Return the UV sets of the vertices of a piece."""
        out = [uv[piece.used] for uv in surface.uvs]
        places = out[self._uv_set].astype(np.float64) * (1.0, -1.0) + (0.0, 1.0)
        shift = (self._target - self._source[:, :2])[self._chart]
        there = (places * self._size + shift) / self._extent
        out[self._uv_set] = (there * (1.0, -1.0) + (0.0, 1.0)).astype(np.float32)
        return out


def _components(faces: NDArray[np.int64], count: int) -> tuple[int, NDArray[np.int64]]:
    """Return the number of parts that share no vertex, and that of each vertex."""
    least = np.arange(count)
    while True:
        before = least.copy()
        lowest = least[faces].min(axis=1)
        for k in range(3):
            # Whoever stands for a corner hears of a lower number, too.
            np.minimum.at(least, least[faces[:, k]], lowest)
            np.minimum.at(least, faces[:, k], lowest)
        least = least[least]
        if np.array_equal(before, least):
            break
    names, chart = np.unique(least, return_inverse=True)
    return len(names), chart.reshape(-1)


def _shelves(extent: NDArray[np.int64]) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Place rectangles on shelves, the highest first; return where they are, and the size of all."""
    width = max(int(extent[:, 0].max()), math.ceil(math.sqrt(float(np.prod(extent, axis=1).sum()))))
    out = np.zeros_like(extent)
    x = y = shelf = widest = 0
    for k in np.lexsort((np.arange(len(extent)), -extent[:, 1])).tolist():
        across, down = extent[k].tolist()
        if x + across > width:
            x, y, shelf = 0, y + shelf, 0
        out[k] = x, y
        x, shelf = x + across, max(shelf, down)
        widest = max(widest, x)
    return out, (widest, y + shelf)


def _separated(surface: Arrays, moved: dict[int, tuple[Piece, list[NDArray[np.float32]]]]) -> Arrays:
    """Return a surface whose pieces share no vertices, some of them with other UVs."""
    split = pieces(surface)
    rows = np.concatenate([piece.used for piece in split])
    starts = np.cumsum([0, *(len(piece.used) for piece in split)])
    uvs = [
        np.concatenate(
            [
                moved[piece.number][1][k] if piece.number in moved else surface.uvs[k][piece.used]
                for piece in split
            ]
        )
        for k in range(len(surface.uvs))
    ]
    faces = np.concatenate([piece.faces + start for piece, start in zip(split, starts, strict=False)])
    numbers = np.concatenate([np.full(len(piece.faces), piece.number, np.int32) for piece in split])
    return replace(
        surface,
        vertices=surface.vertices[rows],
        faces=faces.astype(np.int32),
        normals=surface.normals[rows],
        fine_colors=None if surface.fine_colors is None else surface.fine_colors[rows],
        uvs=uvs,
        face_materials=numbers,
        channels={name: surface.channels[name][rows] for name in surface.channels},
    )
