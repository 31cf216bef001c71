"""The way from cards to geometry, material by material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors
from nanite_rs._asset import Notes, Source
from nanite_rs._dilation import filled
from nanite_rs._flatten import concatenated
from nanite_rs._foliage import cards, masks, wind
from nanite_rs._foliage.inputs import numbers
from nanite_rs.exceptions import ArgumentError
from nanite_rs.texture import Image

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._foliage.cards import Lifted, Shown
    from nanite_rs._foliage.masks import Mask, Outlines
    from nanite_rs._foliage.roles import Role
    from nanite_rs._foliage.wind import Moving
    from nanite_rs.material import Material


@dataclass(frozen=True)
class Converted:
    """What became of the cards of one material."""

    material: int
    outlines: Outlines
    cards: int
    distinct: int
    error: float
    """Units of the mesh: how far an outline may be from the contour that it stands for."""


def converted(
    source: Source, roles: list[Role], *, tolerance: float, triangles: float | None, wind_up: int | None
) -> tuple[Source, list[Converted]]:
    """Replace the faces of all leaves by what their images show of them."""
    own = numbers(source)
    leaf = np.array([role.leaf for role in roles])[own]
    faces, points = source.faces, np.asarray(source.vertices, np.float64)
    moving = None if wind_up is None else wind.channels(points, faces[~leaf], faces[leaf], wind_up)
    looks, parts, found = list(source.materials), [_kept(source, own, ~leaf, moving)], []
    classes = _classes(source)
    for number, role in enumerate(roles):
        rows = np.flatnonzero(own == number)
        if role.mask is None or not len(rows):
            continue
        texels = _texels(source, looks[number], role.mask)
        ids = cards.numbered(points, texels)
        groups = [rows[group] for group in cards.facets(faces[rows], points, texels, ids, classes[rows])]
        shown = cards.Shown(groups, faces, texels, role.mask.period())
        outlines = _outlines(shown, role.mask, tolerance, triangles)
        lifted = cards.lifted(shown, faces, ids, outlines)
        if not len(lifted.triangles):
            raise ArgumentError(
                f"leaf_materials: {looks[number].name or number}: its cards show nothing above the cutoff"
            )
        parts.append(_on(source, number, lifted, ids, moving))
        looks[number] = _solid(looks[number], role.mask)
        stretch = _stretch(points[faces[rows]], texels[faces[rows]])
        found.append(
            Converted(
                number,
                outlines,
                int(cards.islands(faces[rows], points).max()) + 1,
                lifted.distinct,
                outlines.deviation * stretch,
            )
        )
    if not found:
        raise ArgumentError("source: no face has one of the materials of leaves")
    # All have the same columns: nothing is missing that a note would name.
    out = concatenated(parts, Notes(), follow=False)
    return replace(out, materials=tuple(looks)), found


def _texels(source: Source, look: Material, mask: Mask) -> NDArray[np.float64]:
    """Return where vertices lie in the image of a material, in texels, v down."""
    texture = look.base_color_texture
    if texture is None or texture.uv_set >= len(source.uvs):
        raise ArgumentError(f"uvs: the leaves of {look.name or 'a material'} have no texture coordinates")
    uv, rows = np.asarray(source.uvs[texture.uv_set], np.float64), np.asarray(texture._rows())
    return np.asarray((uv @ rows[:, :2].T + rows[:, 2]) * mask.size)


def _outlines(shown: Shown, mask: Mask, tolerance: float, triangles: float | None) -> Outlines:
    """Return the outlines of what facets show."""
    corners = np.concatenate([np.zeros((0, 2)), *(places.reshape(-1, 2) for places in shown.places)])
    if not len(corners):
        corners = np.zeros((1, 2))  # nothing is seen, whatever is there
    # Beyond what is seen by as much as sides may move, so that the edge of the window is nowhere seen.
    margin = math.ceil(2.0 * (tolerance if triangles is None else masks.MOST_TOLERANCE)) + 2
    contours = masks.traced(mask, corners.min(axis=0), corners.max(axis=0), margin)
    seen = replace(contours, polygons=shown.seen(contours.polygons))
    return masks.simplified(seen, tolerance, triangles)


def _classes(source: Source) -> NDArray[np.int64]:
    """Return a number for each face, the same where faces carry the same."""
    rows = [np.asarray(values).reshape(len(source.faces), -1) for values in source.face_channels.values()]
    if not rows:
        return np.zeros(len(source.faces), np.int64)
    kinds = [np.unique(row, axis=0, return_inverse=True)[1].reshape(-1) for row in rows]
    return np.unique(np.stack(kinds, axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _stretch(points: NDArray[np.float64], texels: NDArray[np.float64]) -> float:
    """Return the most units of the mesh that one texel of some triangles is long."""
    flat = np.stack([texels[:, 1] - texels[:, 0], texels[:, 2] - texels[:, 0]], axis=2)
    sides = np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], axis=2)
    used = np.abs(np.linalg.det(flat)) > cards.LEAST
    maps = sides[used] @ np.linalg.inv(flat[used])
    return float(np.linalg.svd(maps, compute_uv=False).max(initial=0.0))


def _kept(
    source: Source,
    own: NDArray[np.int64],
    keep: NDArray[np.bool_],
    moving: Moving | None,
) -> Source:
    """Return the faces that stay as they are."""
    used, faces = np.unique(source.faces[keep], return_inverse=True)
    out = Source(np.asarray(source.vertices)[used], faces.reshape(-1, 3).astype(np.int64))
    out.normals = None if source.normals is None else source.normals[used]
    out.colors = None if source.colors is None else source.colors[used]
    out.uvs = [uv[used] for uv in source.uvs]
    out.channels = {name: values[used] for name, values in source.channels.items()}
    for name, value in ({} if moving is None else moving.trunk).items():
        out.channels[name] = np.broadcast_to(value, (len(used), *np.shape(value)))
    out.face_materials = own[keep].astype(np.int32)
    out.face_channels = {name: values[keep] for name, values in source.face_channels.items()}
    return out


def _on(
    source: Source,
    number: int,
    lifted: Lifted,
    ids: NDArray[np.int64],
    moving: Moving | None,
) -> Source:
    """Return leaves with all that their cards carry."""

    def carried(values: NDArray[Any]) -> NDArray[Any]:
        values = np.asarray(values)
        if values.dtype.kind not in "f":
            nearest = np.take_along_axis(lifted.corners, lifted.shares.argmax(axis=1)[:, None], axis=1)[:, 0]
            return values[nearest]
        flat = values.reshape(len(values), -1)
        mixed = cards.blended(ids, lifted, flat).astype(values.dtype)
        return mixed.reshape(-1, *values.shape[1:])

    def colored(values: NDArray[Any]) -> NDArray[Any]:
        mixed = cards.blended(ids, lifted, values.astype(np.float64))
        return (np.rint(mixed) if values.dtype.kind == "u" else mixed).astype(values.dtype)

    out = Source(cards.blended(ids, lifted, np.asarray(source.vertices, np.float64)), lifted.triangles)
    if source.normals is not None:
        normals = cards.blended(ids, lifted, source.normals.astype(np.float64))
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        out.normals = (normals / np.where(length > 0.0, length, 1.0)).astype(np.float32)
    out.colors = None if source.colors is None else colored(source.colors)
    out.uvs = [carried(uv) for uv in source.uvs]
    out.channels = {name: carried(values) for name, values in source.channels.items()}
    # The same for a whole card.
    for name, values in ({} if moving is None else moving.leaves).items():
        out.channels[name] = values[lifted.corners[:, 0]]
    out.face_materials = np.full(len(lifted.triangles), number, np.int32)
    out.face_channels = {name: values[lifted.faces] for name, values in source.face_channels.items()}
    return out


def _solid(look: Material, mask: Mask) -> Material:
    """Return a material without alpha, whose colours go on beyond outlines as they are inside."""
    texture = look.base_color_texture
    assert texture is not None  # noqa: S101  roles looked at its alpha
    pixels = texture.image.pixels
    colors = pixels[..., :-1].astype(np.float32)
    whole = filled(colors, mask.alpha >= mask.cutoff, 1)
    if pixels.dtype.kind == "u":
        whole = np.clip(np.rint(whole), 0.0, _colors.white(pixels.dtype))
    image = Image(whole.astype(pixels.dtype))
    return replace(
        look,
        base_color=tuple(look.base_color[:3]),
        base_color_texture=replace(texture, image=image),
        alpha_mode="opaque",
    )
