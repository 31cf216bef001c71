"""Cards: how the triangles of leaves lie in an image, and outlines cut to them and put on their surface.

Neighbouring triangles that lie in space as they lie in the image, but for one affine map, are one facet: a flat
card is one, however it is divided, and no outline is cut at its diagonals. A bent card has several. What they show
of an image is cut once for all facets that show the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs._foliage.masks import libraries

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from nanite_rs._foliage.masks import Outlines

MOST_TRIANGLES: Final = 4096
"""Triangles of a facet: each point of an outline looks for its triangle among them."""

_FLAT: Final = 1e-4
"""Of the longest side: how far a corner may be from where the map of a neighbouring triangle has it."""
_SNAP: Final = 1e-7
"""Shares of a corner, barycentric, below which a point lies on the opposite side."""
_SAME: Final = 1e-6
"""Of a side: how close two points on it are one."""
LEAST: Final = 1e-6
"""Square texels, twice: what shows no more of an image shows nothing."""
_GRID: Final = 1e6
"""Steps of a texel, for telling which facets show the same."""


@dataclass
class Lifted:
    """Points on faces of the source, and triangles of them."""

    corners: NDArray[np.int64]
    """(N, 3) vertices of the face on which each point lies."""
    shares: NDArray[np.float64]
    """(N, 3), what each point has of these; none below 0, 1 in all."""
    triangles: NDArray[np.int64]
    """(M, 3) points, wound as the face on which they lie."""
    faces: NDArray[np.int64]
    """(M,) faces of the source."""
    distinct: int
    """Facets that show different things."""


def facets(
    faces: NDArray[np.int64],
    points: NDArray[np.float64],
    texels: NDArray[np.float64],
    ids: NDArray[np.int64],
    classes: NDArray[np.int64],
) -> list[NDArray[np.int64]]:
    """Return groups of triangles, as rows of ``faces``, that one affine map puts from an image into space.

    ``points`` (N, 3) and ``texels`` (N, 2) are where vertices lie, ``ids`` their numbers by that (`numbered`);
    triangles of different ``classes`` stay apart.
    Triangles without area in the image are in no group.
    """
    area = _turn(texels[faces])
    used = np.flatnonzero(np.abs(area) > LEAST)
    corner = ids[faces[used]]
    count = int(corner.max(initial=0)) + 1
    # An edge as one triangle has it, and as its neighbour has it.
    ahead = corner[:, [0, 1, 2]] * count + corner[:, [1, 2, 0]]
    back = corner[:, [1, 2, 0]] * count + corner[:, [0, 1, 2]]
    keys, rows, times = np.unique(ahead, return_index=True, return_counts=True)
    at = np.minimum(np.searchsorted(keys, back), max(len(keys) - 1, 0))
    met = (keys[at] == back) & (times[at] == 1) & (times[np.searchsorted(keys, ahead)] == 1)
    one, side = np.nonzero(met)
    two, other = np.divmod(rows[at[one, side]], 3)
    first = one < two
    one, two, other = one[first], two[first], other[first]
    a, b = used[one], used[two]
    far = faces[b, (other + 2) % 3]
    error = np.linalg.norm(_mapped(points[faces[a]], texels[faces[a]], texels[far]) - points[far], axis=1)
    longest = np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2).max(
        axis=1, initial=0.0
    )
    flat = (error <= _FLAT * np.minimum(longest[a], longest[b])) & (area[a] * area[b] > 0.0)
    flat &= classes[a] == classes[b]
    group = _joined(len(used), one[flat], two[flat])
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    return [used[rows] for rows in np.split(order, starts[1:])] if len(used) else []


class Shown:
    """What facets show of an image: each thing once, with the facets that show it."""

    def __init__(
        self,
        groups: Iterable[NDArray[np.int64]],
        faces: NDArray[np.int64],
        texels: NDArray[np.float64],
        period: NDArray[np.float64],
    ) -> None:
        self.places: list[NDArray[np.float64]] = []
        """Of each, the (T, 3, 2) corners of its triangles in texels."""
        self.facets: list[list[NDArray[np.int64]]] = []
        """Of each, the faces (T,) of every facet that shows it."""
        self._known: dict[bytes, int] = {}
        for group in groups:
            for first in range(0, len(group), MOST_TRIANGLES):
                self._add(group[first : first + MOST_TRIANGLES], faces, texels, period)

    def _add(
        self,
        rows: NDArray[np.int64],
        faces: NDArray[np.int64],
        texels: NDArray[np.float64],
        period: NDArray[np.float64],
    ) -> None:
        places = folded(texels[faces[rows]], period)
        key = np.rint(places * _GRID).astype(np.int64).tobytes()
        number = self._known.get(key)
        if number is None:
            if len(rows) > 1 and _overlaps(places):
                for row in rows[:, None]:
                    self._add(row, faces, texels, period)
                return
            number = self._known[key] = len(self.places)
            self.places.append(places)
            self.facets.append([])
        self.facets[number].append(rows)

    def seen(self, polygons: NDArray[Any]) -> NDArray[Any]:
        """Return those polygons of which any facet shows a part."""
        shapely, _ = libraries()
        regions = np.array([_region(places) for places in self.places], object)
        _, rows = shapely.STRtree(polygons).query(regions, predicate="intersects")
        return np.asarray(polygons[np.unique(rows)])


def lifted(
    shown: Shown,
    faces: NDArray[np.int64],
    ids: NDArray[np.int64],
    outlines: Outlines,
) -> Lifted:
    """Cut outlines to facets, divide them into triangles, and put these where the facets lie."""
    found = _Points()
    shapely, _ = libraries()
    tree = shapely.STRtree(outlines.polygons)
    for places, facets in zip(shown.places, shown.facets, strict=True):
        flat, triangles = _cut(places, outlines.polygons, tree)
        if len(triangles):
            found.add(np.array(facets), places, flat, triangles, faces)
    corners, shares, triangles, rows = found.joined()
    return Lifted(corners, _met(ids, corners, shares), triangles, rows, len(shown.places))


def folded(places: NDArray[np.float64], period: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move triangles (N, 3, 2) by whole repetitions of an image, to where it begins."""
    low = places.reshape(-1, 2).min(axis=0)
    again = np.isfinite(period)
    # What begins a hair before the image is meant to begin with it.
    times = np.floor((low[again] + 1e-3) / period[again])
    out = places.copy()
    out[..., again] -= times * period[again]
    return out


class _Points:
    """Points and triangles of all facets."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[Any], ...]] = []
        self._count = 0

    def add(
        self,
        facets: NDArray[np.int64],
        places: NDArray[np.float64],
        flat: NDArray[np.float64],
        triangles: NDArray[np.int64],
        faces: NDArray[np.int64],
    ) -> None:
        """Put what was cut onto each of (K, T) facets, whose T triangles lie in the image at ``places``."""
        within, shares = _located(places, flat)
        middle, _ = _located(places, flat[triangles].mean(axis=1))
        # As the facet's triangles are wound, which all are alike.
        if _turn(places[:1])[0] < 0.0:
            triangles = triangles[:, ::-1]
        many = len(facets)
        first = self._count + np.arange(many)[:, None, None] * len(flat)
        self._parts.append(
            (
                faces[facets[:, within]].reshape(-1, 3),
                np.tile(shares, (many, 1)),
                (triangles[None] + first).reshape(-1, 3),
                facets[:, middle].reshape(-1),
            )
        )
        self._count += many * len(flat)

    def joined(self) -> tuple[NDArray[Any], ...]:
        """Return the corners and shares of points, triangles, and the faces of the source that these lie on."""
        if not self._parts:
            return (
                np.zeros((0, 3), np.int64),
                np.zeros((0, 3)),
                np.zeros((0, 3), np.int64),
                np.zeros(0, np.int64),
            )
        return tuple(np.concatenate(column) for column in zip(*self._parts, strict=True))


def _overlaps(places: NDArray[np.float64]) -> bool:
    """Whether triangles (N, 3, 2) lie over each other."""
    parts = np.abs(_turn(places)).sum() / 2.0
    return bool(abs(_region(places).area - parts) > 1e-6 * parts)


def _region(places: NDArray[np.float64]) -> Any:
    """Return all of triangles (N, 3, 2) as one polygon."""
    shapely, _ = libraries()
    polygons = shapely.polygons(places)
    return polygons[0] if len(polygons) == 1 else shapely.union_all(polygons)


def _cut(
    places: NDArray[np.float64], polygons: NDArray[Any], tree: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return points (N, 2) and triangles, counter-clockwise in (u, v down), of what outlines have in a facet."""
    shapely, _ = libraries()
    region = _region(places)
    near = tree.query(region, predicate="intersects")
    inside = shapely.intersection(polygons[np.sort(near)], region)
    parts = shapely.get_parts(shapely.get_parts(inside))
    parts = parts[(shapely.get_type_id(parts) == 3) & (shapely.area(parts) > LEAST)]
    if not len(parts):
        return np.zeros((0, 2)), np.zeros((0, 3), np.int64)
    # A Delaunay triangulation that keeps all sides and adds no corner.
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(parts))
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    corners = corners[np.abs(_turn(corners)) > LEAST]
    turned = _turn(corners) < 0.0
    corners[turned] = corners[turned][:, ::-1]
    points, triangles = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    return points, triangles.reshape(-1, 3)


def _located(
    places: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return in which of some triangles points lie, and what they have of its corners."""
    best, within = np.full(len(points), -np.inf), np.zeros(len(points), np.int64)
    shares = np.zeros((len(points), 3))
    for number, triangle in enumerate(places):
        a, b, c = triangle
        edges = np.linalg.inv(np.stack([b - a, c - a], axis=1))
        second, third = edges @ (points - a).T
        own = np.stack([1.0 - second - third, second, third], axis=1)
        least = own.min(axis=1)
        better = least > best + _SNAP
        best[better], within[better], shares[better] = least[better], number, own[better]
    shares = np.where(shares < _SNAP, 0.0, shares)
    return within, shares / shares.sum(axis=1, keepdims=True)


def _met(
    ids: NDArray[np.int64], corners: NDArray[np.int64], shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Have points on a side that two facets share lie at the same place of it, to the last bit."""
    out = shares.copy()
    rows = np.flatnonzero((shares == 0.0).sum(axis=1) == 1)
    off = np.argmin(shares[rows], axis=1)
    ends = np.stack([(off + 1) % 3, (off + 2) % 3], axis=1)
    names = np.take_along_axis(ids[corners[rows]], ends, axis=1)
    swap = names[:, 0] > names[:, 1]
    ends[swap], names[swap] = ends[swap][:, ::-1], names[swap][:, ::-1]
    along = shares[rows, ends[:, 1]]
    order = np.lexsort([along, names[:, 1], names[:, 0]])
    same = (np.diff(names[order], axis=0) == 0).all(axis=1) & (np.diff(along[order]) <= _SAME)
    start = np.maximum.accumulate(np.where(np.concatenate([[True], ~same]), np.arange(len(order)), 0))
    met = np.empty(len(rows))
    met[order] = along[order][start] if len(order) else along
    out[rows, ends[:, 1]], out[rows, ends[:, 0]] = met, 1.0 - met
    return out


def blended(ids: NDArray[np.int64], lifted: Lifted, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return what points have of ``values`` of vertices (V, K): sums in an order that neighbours share."""
    order = np.argsort(ids[lifted.corners], axis=1, kind="stable")
    corners = np.take_along_axis(lifted.corners, order, axis=1)
    shares = np.take_along_axis(lifted.shares, order, axis=1)
    total = np.zeros((len(corners), values.shape[1]))
    for k in range(3):
        total += shares[:, k, None] * values[corners[:, k]]
    return total


def numbered(points: NDArray[np.float64], texels: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a number for each vertex, the same for those that lie at one place of space and of the image."""
    return _ids(np.concatenate([points, texels], axis=1))


def _ids(rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a number for each row, the same for equal ones."""
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def _turn(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twice the area of triangles (N, 3, 2), below 0 of those wound the other way."""
    (ux, uy), (vx, vy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(ux * vy - uy * vx)


def _mapped(
    points: NDArray[np.float64], texels: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where the maps of triangles put places of the image (N, 2)."""
    edges = np.linalg.inv(np.stack([texels[:, 1] - texels[:, 0], texels[:, 2] - texels[:, 0]], axis=2))
    shares = np.einsum("nij,nj->ni", edges, at - texels[:, 0])
    sides = np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], axis=1)
    return np.asarray(points[:, 0] + np.einsum("ni,nij->nj", shares, sides))


def islands(faces: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return for each face the number of the connected part that it is of, by where its corners lie.

    They count in the order of their first faces.
    """
    place = _ids(points)[faces]
    both = np.concatenate([place[:, :2], place[:, 1:]])
    part = _joined(int(place.max(initial=-1)) + 1, both[:, 0], both[:, 1])[place[:, 0]]
    _, first, row = np.unique(part, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[row.reshape(-1)]


def _joined(count: int, one: NDArray[np.int64], two: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each of ``count`` items the least one that pairs connect it with."""
    least = np.arange(count)
    while True:
        lower = np.minimum(least[one], least[two])
        before = least.copy()
        # Onto what both stand for, so that whole chains move at once.
        np.minimum.at(least, before[one], lower)
        np.minimum.at(least, before[two], lower)
        least = least[least]
        if np.array_equal(before, least):
            return least
