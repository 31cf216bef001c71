"""`heightfield`: terrain as a mesh with few triangles, within a tolerance of all posts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs.exceptions import ArgumentError, DtypeError, MeshError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

__all__ = ["HeightfieldMesh", "heightfield"]

# Rows and columns of posts, their heights, and triangles of them.
Part: TypeAlias = "tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint32]]"

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
    ground = Ground(
        heights,
        spacing=spacing,
        tolerance=tolerance,
        nodata=nodata,
        max_triangles=max_triangles,
        fit=fit,
        piece=piece,
    )
    return _joined(ground, list(ground.parts()))


class Ground:
    """Heights and how to triangulate them, piece by piece; what was found is known after the last one."""

    def __init__(
        self,
        heights: ArrayLike,
        *,
        spacing: float | tuple[float, float],
        tolerance: float,
        nodata: float | None,
        max_triangles: int | None,
        fit: bool,
        piece: int,
    ) -> None:
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
        self._array, self._steps, self._tolerance = array, steps, float(tolerance)
        self._nodata = None if nodata is None else _checks.number(nodata, "nodata")
        self._most = None if max_triangles is None else _checks.whole(max_triangles, "max_triangles", 2)
        self._fit = _checks.truth(fit, "fit")
        self._side = _checks.whole(piece, "piece", 2, _MOST_POSTS)
        self.lost, self.measured, self.triangles = 0, 0, 0
        self._off, self._squares, self._size = 0.0, 0.0, 0.0

    @property
    def columns(self) -> int:
        """Posts of a row."""
        return int(self._array.shape[1])

    @property
    def error(self) -> float:
        """The largest vertical distance of a post so far, rounded up."""
        # What planes are rounded by when they are compared with posts.
        rounding = self._size * 1e-14
        return math.nextafter(self._off + rounding, math.inf) if self._off > 0.0 else rounding

    @property
    def rms(self) -> float:
        """Root mean square of these distances."""
        return math.sqrt(self._squares / max(self.measured, 1))

    def parts(self) -> Iterator[Part]:
        """Triangulate all pieces that have posts; then raise or warn where there are none, or they are too far."""
        # So that what is stated, rounded up, meets the tolerance.
        aim = self._tolerance * (1.0 - 1e-9)
        rows, columns = self._array.shape
        pieces = list(_pieces(rows, columns, self._side - 1))
        for number, place in enumerate(pieces):
            part, roles, alone = _read(self._array, place, self._nodata)
            self.lost += alone
            if not roles.any():
                continue
            room = 2**32 - 1
            if self._most is not None:
                room = max((self._most - self.triangles) // (len(pieces) - number), 2)
            made = _core.heightfield(part, roles, tolerance=aim, max_triangles=room, fit=self._fit)
            # Posts of borders are measured in both pieces, with the same result.
            self.measured += made["measured"]
            self.triangles += len(made["triangles"])
            self._off, self._squares = max(self._off, made["error"]), self._squares + made["squares"]
            self._size = max(self._size, float(np.abs(made["heights"]).max(initial=0.0)))
            posts = made["places"].astype(np.int64)[:, ::-1] + (place[0], place[2])
            yield posts, made["heights"], made["triangles"]
        if not self.triangles:
            raise MeshError("heights: no three posts of a cell have heights")
        if self.error > self._tolerance + self._size * 2e-14:
            _advice.warn(
                f"heightfield: the error is {self.error:.4g}, above the tolerance of {self._tolerance:g}, with "
                f"{self.triangles:,} triangles",
                UsageWarning,
            )

    def placed(
        self, posts: NDArray[np.int64], values: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and texture coordinates of vertices, which depend on each alone."""
        rows, columns = self._array.shape
        row, column = posts[:, 0], posts[:, 1]
        return (
            np.column_stack([column * self._steps[0], (rows - 1 - row) * self._steps[1], values]),
            np.column_stack([(column + 0.5) / columns, 1.0 - (row + 0.5) / rows]),
        )


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


def _joined(ground: Ground, parts: list[Part]) -> HeightfieldMesh:
    """One mesh of pieces, with each post of a border once."""
    posts = np.concatenate([part[0] for part in parts])
    values = np.concatenate([part[1] for part in parts])
    starts = np.cumsum([0] + [len(part[0]) for part in parts[:-1]])
    faces = np.concatenate(
        [part[2].astype(np.int64) + first for part, first in zip(parts, starts, strict=True)]
    )
    if len(parts) > 1:
        keys = posts[:, 0] * ground.columns + posts[:, 1]
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        posts, values, faces = posts[first], values[first], inverse[faces]
    if len(posts) >= 2**32:
        raise MeshError("heights: the mesh is too large: more vertices than 32 bits count")
    vertices, uvs = ground.placed(posts, values)
    return HeightfieldMesh(
        vertices=vertices,
        faces=faces.astype(np.uint32),
        uvs=uvs,
        posts=posts,
        error=ground.error,
        rms=ground.rms,
        measured_posts=ground.measured,
        lost_posts=ground.lost,
    )
