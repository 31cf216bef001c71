"""Texels of charts: which points of which triangles they show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# Candidates that are looked at at a time.
_AT_A_TIME: Final = 1 << 21


def covered(
    places: NDArray[np.float64], faces: NDArray[np.integer[Any]], size: tuple[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
    """Yield texels whose centres lie in triangles, for each of these.

    They come as their numbers, row by row from below, the triangles, and (N, 3) barycentric coordinates.
    """
    width, height = size
    corners = places[faces]
    low = np.clip(np.floor(corners.min(axis=1) - 0.5).astype(np.int64), 0, [width, height])
    high = np.clip(np.ceil(corners.max(axis=1) + 0.5).astype(np.int64), 0, [width, height])
    wide, tall = (high - low).T
    counts = wide * tall
    ends = np.cumsum(counts)
    first = 0
    while first < len(faces):
        before = int(ends[first - 1]) if first else 0
        last = max(int(np.searchsorted(ends, before + _AT_A_TIME, side="right")), first + 1)
        own = np.arange(first, last)
        triangle = np.repeat(own, counts[own])
        at = np.arange(len(triangle)) - np.repeat(ends[own] - counts[own] - before, counts[own])
        x = low[triangle, 0] + at % wide[triangle]
        y = low[triangle, 1] + at // wide[triangle]
        second, third = _shares(corners, triangle, x + 0.5, y + 0.5)
        inside = np.flatnonzero((second >= 0.0) & (third >= 0.0) & (second + third <= 1.0))
        second, third = second[inside], third[inside]
        yield (
            (y * width + x)[inside],
            triangle[inside],
            np.stack([1.0 - second - third, second, third], axis=1),
        )
        first = last


def _shares(
    corners: NDArray[np.float64], triangle: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the second and third barycentric coordinate of points; NaN in triangles without area."""
    first = corners[:, 0]
    (ux, uy), (vx, vy) = (corners[:, 1] - first).T, (corners[:, 2] - first).T
    whole = ux * vy - uy * vx
    scale = np.divide(1.0, whole, out=np.full_like(whole, np.nan), where=whole != 0.0)
    wx, wy = x - first[triangle, 0], y - first[triangle, 1]
    second = wx * (vy * scale)[triangle] - wy * (vx * scale)[triangle]
    third = wy * (ux * scale)[triangle] - wx * (uy * scale)[triangle]
    return second, third
