"""`Points` and `Lines`: what is drawn as discs and as bands, among meshes and hidden by them."""

from __future__ import annotations

import weakref
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _trimesh
from nanite_rs._arrays import as_array, core_arrays, own_copy
from nanite_rs._core import TriangleMesh as CoreTriangleMesh
from nanite_rs._geometry import Moving
from nanite_rs.exceptions import ArgumentError, DtypeError, MeshError, UsageWarning
from nanite_rs.material import Material, several

if TYPE_CHECKING:
    from collections.abc import Callable

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs.material import Look

__all__ = ["Lines", "Points"]

StrokeUnit: TypeAlias = Literal["pixels", "world"]

_WIDEST = 1e6
"""Nobody wants more pixels, and arithmetic has digits for it."""
_LARGEST = 1e30
"""In units of the world: what float32 can multiply."""


def _size(value: object, name: str, unit: object) -> float:
    """A radius or a width."""
    _checks.choice(unit, "unit", ("pixels", "world"))
    size, most = _checks.number(value, name), _WIDEST if unit == "pixels" else _LARGEST
    if not 0.0 < size <= most:
        raise ArgumentError(f"{name}: must be positive and at most {most:g}, not {size:g}")
    return size


def _rows(colors: ArrayLike | None, count: int) -> NDArray[Any] | None:
    """Colours of all vertices, of those given or of one for all."""
    if colors is None:
        return None
    rows = np.asarray(colors)
    if rows.dtype.kind not in "fiu":
        raise DtypeError(f"colors: expected numbers, not {rows.dtype}")
    if rows.ndim == 1 and rows.dtype == np.int64 and isinstance(colors, tuple | list):
        # Whole numbers of Python: bytes, as uint8 has them.
        if rows.min(initial=0) < 0 or rows.max(initial=0) > 255:
            raise ArgumentError("colors: whole numbers must lie between 0 and 255")
        rows = rows.astype(np.uint8)
    if rows.ndim == 1 and rows.shape[0] in (3, 4):
        rows = np.broadcast_to(rows, (count, len(rows)))
    alpha = rows[:, 3] if rows.ndim == 2 and rows.shape[1] == 4 else rows[:0]
    whole = (
        1.0 if rows.dtype.kind == "f" else float(np.iinfo(rows.dtype).max if rows.dtype.kind in "iu" else 1)
    )
    if (alpha < whole).any():
        _advice.warn("colors: alpha counts for nothing: points and lines are opaque", UsageWarning)
    return own_copy(rows)


class _Strokes(Moving):
    """What points and lines have in common."""

    __slots__ = ("_colors", "_positions", "_size", "_topology", "_unit")

    _topology: CoreTriangleMesh
    _positions: NDArray[np.floating[Any]]
    _colors: NDArray[Any] | None
    _size: float
    _unit: StrokeUnit

    def _make(self, positions: NDArray[Any], faces: NDArray[np.uint32], *, line: bool, radius: float) -> None:
        given = {"normals": None, "colors": self._colors, "uvs": None, "face_materials": None}
        arrays = core_arrays(positions, faces, given, None)
        self._topology = CoreTriangleMesh(arrays, (line, radius, self._unit == "world"))
        self._materials = ()
        self._scenes = weakref.WeakSet()
        self._core = self._topology.shape(positions)
        self._positions = own_copy(positions)

    def update(self, positions: ArrayLike) -> None:
        """Move them: all instances in all scenes show the new places from now on.

        Frames that were rendered before keep theirs.

        Parameters
        ----------
        positions : (N, 3) float32 or float64 array
            New positions, as many as before.

        Raises
        ------
        MeshError
            Not finite, with the row. Nothing moves then.
        ArgumentError, DtypeError
            The array has the wrong shape or dtype.
        """
        rows = _positions(positions)
        if len(rows) != len(self._positions):
            raise ArgumentError(f"positions: expected {len(self._positions)} rows, found {len(rows)}")
        self._move(self._topology.shape(rows))
        self._positions = own_copy(rows)

    @property
    def positions(self) -> NDArray[np.floating[Any]]:
        """Where they are now, (N, 3), read-only; `update` moves them."""
        return self._positions

    @property
    def colors(self) -> NDArray[Any] | None:
        """Colours as they were given, a row for each position."""
        return self._colors

    @property
    def unit(self) -> StrokeUnit:
        """What their size is counted in."""
        return self._unit

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest corner of the positions, and of what a size in the world adds: (2, 3) float64."""
        around = np.array([[-self._reach()], [self._reach()]])
        padded: NDArray[np.float64] = np.array(self._core.bounds) + around
        return padded

    def _outline(self) -> NDArray[np.floating[Any]]:
        around, place = self._reach(), self._positions[0]
        if not around and (self._positions == place).all():
            # One place has no size: something to be framed by.
            around = max(0.01 * float(np.abs(place).max()), 0.5)
        shifts = np.concatenate([np.eye(3), -np.eye(3)]) * around
        if not around:
            return self._positions
        found: NDArray[np.float64] = (self._positions + shifts[:, None]).reshape(-1, 3)
        return found

    def _reach(self) -> float:
        """How far anything reaches beyond its position, where that is in units of the world."""
        return 0.0

    def _default_look(self) -> Look:
        """White for colours to multiply, or black."""
        return Material(base_color=(0.0, 0.0, 0.0) if self._colors is None else (1.0, 1.0, 1.0), unlit=True)

    def _looks(self, material: Look) -> list[dict[str, Any]]:
        """Drawn in their colours, whatever the light, and opaque."""
        return super()._looks(
            [replace(one, unlit=True, alpha_mode="opaque") for one in several(material, "material")[:1]]
        )


def _positions(positions: ArrayLike) -> NDArray[Any]:
    rows = as_array(positions, "positions")
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ArgumentError(f"positions: expected shape (N, 3), found {rows.shape}")
    if not len(rows):
        raise MeshError("positions: there are none")
    if rows.dtype.kind != "f":
        raise DtypeError(f"positions: expected a floating-point dtype, not {rows.dtype}")
    if rows.dtype not in (np.float32, np.float64):
        rows = rows.astype(np.float32)
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise MeshError(f"positions[{row}]: {rows[row].tolist()} is not finite")
    return np.ascontiguousarray(rows)


class Points(_Strokes):
    """Points: discs that face the camera, in the depth of their places, hidden by what is nearer.

    They are drawn in their colours, whatever the light, cast no shadows, and are opaque. A disc covers the pixels
    whose centres lie within its radius, and always the one that its point lies in. ``frame.instance_id`` has their
    instance, ``frame.face_id`` the row of ``positions``, ``frame.depth`` that of the point, and ``frame.normal``
    points to the camera. On the GPU backend the CPU draws them over the device's picture, and shades it.

    Parameters
    ----------
    positions : (N, 3) float32 or float64 array
        Places, in the units of the mesh that an instance's pose maps to the world.
    colors : (N, 3) or (N, 4) array, or one colour, optional
        Linear colours: uint8, uint16, or floating-point from 0 to 1. The base colour of an instance's material
        multiplies them; without either they are black. Alpha counts for nothing.
    radius : float
        Of a disc.
    unit : {"pixels", "world"}
        Whether it is in pixels, at any distance, or in units of the world, whatever the pose scales.

    Raises
    ------
    MeshError
        Not finite (with its row), or none.
    ArgumentError, DtypeError
        An array has the wrong shape, dtype or range, or the radius is not positive.

    Examples
    --------
    >>> cloud = nrs.Points(np.random.default_rng(0).normal(size=(1000, 3)), radius=0.05, unit="world")
    >>> scene = nrs.Scene()
    >>> node = scene.add(cloud)
    >>> with nrs.Renderer(64, 64) as renderer:
    ...     frame = renderer.render(scene, nrs.PerspectiveCamera(yfov=1.0), nrs.look_at((0, 0, 5), (0, 0, 0)))
    >>> bool(frame.face_id.max() < 1000)
    True
    """

    __slots__ = ()
    _ELEMENTS: ClassVar[str] = "points"

    @_advice.teaches(
        point_size="give radius=, half of it",
        size="give radius=",
        otherwise="give Points(positions, colors=colors)",
    )
    def __init__(
        self,
        positions: ArrayLike,
        *,
        colors: ArrayLike | None = None,
        radius: float = 1.5,
        unit: StrokeUnit = "pixels",
    ) -> None:
        rows = _positions(positions)
        self._size, self._unit = _size(radius, "radius", unit), unit
        self._colors = _rows(colors, len(rows))
        faces = np.repeat(np.arange(len(rows), dtype=np.uint32)[:, None], 3, axis=1)
        self._make(rows, faces, line=False, radius=self._size)

    @classmethod
    def from_trimesh(
        cls, cloud: trimesh.PointCloud, *, radius: float = 1.5, unit: StrokeUnit = "pixels"
    ) -> Points:
        """Make them of a `trimesh.PointCloud`, with its colours. ``scene.add(cloud)`` does so, too.

        Parameters
        ----------
        cloud : trimesh.PointCloud
            Of one point or more.
        radius : float
            As for `Points`.
        unit : {"pixels", "world"}
            As for `Points`.

        Examples
        --------
        >>> import trimesh
        >>> len(nrs.Points.from_trimesh(trimesh.PointCloud(np.eye(3))))
        3
        """
        if not hasattr(cloud, "vertices") or hasattr(cloud, "faces") or hasattr(cloud, "entities"):
            raise DtypeError(f"cloud: expected a trimesh.PointCloud, not {_advice.name_of_type(cloud)}")
        part = _trimesh.stroke_of(cloud, "cloud")
        if part is None:
            raise MeshError("cloud: there are no points in it")
        return cls(part.positions, colors=part.colors, radius=radius, unit=unit)

    @property
    def radius(self) -> float:
        """That of the discs."""
        return self._size

    def _reach(self) -> float:
        return self._size if self._unit == "world" else 0.0

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _points, (self._positions, self._colors, self._size, self._unit)

    def __repr__(self) -> str:
        """Sizes."""
        return f"Points({len(self):,} points, radius {self._size:g} {self._unit})"


class Lines(_Strokes):
    """Lines between positions: bands with round ends, in the depth of the segments, hidden by what is nearer.

    They are drawn in their colours, whatever the light, cast no shadows, and are opaque. A band covers the pixels
    whose centres lie within half its width of the segment, on the picture, and is a pixel wide at least. It is as
    if a disc lay at each point of the segment, of which the nearest is seen. ``frame.face_id`` has the row of
    ``segments``. On the GPU backend the CPU draws them over the device's picture, and shades it.

    Parameters
    ----------
    positions : (N, 3) float32 or float64 array
        Vertices, in the units of the mesh that an instance's pose maps to the world.
    segments : (M, 2) array of any integer type, optional
        The two ends of each line, as rows of ``positions``; by default one line through all of them in their order.
    colors : (N, 3) or (N, 4) array, or one colour, optional
        Linear colours of the vertices, blended along the lines: uint8, uint16, or floating-point from 0 to 1. The
        base colour of an instance's material multiplies them; without either they are black. Alpha counts for
        nothing.
    width : float
        Of a band.
    unit : {"pixels", "world"}
        Whether it is in pixels, at any distance, or in units of the world, whatever the pose scales.

    Raises
    ------
    MeshError
        Not finite or out of range (with its row), or none.
    ArgumentError, DtypeError
        An array has the wrong shape, dtype or range, or the width is not positive.

    Examples
    --------
    >>> axes = nrs.Lines(
    ...     [[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 1]],
    ...     [[0, 1], [2, 3], [4, 5]],
    ...     colors=np.repeat(np.eye(3), 2, axis=0),
    ...     width=3.0,
    ... )
    >>> len(axes)
    3
    """

    __slots__ = ("_segments",)
    _ELEMENTS: ClassVar[str] = "lines"
    _segments: NDArray[np.uint32]

    @_advice.teaches(
        **dict.fromkeys(("edges", "indices", "lines"), "give segments="),
        **dict.fromkeys(("line_width", "linewidth", "radius"), "give width="),
        otherwise="give Lines(positions, segments, colors=colors)",
    )
    def __init__(
        self,
        positions: ArrayLike,
        segments: ArrayLike | None = None,
        *,
        colors: ArrayLike | None = None,
        width: float = 1.0,
        unit: StrokeUnit = "pixels",
    ) -> None:
        rows = _positions(positions)
        self._size, self._unit = _size(width, "width", unit), unit
        self._colors = _rows(colors, len(rows))
        self._segments = own_copy(_ends(segments, len(rows)))
        self._make(rows, self._segments[:, [0, 1, 1]], line=True, radius=self._size / 2.0)

    @classmethod
    def from_trimesh(
        cls, path: trimesh.path.Path3D, *, width: float = 1.0, unit: StrokeUnit = "pixels"
    ) -> Lines:
        """Make them of a `trimesh.path.Path3D`, with its colours. ``scene.add(path)`` does so, too.

        Parameters
        ----------
        path : trimesh.path.Path3D
            Of one line or more; curves are what trimesh makes of them.
        width : float
            As for `Lines`.
        unit : {"pixels", "world"}
            As for `Lines`.

        Examples
        --------
        >>> import trimesh
        >>> len(nrs.Lines.from_trimesh(trimesh.load_path([[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]])))
        2
        """
        if not hasattr(path, "entities"):
            raise DtypeError(f"path: expected a trimesh.path.Path3D, not {_advice.name_of_type(path)}")
        part = _trimesh.stroke_of(path, "path")
        if part is None or part.segments is None:
            raise MeshError("path: there are no lines in space in it")
        return cls(part.positions, part.segments, colors=part.colors, width=width, unit=unit)

    @property
    def segments(self) -> NDArray[np.uint32]:
        """The two ends of each line, (M, 2), read-only."""
        return self._segments

    @property
    def width(self) -> float:
        """That of the bands."""
        return self._size

    def _reach(self) -> float:
        return self._size / 2.0 if self._unit == "world" else 0.0

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _lines, (self._positions, self._segments, self._colors, self._size, self._unit)

    def __repr__(self) -> str:
        """Sizes."""
        return f"Lines({len(self):,} lines, width {self._size:g} {self._unit})"


def _ends(segments: ArrayLike | None, count: int) -> NDArray[np.uint32]:
    """The ends of lines, checked."""
    if segments is None:
        if count < 2:
            raise MeshError("positions: a line has two ends, and there is one position")
        return np.stack([np.arange(count - 1), np.arange(1, count)], axis=1).astype(np.uint32)
    rows = np.asarray(segments)
    if rows.ndim != 2 or rows.shape[1] != 2:
        raise ArgumentError(f"segments: expected shape (M, 2), found {rows.shape}")
    if rows.dtype.kind not in "iu":
        raise DtypeError(f"segments: expected an integer dtype, not {rows.dtype}")
    if not len(rows):
        raise MeshError("segments: there are none")
    bad = (rows < 0) | (rows >= count)
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        raise MeshError(f"segments[{row}]: {rows[row].tolist()} refers to none of the {count} positions")
    return rows.astype(np.uint32)


def _points(positions: NDArray[Any], colors: NDArray[Any] | None, radius: float, unit: StrokeUnit) -> Points:
    return Points(positions, colors=colors, radius=radius, unit=unit)


def _lines(
    positions: NDArray[Any],
    segments: NDArray[np.uint32],
    colors: NDArray[Any] | None,
    width: float,
    unit: StrokeUnit,
) -> Lines:
    return Lines(positions, segments, colors=colors, width=width, unit=unit)
