"""Outlines of an image's alpha: what a leaf's card shows, as polygons in texels.

Alpha is what filtering makes of it: bilinear between the centres of texels, so outlines lie between texels
(contours of the grid of centres). Texels count from the image's upper left corner, v down; the centre of the first
is (0.5, 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors
from nanite_rs.exceptions import ArgumentError
from nanite_rs.texture import wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs.texture import Image

MOST_TEXELS: Final = 1 << 26
"""Texels of a window that are looked at at once: half a gigabyte of alpha."""
MOST_TOLERANCE: Final = 64.0
"""Texels up to which a tolerance grows where a number of triangles is asked for."""

_STEP: Final = 0.25
"""Texels between the samples at which outlines are compared."""
_BLOCKY: Final = 1e-3
"""Half the width, in texels, of the step between two texels of an image that is not filtered."""
_CHORD: Final = 0.03
"""Texels by which a side may be off the curve that it stands for."""
_STRAIGHT: Final = 1e-9
"""The twist of alpha, of 1, below which its contours are straight between four texels."""
_MITRE: Final = 5.0
"""How far corners may go beyond their sides' offset, times that."""


def libraries() -> tuple[Any, Any]:
    """Return shapely and contourpy.

    Raises
    ------
    DependencyError
        One is missing, or shapely is older than constrained triangulation.
    """
    try:
        import contourpy
    except ImportError as error:
        raise _advice.missing("foliage", "contourpy") from error
    try:
        import shapely
    except ImportError as error:
        raise _advice.missing("foliage", "shapely") from error
    if not hasattr(shapely, "constrained_delaunay_triangles"):
        raise _advice.missing("foliage", "shapely>=2.1")
    return shapely, contourpy


@dataclass(frozen=True)
class Mask:
    """Where an image has something: its alpha against a cutoff, and how it goes on outside."""

    alpha: NDArray[np.float32]
    """(H, W), 0 to 1."""
    wrap: tuple[str, str]
    linear: bool
    """Whether alpha is blended between texels."""
    cutoff: float
    """What is below it is a hole; above 0."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.alpha.shape[1], self.alpha.shape[0]

    def period(self) -> NDArray[np.float64]:
        """Return after how many texels along each axis it comes again; infinite where it does not."""
        times = {"repeat": 1.0, "mirror": 2.0, "clamp": math.inf}
        return np.array([size * times[way] for size, way in zip(self.size, self.wrap, strict=True)])

    def window(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return alpha of texels from ``low`` up to and without ``high``, both (x, y)."""
        columns, rows = (
            wrapped(np.arange(low[axis], high[axis]), self.size[axis], self.wrap[axis]) for axis in (0, 1)
        )
        return np.ascontiguousarray(self.alpha[rows[:, None], columns[None, :]])


@dataclass(frozen=True)
class Outlines:
    """Polygons, in texels, and how far they are from the contours that they stand for."""

    polygons: NDArray[Any]
    """Of shapely, with holes; no two overlap."""
    deviation: float
    """Texels, a bound: no point of either outline is farther from the other. Of `dropped` it says nothing."""
    area: float
    """Square texels inside the contours."""
    kept: float
    """Square texels inside the polygons."""
    tolerance: float
    """Texels that sides were simplified by."""
    dropped: int
    """Parts and holes smaller than the tolerance, whose area the others have."""

    def triangles(self) -> int:
        """Return the triangles that they are cut into."""
        return _triangles(self.polygons)


def alpha_of(image: Image) -> NDArray[np.float32] | None:
    """Return the alpha of an image, (H, W), 0 to 1; nothing where it has none."""
    pixels = image.pixels
    if pixels.shape[2] not in (2, 4):
        return None
    return np.asarray(pixels[..., -1] / _colors.white(pixels.dtype), np.float32)


@dataclass(frozen=True)
class Contours:
    """Where alpha crosses the cutoff, as polygons with sides that are nearly as it is."""

    polygons: NDArray[Any]
    off: float
    """Texels, a bound: how far a side is from the curve that it stands for."""


def traced(mask: Mask, low: NDArray[np.float64], high: NDArray[np.float64], margin: int) -> Contours:
    """Return the outlines of all that a mask has between two corners, in texels, and ``margin`` beyond."""
    shapely, contourpy = libraries()
    first = np.floor(low).astype(np.int64) - margin
    last = np.ceil(high).astype(np.int64) + margin
    texels = int(np.prod(last - first))
    if texels > MOST_TEXELS:
        raise ArgumentError(
            f"uvs: leaves of one image reach over {texels:,} texels, more than {MOST_TEXELS:,}; "
            "cards that repeat an image so often are no leaves, or use a smaller image"
        )
    alpha = mask.window(first, last).astype(np.float64)
    x, y = (np.arange(first[axis], last[axis]) + 0.5 for axis in (0, 1))
    off = 0.0
    if not mask.linear:
        alpha = alpha.repeat(2, axis=0).repeat(2, axis=1)
        edge = np.array([-0.5 + _BLOCKY, 0.5 - _BLOCKY])
        x, y = ((at[:, None] + edge).reshape(-1) for at in (x, y))
        off = 2.0 * _BLOCKY
    contours = contourpy.contour_generator(x, y, alpha, fill_type=contourpy.FillType.OuterOffset)
    found = []
    for points, offsets in zip(*contours.filled(mask.cutoff, 2.0), strict=True):
        rings = []
        for a, b in pairwise(offsets.tolist()):
            ring = points[a:b]
            if mask.linear:
                ring, bent = _bent(ring, alpha, first + 0.5, mask.cutoff)
                off = max(off, bent)
            if len(np.unique(ring, axis=0)) > 2:
                rings.append(ring)
        if rings:
            found.append(shapely.Polygon(rings[0], rings[1:]))
    if not found:
        return Contours(np.zeros(0, object), off)
    return Contours(_parts(shapely.make_valid(np.array(found, object))), off)


def _bent(
    ring: NDArray[np.float64], alpha: NDArray[np.float64], origin: NDArray[np.floating[Any]], level: float
) -> tuple[NDArray[np.float64], float]:
    """Put points on a ring where its sides are farther from the curve of bilinear alpha than `_CHORD`.

    Between four centres alpha is a + b x + c y + d x y. Its contours are hyperbolas X Y = k around a middle, which
    a side meets at its ends. The arc is farthest from the side where both are parallel: there its distances from
    the middle are the geometric means of those of the ends. Where the ends are on different branches, which happens
    when all but nothing lies between these, the side leads through the middle. Returns a bound of how far any side
    is off, too.
    """
    cells = np.array(alpha.shape)[::-1] - 2
    while True:
        one, two = ring[:-1] - origin, ring[1:] - origin
        cell = np.clip(np.floor((one + two) / 2.0).astype(np.int64), 0, cells)
        column, row = cell.T
        a = alpha[row, column]
        b, c = alpha[row, column + 1] - a, alpha[row + 1, column] - a
        d = alpha[row + 1, column + 1] - a - b - c
        curved = (np.abs(d) > _STRAIGHT) & (one != two).all(axis=1)
        d = np.where(curved, d, 1.0)
        middle = -np.stack([c, b], axis=1) / d[:, None]
        ends = one - cell - middle, two - cell - middle
        product = ends[0] * ends[1]
        crossed = curved & (product < -_STRAIGHT).any(axis=1)
        top = np.sign(ends[0] + ends[1]) * np.sqrt(np.maximum(product, 0.0))
        top[crossed] = 0.0
        off = np.where(curved, _beside(top, *ends), 0.0)
        more = (off > _CHORD) | crossed
        if not more.any():
            break
        ring = np.insert(ring, np.flatnonzero(more) + 1, (top + middle + cell + origin)[more], axis=0)
    # Sides that lead to a middle, against the arc up to its vertex.
    nearest = np.minimum(np.abs(ends[0]).max(axis=1), np.abs(ends[1]).max(axis=1))
    through = curved & (nearest < math.sqrt(_STRAIGHT))
    vertex = np.sqrt(np.abs((level - a + b * c / d) / d))[:, None] * np.ones(2)
    end = np.maximum(np.abs(ends[0]), np.abs(ends[1]))
    bound = _beside(np.sqrt(end * vertex), end, vertex) + np.hypot(*vertex.T)
    return ring, float(np.where(through, bound, off).max(initial=0.0))


def _beside(
    points: NDArray[np.float64], one: NDArray[np.float64], two: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far points (N, 2) are from the lines through two others each; 0 where these are one."""
    (ax, ay), (px, py) = (two - one).T, (points - one).T
    length = np.hypot(ax, ay)
    away = np.abs(ax * py - ay * px)
    return np.asarray(np.divide(away, length, out=np.zeros_like(length), where=length > 0.0))


def simplified(contours: Contours, tolerance: float, triangles: float | None = None) -> Outlines:
    """Return outlines of fewer sides, about the same area, and how far they are off.

    Sides are those of Douglas and Peucker (1973), no farther than ``tolerance`` texels from what they stand for.
    Then all of a part's are moved alike until it has its area again; that, too, is part of the deviation, which is
    measured. Where ``triangles`` are given, the tolerance grows until parts have as many in the mean.
    """
    shapely, _ = libraries()
    polygons = contours.polygons
    area = float(shapely.area(polygons).sum())
    while True:
        exact, dropped = _without_small(polygons, tolerance)
        simple = _with_area(shapely.simplify(exact, tolerance), exact, area)
        enough = triangles is None or _triangles(simple) <= triangles * max(len(simple), 1)
        if enough or tolerance >= MOST_TOLERANCE:
            break
        tolerance = min(max(tolerance, _STEP) * 1.25, MOST_TOLERANCE)
    kept = float(shapely.area(simple).sum())
    off = _deviation(exact, simple) + contours.off
    return Outlines(simple, off, area, kept, tolerance, dropped)


def _without_small(polygons: NDArray[Any], tolerance: float) -> tuple[NDArray[Any], int]:
    """Leave out parts and holes of less area than the tolerance's square, and count them."""
    shapely, _ = libraries()
    least = max(tolerance * tolerance, 1e-6)
    areas = shapely.area(polygons)
    large = areas >= (least if (areas >= least).any() else areas.max(initial=0.0))
    out, dropped = [], int((~large).sum())
    for polygon in polygons[large]:
        keep = [ring for ring in polygon.interiors if shapely.Polygon(ring).area >= least]
        dropped += len(polygon.interiors) - len(keep)
        out.append(shapely.Polygon(polygon.exterior, keep))
    return np.array(out, object), dropped


def _triangles(polygons: NDArray[Any]) -> int:
    """Return how many triangles polygons are cut into without more vertices: corners + 2 · holes − 2 of each."""
    shapely, _ = libraries()
    holes = shapely.get_num_interior_rings(polygons)
    # A ring's first corner comes again as its last.
    corners = shapely.get_num_coordinates(polygons) - holes - 1
    return int((corners + 2 * holes - 2).sum())


def _parts(geometries: Any) -> NDArray[Any]:
    """Return the polygons of whatever came out of an operation; lines and points have no area."""
    shapely, _ = libraries()
    parts = shapely.get_parts(shapely.get_parts(geometries))
    keep = (shapely.get_type_id(parts) == 3) & (shapely.area(parts) > 0.0)
    return np.asarray(parts[keep])


def _with_area(simple: NDArray[Any], exact: NDArray[Any], area: float) -> NDArray[Any]:
    """Move the sides of polygons until each has the area of its exact one, and all together have ``area``."""
    shapely, _ = libraries()
    if not len(simple):
        return simple
    # What small parts had is shared out by area.
    wanted = shapely.area(exact) * (area / max(float(shapely.area(exact).sum()), 1e-300))
    whole = shapely.polygons(shapely.get_exterior_ring(simple))
    holes = shapely.difference(whole, simple)
    moved, offset = simple, np.zeros(len(simple))
    for _ in range(3):
        lengths = np.maximum(shapely.length(moved), 1e-300)
        offset = offset + (wanted - shapely.area(moved)) / lengths
        moved = _offset(simple, offset)
        # Holes that would close stay as they are; then those of the outside move alone.
        closed = shapely.get_num_interior_rings(moved) != shapely.get_num_interior_rings(simple)
        if closed.any():
            moved[closed] = shapely.difference(_offset(whole[closed], offset[closed]), holes[closed])
        # What would vanish or fall apart stays, too.
        gone = (shapely.get_type_id(moved) != 3) | (shapely.area(moved) <= 0.0)
        moved, offset = np.where(gone, simple, moved), np.where(gone, 0.0, offset)
    return _parts(shapely.union_all(moved))


def _offset(polygons: NDArray[Any], distance: NDArray[np.float64]) -> NDArray[Any]:
    shapely, _ = libraries()
    return np.asarray(shapely.buffer(polygons, distance, join_style="mitre", mitre_limit=_MITRE))


def _deviation(exact: NDArray[Any], simple: NDArray[Any]) -> float:
    """Bound the distance of the points of either outline from the other."""
    shapely, _ = libraries()
    if not len(exact) or not len(simple):
        return 0.0
    farthest = 0.0
    for one, other in ((exact, simple), (simple, exact)):
        samples = shapely.points(shapely.get_coordinates(shapely.segmentize(shapely.boundary(one), _STEP)))
        rings = shapely.get_parts(shapely.boundary(other))
        tree = shapely.STRtree(_sides(rings))
        _, distances = tree.query_nearest(samples, return_distance=True, all_matches=False)
        farthest = max(farthest, float(distances.max()))
    # Between two samples the distance grows by no more than the way to the nearer one.
    return farthest + _STEP / 2.0


def _sides(rings: NDArray[Any]) -> NDArray[Any]:
    shapely, _ = libraries()
    points, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    return np.asarray(shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1)[same]))
