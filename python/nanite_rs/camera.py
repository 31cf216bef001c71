"""Cameras with pyrender's parameters.

A camera has no pose of its own: a 4×4 camera-to-world matrix goes with it when a frame is rendered or a cut is
made. Axes are OpenGL's: the camera looks along its −Z, +Y is up, +X right. Distances are in world units.

Unlike in pyrender, ``zfar`` is infinite unless given, for all cameras: depth is reversed and infinite, so a far
plane gains no precision and nothing vanishes by default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from nanite_rs import _advice, _core
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Camera", "IntrinsicsCamera", "OrthographicCamera", "PerspectiveCamera"]

Spec: TypeAlias = tuple[str, list[float], float, float | None]


class Camera(ABC):
    """Base of the cameras. Immutable; parameters are checked when made.

    Raises
    ------
    ArgumentError
        For a parameter out of range; the message begins with its name.
    """

    znear: float
    zfar: float | None

    def __post_init__(self) -> None:
        try:
            _core.check_camera(self._spec())
        except ArgumentError as error:
            degrees = str(error).startswith("yfov") and vars(self)["yfov"] > np.pi
            more = f"give degrees as np.radians({vars(self)['yfov']:g})" if degrees else ""
            raise _advice.advised(error, more) from None

    @abstractmethod
    def _parameters(self) -> tuple[str, list[float]]:
        """Kind and parameters."""

    def _spec(self) -> Spec:
        kind, parameters = self._parameters()
        return kind, parameters, float(self.znear), None if self.zfar is None else float(self.zfar)

    @abstractmethod
    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the 4×4 OpenGL projection matrix for ``width`` × ``height`` pixels, as pyrender does."""

    def _depth_rows(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fill in the rows of a pinhole that make depth."""
        near, far = self.znear, self.zfar
        matrix[3, 2] = -1.0
        if far is None:
            matrix[2, 2], matrix[2, 3] = -1.0, -2.0 * near
        else:
            matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2.0 * far * near / (near - far)
        return matrix


@dataclass(frozen=True)
class PerspectiveCamera(Camera):
    """A pinhole camera by its field of view.

    Examples
    --------
    >>> camera = nrs.PerspectiveCamera(yfov=0.8)
    >>> camera.projection_matrix(1280, 720).shape
    (4, 4)
    """

    yfov: float
    """Vertical field of view, radians, between 0 and π."""
    znear: float = 0.05
    """Nothing nearer is drawn; positive."""
    zfar: float | None = None
    """Nothing farther is drawn; ``None`` draws everything."""
    aspectRatio: float | None = None  # noqa: N815  pyrender's and glTF's name
    """Width over height of the field of view; ``None`` takes the picture's."""

    def _parameters(self) -> tuple[str, list[float]]:
        aspect = [] if self.aspectRatio is None else [float(self.aspectRatio)]
        return "perspective", [float(self.yfov), *aspect]

    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the 4×4 OpenGL projection matrix for a viewport of ``width`` × ``height`` pixels."""
        aspect = width / height if self.aspectRatio is None else self.aspectRatio
        matrix = np.zeros((4, 4))
        matrix[1, 1] = 1.0 / np.tan(self.yfov / 2.0)
        matrix[0, 0] = matrix[1, 1] / aspect
        return self._depth_rows(matrix)


@dataclass(frozen=True)
class IntrinsicsCamera(Camera):
    """A pinhole camera by focal lengths and optical centre in pixels.

    Examples
    --------
    >>> camera = nrs.IntrinsicsCamera(fx=800.0, fy=800.0, cx=640.0, cy=360.0)
    >>> float(camera.projection_matrix(1280, 720)[0, 2])
    0.0
    """

    fx: float
    """Focal length along x, pixels."""
    fy: float
    """Focal length along y, pixels."""
    cx: float
    """Optical centre, pixels from the left edge of the picture; half its width is the middle."""
    cy: float
    """Optical centre, pixels from the upper edge of the picture."""
    znear: float = 0.05
    """Nothing nearer is drawn; positive."""
    zfar: float | None = None
    """Nothing farther is drawn; ``None`` draws everything."""

    def _parameters(self) -> tuple[str, list[float]]:
        return "intrinsics", [float(self.fx), float(self.fy), float(self.cx), float(self.cy)]

    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the 4×4 OpenGL projection matrix for a viewport of ``width`` × ``height`` pixels."""
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = 2.0 * self.fx / width, 2.0 * self.fy / height
        matrix[0, 2], matrix[1, 2] = 1.0 - 2.0 * self.cx / width, 2.0 * self.cy / height - 1.0
        return self._depth_rows(matrix)


@dataclass(frozen=True)
class OrthographicCamera(Camera):
    """A camera of parallel rays.

    Both magnifications count as given. (pyrender replaces ``xmag`` by ``ymag`` times the picture's aspect ratio.)

    Examples
    --------
    >>> camera = nrs.OrthographicCamera(xmag=1.6, ymag=0.9)
    """

    xmag: float
    """Half the width of the view, world units."""
    ymag: float
    """Half the height of the view, world units."""
    znear: float = 0.05
    """Nothing nearer is drawn; positive."""
    zfar: float | None = None
    """Nothing farther is drawn; ``None`` draws everything."""

    def _parameters(self) -> tuple[str, list[float]]:
        return "orthographic", [float(self.xmag), float(self.ymag)]

    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:  # noqa: ARG002
        """Return the 4×4 OpenGL projection matrix, whatever ``width`` and ``height``.

        Without ``zfar`` it is that for a far plane at 100, as in pyrender.
        """
        near, far = self.znear, 100.0 + self.znear if self.zfar is None else self.zfar
        return np.array(
            [
                [1.0 / self.xmag, 0.0, 0.0, 0.0],
                [0.0, 1.0 / self.ymag, 0.0, 0.0],
                [0.0, 0.0, 2.0 / (near - far), (far + near) / (near - far)],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
