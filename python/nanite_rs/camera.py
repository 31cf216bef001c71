"""Cameras with pyrender's parameters, and poses for them.

A camera has no pose of its own: a 4×4 camera-to-world matrix goes with it when a frame is rendered or a cut is
made. Axes are OpenGL's: the camera looks along its −Z, +Y is up, +X right. Distances are in world units. A
pose that is a rotation but for 0.01 in its numbers, as those of data sets are, becomes the nearest rotation; what
is farther off is refused.

Unlike in pyrender, ``zfar`` is infinite unless given, for all cameras: depth is reversed and infinite, so a far
plane gains no precision and nothing vanishes by default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Camera",
    "IntrinsicsCamera",
    "OrthographicCamera",
    "PerspectiveCamera",
    "look_at",
    "orbit",
    "pose_from_opencv",
]

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


@_advice.teaching
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
    """Width over height of the field of view; ``None`` takes the picture's. Another one stretches the picture, as
    in pyrender. Cameras of files have ``None``, see `load_scene`."""

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


@_advice.teaching
@dataclass(frozen=True)
class IntrinsicsCamera(Camera):
    """A pinhole camera by focal lengths and optical centre in pixels.

    Places are counted from the outer edge of the picture, so that the middle of the first pixel is at 0.5, as in
    pyrender, OpenGL and COLMAP. OpenCV counts from the middle of the first pixel: see `from_opencv`.

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

    skew: float = 0.0
    """How far right a place goes for each unit of tangent down, pixels: K[0, 1]."""
    size: tuple[int, int] | None = None
    """Width and height of its pictures, pixels; a renderer of others refuses it. ``None`` fits any."""

    @classmethod
    def from_opencv(
        cls,
        K: ArrayLike,  # noqa: N803  OpenCV's name
        width: int,
        height: int,
        *,
        znear: float = 0.05,
        zfar: float | None = None,
    ) -> IntrinsicsCamera:
        """Make a camera of OpenCV's matrix of intrinsics, skew included.

        OpenCV has (0, 0) in the middle of the first pixel, and this package at its outer corner: half a pixel is
        added to the optical centre. Of a matrix that has it at the corner (COLMAP, pyrender, most of computer
        graphics), give ``IntrinsicsCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], skew=K[0, 1])``. Distortion is not
        rendered: undistort pictures that you compare with (``cv2.undistort``).

        Parameters
        ----------
        K : (3, 3) array
            ``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]``, pixels.
        width, height : int
            Size of the pictures that it is of, pixels. A `Renderer` of another size refuses it: scale the matrix.
        znear, zfar
            As in `IntrinsicsCamera`.

        Raises
        ------
        ArgumentError, DtypeError
            It is no such matrix, or a size is not positive.

        Warns
        -----
        UsageWarning
            The optical centre is outside of the picture, as happens with a matrix of another size.

        Examples
        --------
        >>> K = [[800.0, 0.0, 639.5], [0.0, 800.0, 359.5], [0.0, 0.0, 1.0]]
        >>> nrs.IntrinsicsCamera.from_opencv(K, 1280, 720).cx
        640.0
        """
        matrix = _checks.numbers(K, (3, 3), "K")
        sides = _checks.whole(width, "width", 1), _checks.whole(height, "height", 1)
        if matrix[2, 2] == 0.0 or not np.allclose(
            [matrix[1, 0], matrix[2, 0], matrix[2, 1]], 0.0, atol=1e-9 * np.abs(matrix).max()
        ):
            transposed = np.allclose(matrix[:2, 2], 0.0) and matrix[2, :2].any()
            advice = "; it is transposed, give K.T" if transposed else ""
            raise ArgumentError(f"K: expected [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]{advice}")
        matrix = matrix / matrix[2, 2]
        centre = matrix[0, 2] + 0.5, matrix[1, 2] + 0.5
        if not all(0.0 <= at <= side for at, side in zip(centre, sides, strict=True)):
            _advice.warn(
                f"K: its optical centre ({matrix[0, 2]:g}, {matrix[1, 2]:g}) is outside of a picture of "
                f"{width} × {height}; a matrix of pictures of another size has to be scaled",
                UsageWarning,
            )
        fx, skew, fy = float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])
        return cls(fx, fy, float(centre[0]), float(centre[1]), znear, zfar, skew, sides)

    def _parameters(self) -> tuple[str, list[float]]:
        numbers = (self.fx, self.fy, self.cx, self.cy, self.skew)
        return "intrinsics", [float(value) for value in numbers]

    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the 4×4 OpenGL projection matrix for a viewport of ``width`` × ``height`` pixels."""
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = 2.0 * self.fx / width, 2.0 * self.fy / height
        matrix[0, 2], matrix[1, 2] = 1.0 - 2.0 * self.cx / width, 2.0 * self.cy / height - 1.0
        matrix[0, 1] = -2.0 * self.skew / width
        return self._depth_rows(matrix)


@_advice.teaching
@dataclass(frozen=True)
class OrthographicCamera(Camera):
    """A camera of parallel rays.

    Both magnifications count as given. (pyrender replaces ``xmag`` by ``ymag`` times the picture's aspect ratio, as
    ``None`` does here.)

    Examples
    --------
    >>> camera = nrs.OrthographicCamera(xmag=1.6, ymag=0.9)
    """

    xmag: float | None
    """Half the width of the view, world units; ``None`` takes the picture's of that height."""
    ymag: float
    """Half the height of the view, world units."""
    znear: float = 0.05
    """Nothing nearer is drawn; positive."""
    zfar: float | None = None
    """Nothing farther is drawn; ``None`` draws everything."""

    def _parameters(self) -> tuple[str, list[float]]:
        return "orthographic", [float(self.ymag), *([] if self.xmag is None else [float(self.xmag)])]

    def projection_matrix(self, width: int, height: int) -> NDArray[np.float64]:
        """Return the 4×4 OpenGL projection matrix for a viewport of ``width`` × ``height`` pixels.

        Without ``zfar`` it is that for a far plane at 100, as in pyrender.
        """
        near, far = self.znear, 100.0 + self.znear if self.zfar is None else self.zfar
        xmag = self.ymag * width / height if self.xmag is None else self.xmag
        return np.array(
            [
                [1.0 / xmag, 0.0, 0.0, 0.0],
                [0.0, 1.0 / self.ymag, 0.0, 0.0],
                [0.0, 0.0, 2.0 / (near - far), (far + near) / (near - far)],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


class HasBounds(Protocol):
    """What knows its box: meshes and scenes of nanite_rs and of trimesh."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest corner: (2, 3)."""


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> NDArray[np.float64]:
    """Return the pose of a camera, or of a light, at ``eye`` that looks at ``target``.

    Parameters
    ----------
    eye : (3,) array
        Where it stands, world units.
    target : (3,) array
        What is in the middle of its picture.
    up : (3,) array
        What is upward in its picture, of any length; not along the line of sight.

    Returns
    -------
    (4, 4) float64 array
        Camera-to-world matrix, OpenGL axes.

    Raises
    ------
    ArgumentError, DtypeError
        An argument is not three finite numbers, `eye` is at `target`, or `up` is along the line of sight.

    Examples
    --------
    >>> nrs.look_at((0, 0, 3), (0, 0, 0))
    array([[1., 0., 0., 0.],
           [0., 1., 0., 0.],
           [0., 0., 1., 3.],
           [0., 0., 0., 1.]])
    """
    place, seen, upward = _three(eye, "eye"), _three(target, "target"), _three(up, "up")
    back = place - seen
    length = float(np.linalg.norm(back))
    if length == 0.0:
        raise ArgumentError("eye: is at target; a camera has to look somewhere")
    back /= length
    right = np.cross(upward, back)
    across = float(np.linalg.norm(right))
    if not across > 1e-9 * float(np.linalg.norm(upward)):
        raise ArgumentError(f"up: {upward.tolist()} is along the line of sight; give another direction")
    right /= across
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, place
    return pose


def pose_from_opencv(
    R: ArrayLike,  # noqa: N803  OpenCV's name
    t: ArrayLike,
) -> NDArray[np.float64]:
    """Return the pose of a camera of OpenCV: camera to world, OpenGL axes.

    OpenCV, and COLMAP, say where a point of the world is as the camera sees it, ``R @ point + t``, with +X right,
    +Y down and +Z forward; `cv2.solvePnP` gives that. This package's poses are the other way round, and look along
    −Z with +Y up.

    Parameters
    ----------
    R : (3, 3) or (3,) array
        The rotation, or a vector along its axis as long as its angle in radians, as ``cv2.Rodrigues`` takes it.
    t : (3,) array
        The translation, also as (3, 1).

    Returns
    -------
    (4, 4) float64 array
        Camera-to-world matrix.

    Raises
    ------
    ArgumentError, DtypeError
        They are of another shape, not finite, or `R` is no rotation.

    Examples
    --------
    >>> nrs.pose_from_opencv(np.eye(3), [0, 0, 5])[:3, 3] + 0.0
    array([ 0.,  0., -5.])
    """
    try:
        shape = np.shape(R)
    except ValueError:
        shape = ()
    if shape in ((3,), (3, 1), (1, 3)):
        rotation = _rodrigues(_checks.numbers(R, shape, "R").ravel())
    else:
        rotation = _checks.numbers(R, (3, 3), "R")
    place = np.zeros(3) + _checks.numbers(t, (3, 1) if np.shape(t) == (3, 1) else (3,), "t").ravel()
    from_world = np.eye(4)
    from_world[:3, :3] = rotation
    try:
        _core.check_pose(from_world)
    except ArgumentError:
        raise _advice.advised(ArgumentError("R: is no rotation"), _advice.for_pose(from_world)) from None
    u, _, vt = np.linalg.svd(rotation)
    turned = (u @ vt).T
    if np.linalg.det(turned) < 0.0:
        raise ArgumentError("R: it mirrors; a rotation has a determinant of 1, not -1")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned @ np.diag([1.0, -1.0, -1.0]), -turned @ place
    return pose


def _rodrigues(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation about an axis by as many radians as it is long."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle > 0.0 else np.zeros(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: NDArray[np.float64] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turned


def orbit(
    around: HasBounds | ArrayLike,
    count: int,
    *,
    yfov: float = np.pi / 4,
    elevation: float = np.pi / 9,
    azimuth: float = 0.0,
    distance: float = 1.0,
    up: ArrayLike = (0.0, 1.0, 0.0),
) -> list[NDArray[np.float64]]:
    """Return poses on a circle about something, all of them looking at its middle: a camera's way around it.

    The circle is gone round once, counter-clockwise as seen from above; the last pose is one step before the
    first, so that an animation repeats without a stop.

    Parameters
    ----------
    around : NaniteMesh, LoadedScene, anything else with ``bounds``, or (2, 3) array
        What to go round: the smallest and the largest corner of its box.
    count : int
        How many poses, 1 or more.
    yfov : float
        Vertical field of view of the camera that will be used, radians.
    elevation : float
        Angle above the horizon, radians, between −π/2 and π/2.
    azimuth : float
        Where to begin, radians. With Y up, 0 is on the side of +Z and π/2 on that of +X.
    distance : float
        At 1 the sphere about the box fits the height of the picture; half of it is twice as near.
    up : (3,) array
        What is upward: the axis of the circle.

    Returns
    -------
    list of (4, 4) float64 arrays
        Camera-to-world matrices, OpenGL axes.

    Raises
    ------
    ArgumentError, DtypeError
        An argument has another type or shape, or is out of range.

    Examples
    --------
    >>> poses = nrs.orbit([[-1, -1, -1], [1, 1, 1]], 4, elevation=0.0)
    >>> [np.rint(2 * pose[:3, 3]).astype(int).tolist() for pose in poses]
    [[0, 0, 9], [9, 0, 0], [0, 0, -9], [-9, 0, 0]]
    """
    box = np.asarray(around.bounds if hasattr(around, "bounds") else around, np.float64)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise ArgumentError(
            "around: expected a mesh, a scene, or the two corners of a box, the smaller first"
        )
    if isinstance(count, bool) or not isinstance(count, int | np.integer):
        raise DtypeError(f"count: expected an integer, not {type(count).__name__}")
    if count < 1:
        raise ArgumentError(f"count: must be 1 or more, not {count}")
    if not 0.0 < yfov < np.pi:
        raise ArgumentError(
            f"yfov: must be between 0 and π, not {yfov}; give degrees as np.radians({yfov:g})"
        )
    if not abs(elevation) < np.pi / 2:
        raise ArgumentError(f"elevation: must be between −π/2 and π/2, not {elevation}; angles are radians")
    if not np.isfinite(azimuth):
        raise ArgumentError(f"azimuth: must be finite, not {azimuth}")
    radius = float(np.linalg.norm(box[1] - box[0])) / 2.0
    away = float(distance) * radius / np.sin(yfov / 2.0)
    if not (away > 0.0 and np.isfinite(away)):
        raise ArgumentError(f"distance: must be positive, and the box more than a point, not {distance}")
    upward = _three(up, "up")
    length = float(np.linalg.norm(upward))
    if length == 0.0:
        raise ArgumentError("up: expected a direction, found zeros")
    upward /= length
    # +Z where that is possible, made upright.
    front = np.array([0.0, 0.0, 1.0]) if abs(upward[2]) < 0.9 else np.array([0.0, -np.sign(upward[2]), 0.0])
    front -= (front @ upward) * upward
    front /= np.linalg.norm(front)
    side = np.cross(upward, front)
    middle = box.mean(axis=0)
    poses = []
    for turn in azimuth + 2.0 * np.pi * np.arange(int(count)) / int(count):
        level = np.cos(turn) * front + np.sin(turn) * side
        direction = np.cos(elevation) * level + np.sin(elevation) * upward
        poses.append(look_at(middle + away * direction, middle, upward))
    return poses


def _three(value: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise DtypeError(f"{name}: expected three numbers, not {value!r}") from None
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected three finite numbers, found {value!r}")
    return array
