"""`heightfield`: terrain as a mesh with few triangles, within a tolerance of all posts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs.exceptions import ArgumentError, DtypeError, MeshError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

__all__ = ["HeightfieldMesh", "heightfield"]

# Roles of posts, as the core has them.
_NONE, _MEASURED, _OUTLINE = 0, 1, 2
# Posts of a side of a piece; the core takes 8,192.
_MOST_POSTS = 4096


@dataclass(frozen=True)
class HeightfieldMesh:
    """What `heightfield` returns. ``len(mesh)`` is the number of triangles."""

    vertices: NDArray[np.float64]
    """Positions, (N, 3): x along columns, y against rows, so that the last row is at y = 0, z up."""
    faces: NDArray[np.uint32]
    """Triangles, (M, 3), counter-clockwise seen from above."""
    uvs: NDArray[np.float64]
    """Texture coordinates, (N, 2), of a texture with a texel for each post."""
    posts: NDArray[np.int64]
    """Row and column of each vertex, (N, 2)."""
    error: float
    """Largest vertical distance of a post of the surface, in the unit of the heights, rounded up."""
    rms: float
    """Root mean square of these distances."""
    measured_posts: int
    """Posts of the surface."""
    lost_posts: int
    """Posts with heights that no three of a cell go with, which are in no triangle."""

    def __len__(self) -> int:
        return len(self.faces)


def heightfield(
    heights: ArrayLike,
    *,
    spacing: float | tuple[float, float] = 1.0,
    tolerance: float,
    nodata: float | None = None,
    max_triangles: int | None = None,
    fit: bool = True,
    piece: int = 2048,
) -> HeightfieldMesh:
    """Triangulate terrain: no post is farther from the mesh than the tolerance, vertically.

    The post that is farthest off is inserted into a Delaunay triangulation until none is too far (Garland and
    Heckbert 1995). Then vertices move up and down to where the sum of squares over all posts is least, as far
    as the tolerance allows.

    Cells between four posts are the surface, and halves of cells that lack one. Outlines of holes are kept
    exactly, with all of their posts. Large arrays, `numpy.memmap` too, are read in pieces, which share the
    posts at their borders: these are chosen by the border alone.

    Parameters
    ----------
    heights : (H, W) array of integers or floating-point numbers
        Rows from the top (north); NaN where there are none. At least 2 by 2. Masked arrays have holes where
        they are masked.
    spacing : float or (float, float)
        Between columns, or between columns and between rows.
    tolerance : float
        Largest vertical distance of a post, in the unit of the heights.
    nodata : float, optional
        The value that stands for no height, such as -32768.
    max_triangles : int, optional
        Stops at so many, with those that help most, and a `UsageWarning` says what was reached. Outlines and
        borders are there in any case.
    fit : bool
        Whether vertices may leave their posts.
    piece : int
        Posts of a side of a piece, 2 to 4,096. Memory follows the piece and the result.

    Returns
    -------
    HeightfieldMesh

    Raises
    ------
    ArgumentError, DtypeError
        An argument has the wrong shape, dtype or range, or a height is infinite; the message names row and
        column.
    MeshError
        Nothing is left.

    Examples
    --------
    >>> x, y = np.meshgrid(np.linspace(-3, 3, 200), np.linspace(-3, 3, 200))
    >>> made = nrs.heightfield(np.exp(-x * x - y * y), spacing=0.03, tolerance=0.01)
    >>> made.error <= 0.01 and len(made) < 1_000
    True
    """
    array = heights if isinstance(heights, np.ndarray) else np.asarray(heights)
    if array.dtype.kind not in "iuf":
        raise DtypeError(f"heights: expected integers or floating-point numbers, not {array.dtype}")
    if array.ndim != 2 or min(array.shape) < 2:
        raise ArgumentError(f"heights: expected (H, W), 2 or more of each, found shape {array.shape}")
    steps = np.resize(np.asarray(spacing, np.float64), 2)
    if np.shape(spacing) not in ((), (2,)) or not (np.isfinite(steps).all() and (steps > 0.0).all()):
        raise ArgumentError(f"spacing: expected one or two numbers above 0, not {spacing!r}")
    if not _checks.not_negative(tolerance, "tolerance") > 0.0:
        raise ArgumentError(f"tolerance: must be above 0, not {tolerance}")
    if nodata is not None:
        nodata = _checks.number(nodata, "nodata")
    most = None if max_triangles is None else _checks.whole(max_triangles, "max_triangles", 2)
    fit = _checks.truth(fit, "fit")
    piece = _checks.whole(piece, "piece", 2, _MOST_POSTS)

    rows, columns = array.shape
    parts: list[dict[str, Any]] = []
    lost = 0
    # So that what is stated, rounded up, meets the tolerance.
    aim = float(tolerance) * (1.0 - 1e-9)
    pieces = list(_pieces(rows, columns, piece - 1))
    for number, (top, bottom, left, right) in enumerate(pieces):
        part, roles, alone = _read(array, (top, bottom, left, right), nodata)
        lost += alone
        if not roles.any():
            continue
        room = 2**32 - 1
        if most is not None:
            made_so_far = sum(len(p["triangles"]) for p in parts)
            room = max((most - made_so_far) // (len(pieces) - number), 2)
        made = _core.heightfield(part, roles, tolerance=aim, max_triangles=room, fit=fit)
        made["places"] = made["places"].astype(np.int64)[:, ::-1] + (top, left)
        parts.append(made)
    if not any(len(made["triangles"]) for made in parts):
        raise MeshError("heights: no three posts of a cell have heights")
    return _joined(parts, lost, (rows, columns), steps, float(tolerance))


def _pieces(rows: int, columns: int, step: int) -> Iterator[tuple[int, int, int, int]]:
    """First and last rows and columns of pieces, which share their borders."""
    for top in range(0, rows - 1, step):
        for left in range(0, columns - 1, step):
            yield top, min(top + step, rows - 1), left, min(left + step, columns - 1)


def _read(
    array: NDArray[Any], place: tuple[int, int, int, int], nodata: float | None
) -> tuple[NDArray[np.float64], NDArray[np.uint8], int]:
    """Heights and roles of the posts of a piece, and how many of those that it begins with are in no triangle."""
    top, bottom, left, right = place
    # What lies around decides what the outlines are, so that pieces agree.
    up, before = max(top - 1, 0), max(left - 1, 0)
    around = array[up : bottom + 2, before : right + 2]
    masked = np.ma.getmaskarray(around)
    part = np.array(np.ma.getdata(around), np.float64)
    if nodata is not None:
        masked = masked | (part == nodata)
    part[masked] = np.nan
    if np.isinf(part).any():
        row, column = (int(k) for k in np.argwhere(np.isinf(part))[0])
        raise ArgumentError(f"heights: {part[row, column]} at row {up + row}, column {before + column}")
    there = ~np.isnan(part)
    count = there[:-1, :-1].astype(np.uint8) + there[:-1, 1:] + there[1:, :-1] + there[1:, 1:]
    used, outline = np.zeros_like(there), np.zeros_like(there)
    for y in (0, 1):
        for x in (0, 1):
            of = (slice(y, y + count.shape[0]), slice(x, x + count.shape[1]))
            used[of] |= count >= 3
            outline[of] |= count < 4
    used &= there
    roles = np.where(used, np.where(outline, _OUTLINE, _MEASURED), _NONE).astype(np.uint8)
    own = (
        slice(top - up, top - up + bottom - top + 1),
        slice(left - before, left - before + right - left + 1),
    )
    alone = there[own] & ~used[own]
    # Those at the far borders belong to the next pieces.
    alone = alone[
        : None if bottom + 1 == array.shape[0] else -1, : None if right + 1 == array.shape[1] else -1
    ]
    return np.ascontiguousarray(part[own]), np.ascontiguousarray(roles[own]), int(alone.sum())


def _joined(
    parts: list[dict[str, Any]],
    lost: int,
    shape: tuple[int, int],
    steps: NDArray[np.float64],
    tolerance: float,
) -> HeightfieldMesh:
    """One mesh of pieces, with each post of a border once."""
    rows, columns = shape
    places = np.concatenate([made["places"] for made in parts])
    values = np.concatenate([made["heights"] for made in parts])
    starts = np.cumsum([0] + [len(made["places"]) for made in parts[:-1]])
    faces = np.concatenate(
        [made["triangles"].astype(np.int64) + first for made, first in zip(parts, starts, strict=True)]
    )
    if len(parts) > 1:
        keys = places[:, 0] * columns + places[:, 1]
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        places, values, faces = places[first], values[first], inverse[faces]
    if len(places) >= 2**32:
        raise MeshError("heights: the mesh is too large: more vertices than 32 bits count")
    # Posts of borders are measured in both pieces, with the same result.
    measured = sum(made["measured"] for made in parts)
    error = max(made["error"] for made in parts)
    size = float(np.abs(values).max(initial=0.0))
    # What planes are rounded by when they are compared with posts.
    error = math.nextafter(error + size * 1e-14, math.inf) if error > 0.0 else size * 1e-14
    row, column = places[:, 0], places[:, 1]
    made = HeightfieldMesh(
        vertices=np.column_stack([column * steps[0], (rows - 1 - row) * steps[1], values]),
        faces=faces.astype(np.uint32),
        uvs=np.column_stack([(column + 0.5) / columns, 1.0 - (row + 0.5) / rows]),
        posts=places,
        error=error,
        rms=math.sqrt(sum(made["squares"] for made in parts) / max(measured, 1)),
        measured_posts=measured,
        lost_posts=lost,
    )
    if error > tolerance + size * 2e-14:
        _advice.warn(
            f"heightfield: the error is {error:.4g}, above the tolerance of {tolerance:g}, with {len(made):,} "
            "triangles",
            UsageWarning,
        )
    return made
