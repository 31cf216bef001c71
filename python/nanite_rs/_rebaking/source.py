"""What the source shows at points near it: its materials there, as numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _colors, _core
from nanite_rs._export_parts import textures
from nanite_rs._export_textures import halved
from nanite_rs.texture import wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._export_parts import Surface
    from nanite_rs._rebaking.classes import Classes
    from nanite_rs.material import Material
    from nanite_rs.texture import Image, Texture

CHANNELS: Final = 13
"""Of a point: base colour and alpha, linear; occlusion, roughness, metallic; emitted light; the normal."""
COLOR, ORM, LIGHT, NORMAL = slice(0, 4), slice(4, 7), slice(7, 10), slice(10, 13)


class Source:
    """A surface at full detail, with its looks."""

    def __init__(self, surface: Surface, classes: Classes) -> None:
        self.vertices = np.asarray(surface.vertices, np.float64)
        self.faces = np.ascontiguousarray(surface.faces)
        self._normals = np.asarray(surface.normals, np.float64)
        self._uvs = [np.asarray(uv, np.float64) for uv in surface.uvs]
        numbers = surface.face_materials
        self._numbers = np.zeros(len(self.faces), np.int64) if numbers is None else numbers.astype(np.int64)
        self._classes = classes
        self._smaller: dict[tuple[int, int, bool], Image] = {}
        self._texel: float | None = None

    def texel(self) -> float:
        """The size of its detail, in units of the mesh: of a texel, or of a triangle, whose normals are some."""
        if self._texel is None:
            self._texel = self._finest()
        return self._texel

    def _finest(self) -> float:
        corners = self.vertices[self.faces]
        across = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.sqrt(dot(across, across))
        triangle = math.sqrt(float(areas.sum()) / 2.0 / len(areas))
        sizes = np.full(len(areas), np.inf)
        for number in np.unique(self._numbers).tolist():
            own = self._numbers == number
            for _, texture in textures(self._classes.look(number)):
                if texture.uv_set >= len(self._uvs):
                    continue
                sides = self._sides(texture, np.flatnonzero(own))
                covered = np.abs(sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0])
                with np.errstate(divide="ignore", invalid="ignore"):
                    size = np.sqrt(areas[own] / covered)
                sizes[own] = np.fmin(sizes[own], np.where(covered > 0.0, size, np.inf))
        known = np.isfinite(sizes) & (areas > 0.0)
        if not known.any():
            return triangle
        # The median over its area, of the finest image of each part.
        order = np.argsort(sizes[known], kind="stable")
        upto = np.cumsum(areas[known][order])
        return min(float(sizes[known][order][np.searchsorted(upto, upto[-1] / 2.0)]), triangle)

    def _sides(
        self, texture: Texture, rows: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return two sides of faces in texels of an image."""
        corners = self._places(texture)[self.faces[rows]] * texture.image.size
        return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]

    def _places(self, texture: Texture) -> NDArray[np.float64]:
        """Return where vertices are in an image, in its sides, v down."""
        uv = self._uvs[texture.uv_set]
        rows = np.asarray(texture._rows())
        return np.asarray(uv @ rows[:, :2].T + rows[:, 2])

    def at(self, points: NDArray[np.float64], texel: float) -> NDArray[np.float32]:
        """Return (N, CHANNELS) of the nearest points; means over about a texel where images are finer."""
        _, rows, nearest = _core.closest_points(points, self.vertices, self.faces)
        shares = _shares(self.vertices[self.faces[rows]], nearest)
        normals = unit(mixed(self._normals[self.faces[rows]], shares))
        out = np.empty((len(points), CHANNELS), np.float32)
        numbers = self._numbers[rows]
        for number in np.unique(numbers).tolist():
            own = numbers == number
            look = self._classes.look(number)
            out[own] = self._look(look, rows[own], shares[own], normals[own], texel)
        return out

    def _look(
        self,
        look: Material,
        rows: NDArray[np.uint32],
        shares: NDArray[np.float64],
        normals: NDArray[np.float64],
        texel: float,
    ) -> NDArray[np.float32]:
        out = np.empty((len(rows), CHANNELS), np.float32)
        alpha = look.base_color[3] if len(look.base_color) == 4 else 1.0
        out[:, COLOR] = (*look.base_color[:3], alpha)
        out[:, ORM] = (1.0, look.roughness, look.metallic)
        out[:, LIGHT] = look.emissive
        if not look.smooth:
            corners = self.vertices[self.faces[rows]]
            normals = unit(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        out[:, NORMAL] = normals
        found = {
            slot: self._sampled(
                texture, slot in ("base_color_texture", "emissive_texture"), rows, shares, texel
            )
            for slot, texture in textures(look)
            if texture.uv_set < len(self._uvs)
        }
        if (color := found.get("base_color_texture")) is not None:
            out[:, COLOR] *= color
        if (both := found.get("metallic_roughness_texture")) is not None:
            out[:, ORM][:, 1:] *= both[:, 1:3]
        if (occlusion := found.get("occlusion_texture")) is not None:
            out[:, ORM][:, 0] = 1.0 + look.occlusion_strength * (occlusion[:, 0] - 1.0)
        if (light := found.get("emissive_texture")) is not None:
            out[:, LIGHT] *= light[:, :3]
        if (bent := found.get("normal_texture")) is not None and look.normal_texture is not None:
            corners = self.vertices[self.faces[rows]]
            places = self._places(look.normal_texture)[self.faces[rows]]
            along, side = frames(corners, places, normals)
            x, y = (look.normal_scale * (2.0 * bent[:, k, None] - 1.0) for k in (0, 1))
            out[:, NORMAL] = unit(along * x + side * y + normals * (2.0 * bent[:, 2, None] - 1.0))
        return out

    def _sampled(
        self,
        texture: Texture,
        color: bool,
        rows: NDArray[np.uint32],
        shares: NDArray[np.float64],
        texel: float,
    ) -> NDArray[np.float32]:
        """Return (N, 4) of a texture, colours linear."""
        places = mixed(self._places(texture)[self.faces[rows]], shares)
        used = np.flatnonzero(np.bincount(rows, minlength=len(self.faces)))
        sides = self._sides(texture, used)
        covered = np.abs(sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0]).sum()
        corners = self.vertices[self.faces[used]]
        across = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.sqrt(dot(across, across)).sum()
        wide = texel * math.sqrt(covered / area) if area > 0.0 else 1.0
        most = int(math.log2(max(texture.image.size)))
        times = min(max(math.floor(math.log2(max(wide, 1.0))), 0), most)
        image = texture.image
        if times:
            key = (id(image), times, color)
            if key not in self._smaller:
                self._smaller[key] = halved(image, times, color)
            image = self._smaller[key]
        return sample(image.pixels, places, texture.wrap, texture.filter == "linear", color)


def sample(
    pixels: NDArray[Any],
    places: NDArray[np.float64],
    wrap: tuple[str, str] | str,
    linear: bool,
    color: bool,
) -> NDArray[np.float32]:
    """Return (N, 4) of an image at places in its sides, v down: RGB, linear if they are colours, and alpha."""
    height, width, count = pixels.shape
    ways = (wrap, wrap) if isinstance(wrap, str) else wrap
    at = places * [width, height] - (0.5 if linear else 0.0)
    base = np.floor(at).astype(np.int64)
    part = (at - base) if linear else np.zeros_like(at)
    out = np.zeros((len(places), 4), np.float32)
    out[:, 3] = 1.0
    light = count - (count in (2, 4))
    srgb = color and pixels.dtype.kind == "u"
    white = _colors.white(pixels.dtype)
    table = _colors.from_srgb(np.arange(int(white) + 1) / white).astype(np.float32) if srgb else None
    total = np.zeros((len(places), count), np.float32)
    for dy in (0, 1) if linear else (0,):
        row = wrapped(base[:, 1] + dy, height, ways[1])
        for dx in (0, 1) if linear else (0,):
            column = wrapped(base[:, 0] + dx, width, ways[0])
            own = pixels[row, column]
            values = np.empty(own.shape, np.float32)
            values[:, :light] = own[:, :light] / white if table is None else table[own[:, :light]]
            values[:, light:] = own[:, light:] / white
            weight = (part[:, 0] if dx else 1.0 - part[:, 0]) * (part[:, 1] if dy else 1.0 - part[:, 1])
            total += values * weight[:, None].astype(np.float32)
    out[:, :3] = total[:, :3] if light == 3 else total[:, :1]
    if light != count:
        out[:, 3] = total[:, -1]
    return out


def frames(
    corners: NDArray[np.float64], places: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the rows of an image lie along, and where its columns go up, at right angles to normals.

    ``corners`` are (N, 3, 3), ``places`` theirs in the image, v down (docs/materials.md). Both are 0 where
    coordinates have no area.
    """
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    s, t = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    turn = np.where(s[:, 0] * t[:, 1] - t[:, 0] * s[:, 1] < 0.0, -1.0, 1.0)[:, None]
    along = (e * t[:, 1:2] - f * s[:, 1:2]) * turn
    up = (e * t[:, :1] - f * s[:, :1]) * turn
    along = unit(along - normals * dot(along, normals)[:, None])
    side = cross(normals, along)
    sign = np.where(dot(side, up) < 0.0, -1.0, 1.0)[:, None]
    return along, side * sign


def dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the products of rows."""
    return np.asarray(np.einsum("nk,nk->n", a, b))


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return cross products of rows; NumPy's takes several times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def mixed(corners: NDArray[np.float64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return means of corners (N, 3, K) by barycentric coordinates (N, 3)."""
    return np.asarray(np.einsum("nck,nc->nk", corners, shares))


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors of length 1, or 0 where they have none."""
    size = np.sqrt(dot(vectors, vectors))[:, None]
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)


def _shares(corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return barycentric coordinates of points on triangles: (N, 3), none below 0."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    uu, uv, vv, uw, vw = (dot(a, b) for a, b in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    whole = uu * vv - uv * uv
    scale = np.divide(1.0, whole, out=np.zeros_like(whole), where=whole > 0.0)
    second, third = (vv * uw - uv * vw) * scale, (uu * vw - uv * uw) * scale
    out = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, None)
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-300))
