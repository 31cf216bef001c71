"""Where tiles are: axes turned so that z points up, and coordinate reference systems on the globe."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

Up = Literal["y", "z"]

# glTF has y up, tiles z: viewers turn what glTF holds.
TURN: Final = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
# How much a map of the globe may stretch more than where it was looked at.
_MARGIN: Final = 1.001
# Least radius of curvature of the globe, in metres, and of what is up to 60 km above or below it.
_RADIUS: Final = 6.27e6


class Place(Protocol):
    """What takes a mesh to the space of its tiles."""

    def applied(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return positions, point by point, and normals there."""

    def stretch(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> float:
        """Return by how much lengths in a box grow at most."""

    def bent(self, vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> float:
        """Return how far straight triangles, where they are applied, are from what they would be."""

    def geodetic(self, vertices: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return longitudes and latitudes in radians, and heights, where there are any."""


class Upright:
    """A space of its own."""

    def __init__(self, up: object) -> None:
        if up not in ("y", "z"):
            raise ArgumentError(f"up: expected 'y' or 'z', not {up!r}")
        self._turn = TURN[:3, :3] if up == "y" else None

    def applied(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return what is up as z."""
        if self._turn is None:
            return vertices, normals
        # By columns, so that nothing is rounded.
        signs = np.array([1.0, -1.0, 1.0], np.float32)
        return vertices[:, [0, 2, 1]] * signs, normals[:, [0, 2, 1]] * signs

    def stretch(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> float:  # noqa: ARG002
        """Return 1."""
        return 1.0

    def bent(self, vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> float:  # noqa: ARG002
        """Return 0."""
        return 0.0

    def geodetic(self, vertices: NDArray[np.float64]) -> None:
        """Return nothing."""


class Globe:
    """Earth-centred coordinates (EPSG:4978) of a projected reference system, by pyproj."""

    def __init__(self, crs: object) -> None:
        try:
            import pyproj
        except ImportError as error:
            raise _advice.missing("crs", "pyproj") from error
        try:
            self._crs = pyproj.CRS.from_user_input(crs)
        except pyproj.exceptions.CRSError as error:
            raise ArgumentError(f"crs: {error}") from None
        if not (self._crs.is_projected or self._crs.is_geocentric):
            raise ArgumentError(
                f"crs: {self._crs.name} has angles; errors need lengths: give a projected or geocentric system"
            )
        self._pyproj = pyproj
        # Transformers belong to a thread.
        self._local = threading.local()

    def _transformers(self) -> tuple[Any, Any]:
        if not hasattr(self._local, "pair"):
            make = self._pyproj.Transformer.from_crs
            crs = self._crs if len(self._crs.axis_info) > 2 else self._crs.to_3d()
            self._local.pair = (
                make(crs, "EPSG:4978", always_xy=True),
                make("EPSG:4978", "EPSG:4979", always_xy=True),
            )
        pair: tuple[Any, Any] = self._local.pair
        return pair

    def _there(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.stack(self._transformers()[0].transform(*vertices.T), axis=1)
        if not np.isfinite(out).all():
            row = int(np.argmin(np.isfinite(out).all(axis=1)))
            point = ", ".join(f"{x:g}" for x in vertices[row])
            raise ArgumentError(f"crs: {self._crs.name} has no point ({point})")
        return out

    def _slopes(self, points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
        """Return the derivatives at points: (N, 3, 3), a column for each axis."""
        around = [
            (self._there(points + step * axis) - self._there(points - step * axis)) / (2.0 * step)
            for axis in np.eye(3)
        ]
        return np.stack(around, axis=2)

    def applied(
        self, vertices: NDArray[np.float64], normals: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return positions on the globe; normals turn as the map does in the middle."""
        middle = (vertices.min(axis=0) + vertices.max(axis=0))[None] / 2.0
        across = np.linalg.inv(self._slopes(middle, 1.0)[0])
        turned = normals.astype(np.float64) @ across
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        units = (turned / np.where(length > 0.0, length, 1.0)).astype(np.float32)
        return self._there(vertices), units

    def stretch(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> float:
        """Return by how much lengths in a box grow at most."""
        parts = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 3)] * 3), axis=-1).reshape(-1, 3)
        slopes = self._slopes(lower + parts * (upper - lower), 1.0)
        return float(np.linalg.svd(slopes, compute_uv=False).max()) * _MARGIN

    def bent(self, vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> float:
        """Return how far straight triangles are from curved ones, and those of the source from these."""
        corners = vertices[faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        return float(2.0 * longest**2 / (6.0 * _RADIUS))

    def geodetic(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return longitudes and latitudes in radians, and heights."""
        longitude, latitude, height = self._transformers()[1].transform(*vertices.T)
        return np.stack([np.radians(longitude), np.radians(latitude), height], axis=1)
