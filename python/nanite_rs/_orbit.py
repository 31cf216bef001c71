"""The orbit camera of a viewer: it looks at a point and turns about it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from nanite_rs._preview import UP, posed
from nanite_rs.camera import PerspectiveCamera

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NEAREST: Final = 1e-3
"""Distance of the near plane, of that of the pivot."""


@dataclass
class Orbit:
    """A camera that looks at a point and turns about it; assign to its fields to move it.

    Examples
    --------
    >>> orbit = nrs.viewer.Orbit(pivot=np.zeros(3), distance=2.0, azimuth=0.0, elevation=0.0)
    >>> orbit.pose[:3, 3]
    array([0., 0., 2.])
    >>> orbit.turn(np.pi / 2, 0.0)
    >>> orbit.pose[:3, 3].round(9) + 0.0
    array([2., 0., 0.])
    """

    pivot: NDArray[np.float64]
    """The point in the middle of the picture, (3,) float64 in the world."""
    distance: float
    """From the pivot to the camera, world units."""
    azimuth: float
    """Radians around the axis that points up; at 0 the camera stands on the positive Z axis, or, with Z up, on
    the negative Y axis."""
    elevation: float
    """Radians above the horizon, −π/2 to π/2."""
    yfov: float = math.radians(45.0)
    """Vertical field of view, radians."""
    up: str = "y"
    """Which axis of the world points up, ``"y"`` or ``"z"``."""

    @property
    def axes(self) -> NDArray[np.float64]:
        """Right, up and back of the camera as columns, (3, 3) float64."""
        (ca, sa), (ce, se) = ((math.cos(a), math.sin(a)) for a in (self.azimuth, self.elevation))
        local = np.array([[ca, -sa * se, sa * ce], [0.0, ce, se], [-sa, -ca * se, ca * ce]])
        axes: NDArray[np.float64] = UP[self.up] @ local
        return axes

    @property
    def pose(self) -> NDArray[np.float64]:
        """Camera-to-world matrix, (4, 4) float64."""
        axes = self.axes
        return posed(axes, self.pivot + axes[:, 2] * self.distance)

    @property
    def camera(self) -> PerspectiveCamera:
        """The camera, with a near plane that follows the distance."""
        return PerspectiveCamera(yfov=self.yfov, znear=self.distance * _NEAREST)

    def turn(self, right: float, upward: float) -> None:
        """Move the camera around the pivot.

        Parameters
        ----------
        right, upward : float
            Radians around the axis that points up, and above the horizon, where it ends at the poles.
        """
        self.azimuth = (self.azimuth + right + math.pi) % (2.0 * math.pi) - math.pi
        self.elevation = min(max(self.elevation + upward, -math.pi / 2), math.pi / 2)

    def pan(self, right: float, upward: float) -> None:
        """Move camera and pivot sideways.

        Parameters
        ----------
        right, upward : float
            As parts of the height of the picture: with 1 the pivot moves by what is seen from bottom to top.
        """
        height = 2.0 * self.distance * math.tan(self.yfov / 2.0)
        axes = self.axes
        self.pivot = self.pivot + height * (right * axes[:, 0] + upward * axes[:, 1])

    def zoom(self, factor: float) -> None:
        """Move the camera towards the pivot.

        Parameters
        ----------
        factor : float
            What the distance is divided by.
        """
        self.distance = min(max(self.distance / factor, 1e-30), 1e30)
