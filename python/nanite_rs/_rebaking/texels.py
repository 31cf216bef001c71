"""Texels of charts: which points of which triangles they show, and what is between charts."""

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


def filled(pixels: NDArray[np.float32], known: NDArray[np.bool_], rings: int) -> NDArray[np.float32]:
    """Return an image (H, W, C) whose unknown pixels have what is around them.

    The first ``rings`` around what is known have the mean of their neighbours; all else is known from smaller and
    smaller images, so that halving mixes no other colour in (pull-push, Gortler et al. 1996).
    """
    pixels, known = pixels.copy(), known.copy()
    for _ in range(rings):
        if known.all():
            return pixels
        weight, total = _around(known.astype(np.float32)), _around(np.where(known[..., None], pixels, 0.0))
        new = ~known & (weight > 0.0)
        pixels[new] = total[new] / weight[new][:, None]
        known |= new
    return _pushed(pixels, known)


def _around(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sums over nine pixels."""
    pad = [(1, 1), (1, 1), *[(0, 0)] * (values.ndim - 2)]
    wide = np.pad(values, pad)
    rows = wide[:-2] + wide[1:-1] + wide[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _pushed(pixels: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    height, width = known.shape
    if known.all() or not known.any() or (height == 1 and width == 1):
        return pixels
    odd = [(0, height % 2), (0, width % 2)]
    weight = np.pad(known.astype(np.float32), odd)
    total = np.pad(np.where(known[..., None], pixels, 0.0), [*odd, (0, 0)])
    weight = weight[::2, ::2] + weight[1::2, ::2] + weight[::2, 1::2] + weight[1::2, 1::2]
    total = total[::2, ::2] + total[1::2, ::2] + total[::2, 1::2] + total[1::2, 1::2]
    small = _pushed(total / np.maximum(weight, 1.0)[..., None], weight > 0.0)
    large = small.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return np.where(known[..., None], pixels, large)
