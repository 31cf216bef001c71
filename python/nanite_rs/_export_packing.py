"""Smaller glTF: numbers as integers on a grid (KHR_mesh_quantization), and meshoptimizer's codecs for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from nanite_rs import _core
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

Compression = Literal["quantized", "meshopt", "meshopt-khr"]
"""How glTF is made smaller."""

ImageFormat = Literal["jpeg", "png", "webp", "ktx2"]
"""What the images of glTF may be encoded as."""

POSITION_STEPS: Final = 65_534
"""Steps of a quantized position along an axis, at most."""
FLOAT_STEPS: Final = 1 << 24
"""Steps that float32 holds."""

_CODECS: Final = {"meshopt": ("EXT_meshopt_compression", 0), "meshopt-khr": ("KHR_meshopt_compression", 1)}


@dataclass(frozen=True)
class Grid:
    """Whole multiples of a step, in units of the mesh, about an origin that is one itself."""

    origin: NDArray[np.float64]
    step: float

    @classmethod
    def around(cls, vertices: NDArray[np.floating[Any]]) -> Grid:
        """Return the finest grid whose quantized positions reach all of these."""
        size = float((vertices.max(axis=0).astype(np.float64) - vertices.min(axis=0)).max())
        return cls.about(vertices, size / (POSITION_STEPS - 2) if size > 0.0 else 1.0)

    @classmethod
    def about(cls, vertices: NDArray[np.floating[Any]], step: float) -> Grid:
        """Return the grid of a step about the middle of these."""
        low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
        return cls(np.rint((low + high) / 2.0 / step) * step, step)

    @property
    def moved(self) -> float:
        """By how much positions are moved at most, in units of the mesh."""
        return float(np.nextafter(0.5 * 3.0**0.5 * self.step * (1.0 + 1e-9), np.inf))

    @property
    def frame(self) -> NDArray[np.float64]:
        """The pose that takes steps to units of the mesh."""
        out = np.diag([self.step, self.step, self.step, 1.0])
        out[:3, 3] = self.origin
        return out

    def steps(self, vertices: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return positions as steps from the origin. Those that are equal are so on all grids of this step."""
        whole = np.rint(vertices.astype(np.float64) / self.step) - np.rint(self.origin / self.step)
        return whole.astype(np.int64)


@dataclass(frozen=True)
class Packing:
    """How the numbers of a document are stored."""

    kind: Compression

    @classmethod
    def of(cls, compression: object, ending: str) -> Packing | None:
        """Check what was asked for."""
        if compression is None:
            return None
        if compression not in get_args(Compression):
            known = ", ".join(map(repr, get_args(Compression)))
            raise ArgumentError(f"compression: expected None, {known}, not {compression!r}")
        if ending not in ("glb", "gltf"):
            raise ArgumentError(f"compression: glTF has it; .{ending} files have none")
        return cls(compression)  # type: ignore[arg-type]

    @property
    def extension(self) -> str | None:
        """The extension of the codec."""
        return _CODECS[self.kind][0] if self.kind in _CODECS else None

    def rows(self, raw: NDArray[np.uint8]) -> bytes:
        """Encode rows of vertices."""
        return _core.pack_vertices(raw, _CODECS[self.kind][1])

    def normals(self, normals: NDArray[np.float32]) -> tuple[NDArray[np.int8], str | None]:
        """Return normals as integers, and the filter that decodes them."""
        if self.extension is None:
            return np.rint(normals * 127.0).astype(np.int8), None
        return _core.pack_directions(np.ascontiguousarray(normals, np.float32)), "OCTAHEDRAL"


def image_format(images: object, ending: str) -> ImageFormat | None:
    """Check what images are to be encoded as."""
    if images is None:
        return None
    if images not in get_args(ImageFormat):
        known = ", ".join(map(repr, get_args(ImageFormat)))
        raise ArgumentError(f"images: expected None, {known}, not {images!r}")
    if ending not in ("glb", "gltf"):
        raise ArgumentError(f"images: for glTF; .{ending} files have them as they are")
    return images  # type: ignore[return-value]


def texture_coordinates(rows: NDArray[np.float32]) -> NDArray[Any]:
    """Return UVs as integers where all lie between 0 and 1, else as they are."""
    if rows.min(initial=0.0) < 0.0 or rows.max(initial=0.0) > 1.0:
        return rows
    return np.rint(rows.astype(np.float64) * 65_535.0).astype(np.uint16)
