"""Smaller images for coarse levels: as many texels as these can show."""

from __future__ import annotations

import math
from dataclasses import replace
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _colors, _export_ktx2
from nanite_rs._export_parts import COLORS, Arrays, integers, pieces, png, textures
from nanite_rs._images import JPEG
from nanite_rs.texture import Image

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._export_packing import ImageFormat
    from nanite_rs._export_parts import Piece, Surface
    from nanite_rs.material import Material
    from nanite_rs.texture import Texture

QUALITY: Final = 92
"""Of JPEG, and of colours as WebP."""


def fitted(surface: Surface, per_unit: float) -> Surface:
    """Return a surface whose images have a texel for each pixel, or up to four, where a unit has so many pixels."""
    known: dict[int, tuple[Image, bool, int]] = {}
    for piece in pieces(surface):
        for slot, texture in textures(piece.material):
            own = halvings(surface, piece, texture, per_unit)
            image, color, least = known.get(id(texture.image), (texture.image, slot in COLORS, own))
            # Whoever needs most decides.
            known[id(image)] = image, color, min(least, own)
    smaller = {key: halved(image, times, color) for key, (image, color, times) in known.items() if times > 0}
    if not smaller:
        return surface
    looks = [_with(look, smaller) for look in surface.materials]
    return Arrays.of(surface, tuple(looks))


def _with(look: Material, images: dict[int, Image]) -> Material:
    own: dict[str, Any] = {
        slot: replace(texture, image=images[id(texture.image)])
        for slot, texture in textures(look)
        if id(texture.image) in images
    }
    return replace(look, **own)


def halvings(surface: Surface, piece: Piece, texture: Texture, per_unit: float) -> int:
    """Return how often an image can be halved."""
    if texture.uv_set >= len(surface.uvs):
        return 0
    corners = surface.vertices[piece.used][piece.faces].astype(np.float64)
    uv = surface.uvs[texture.uv_set][piece.used][piece.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(across, axis=1).sum())
    (a, b, _), (c, d, _) = texture._rows()
    e, f = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    covered = float(np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]).sum()) * abs(a * d - b * c)
    width, height = texture.image.size
    if not (area > 0.0 and covered > 0.0):
        return 0
    texels = math.sqrt(covered * width * height / area)
    # Four texels to a pixel are left at most.
    most = int(math.log2(max(width, height)))
    return min(max(math.floor(math.log2(max(texels / per_unit, 1.0))), 0), most)


def halved(image: Image, times: int, color: bool) -> Image:
    """Return an image of which each side was halved so often; colours are averaged in linear light."""
    width, height = image.size
    size = max(width >> times, 1), max(height >> times, 1)
    return stored(_averaged(image.pixels, size, color), image.encoded())


def stored(pixels: NDArray[Any], file: bytes | None) -> Image:
    """Return an image of what was made of another one: a JPEG where that was one."""
    if file is None or not file.startswith(JPEG) or pixels.dtype != np.uint8 or pixels.shape[2] not in (1, 3):
        return Image(pixels)
    return Image._read(_saved(pixels, format="JPEG", quality=QUALITY, subsampling=0), "image")


def encoded_as(kind: ImageFormat, image: Image, color: bool, notes: Notes) -> tuple[bytes, str]:
    """Return an image in a format, and its ending. WebP and PNG hold what is no colour without loss.

    JPEG has no alpha: an image that needs it is PNG. Neither JPEG, WebP nor Basis Universal in KTX have 16 bits.
    """
    pixels = integers(image, color, notes)
    if kind == "png":
        return png(pixels), "png"
    if kind == "jpeg" and image._alpha_varies():
        notes.add("images as JPEG, which has no alpha: they are PNG")
        return png(pixels), "png"
    if pixels.dtype == np.uint16:
        notes.add("images of more than 8 bits")
        pixels = np.rint(pixels / 257.0).astype(np.uint8)
    count = pixels.shape[2]
    if kind == "ktx2":
        bright = pixels[..., :3] if count > 2 else np.repeat(pixels[..., :1], 3, axis=2)
        alpha = pixels[..., -1:] if count in (2, 4) else np.full_like(pixels[..., :1], 255)
        whole = _export_ktx2.in_blocks(np.concatenate([bright, alpha], axis=2))
        return _export_ktx2.encoded(_levels(whole, color), color), "ktx2"
    if count in (2, 4):
        # Grey and alpha are as three colours and alpha.
        bright = np.repeat(pixels[..., :1], 3, axis=2) if count == 2 else pixels[..., :3]
        pixels = bright if kind == "jpeg" else np.concatenate([bright, pixels[..., -1:]], axis=2)
    if kind == "jpeg":
        return _saved(pixels, format="JPEG", quality=QUALITY, subsampling=0), "jpg"
    if count == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    return _saved(pixels, format="WEBP", quality=QUALITY, lossless=not color, exact=True, method=4), "webp"


def _saved(pixels: NDArray[Any], **how: Any) -> bytes:
    from PIL import Image as Pillow

    buffer = BytesIO()
    Pillow.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(buffer, **how)
    return buffer.getvalue()


def _levels(pixels: NDArray[Any], color: bool) -> list[NDArray[Any]]:
    """Return an image and its halvings, down to one texel."""
    height, width = pixels.shape[:2]
    levels = [pixels]
    for k in range(1, max(height, width).bit_length()):
        levels.append(_averaged(levels[-1], (max(width >> k, 1), max(height >> k, 1)), color))
    return levels


def _averaged(pixels: NDArray[Any], size: tuple[int, int], color: bool) -> NDArray[Any]:
    """Return the means of what texels cover, by area where sides are odd."""
    count = pixels.shape[2]
    bright = count - (count in (2, 4)) if color and pixels.dtype.kind == "u" else 0
    scale = _colors.white(pixels.dtype)
    out = np.empty((size[1], size[0], count))
    for k in range(count):
        channel = pixels[..., k] / scale
        channel = _colors.from_srgb(channel) if k < bright else channel
        small = _shorter(_shorter(channel, size[1]).T, size[0]).T
        out[..., k] = _colors.to_srgb(small) if k < bright else small
    out *= scale
    return (out if pixels.dtype.kind == "f" else np.rint(out)).astype(pixels.dtype)


def _shorter(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return so many means of rows, each of as many, and parts of those at the ends."""
    sums = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])
    edges = np.linspace(0.0, len(rows), count + 1)
    whole = np.minimum(edges.astype(np.int64), len(rows) - 1)
    upto = sums[whole] + (edges - whole)[:, None] * rows[whole]
    means: NDArray[np.float64] = np.diff(upto, axis=0) * (count / len(rows))
    return means
