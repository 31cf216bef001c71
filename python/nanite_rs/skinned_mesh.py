"""`SkinnedMesh`: a virtual mesh whose vertices follow joints."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _checks
from nanite_rs._arrays import as_array
from nanite_rs._geometry import Geometry, Moving
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._core import Skin as CoreSkin

__all__ = ["SkinnedMesh"]


class SkinnedMesh(Geometry, Moving):
    """A mesh of any size with levels of detail, whose vertices follow joints.

    The weights of the joints are a channel of the mesh, so that building carries them along as it does colours. A
    vertex at x goes to Σ wᵢ Mᵢ x (linear blend skinning). `pose` sets the matrices; cuts and frames then show the
    mesh there, and what they state of their error holds for that pose: it is the error at rest, stretched by the
    joints, and what the weights of the level deviate, times how far the joints move a point apart
    (docs/numerics.md). Frames move those clusters alone that are seen. Making one measures by how much weights
    deviate, which takes about as long as a tenth of the build with a few joints; both take longer with more, as
    with any channels. The CPU moves them on both backends; to a device go the positions and normals of all clusters
    with each pose.

    Stated errors are bounds, and the more joints act on a part, the farther they lie above what is measured: 3 to
    90 times, where many joints bend. So more triangles are drawn and cut than of the mesh at rest. Cuts of a number
    of faces take whole groups, with ``exact=True``, too: up to a quarter fewer. `rest` is what files and exports
    hold.

    Parameters
    ----------
    mesh : NaniteMesh
        The mesh at rest, with its looks.
    channel : str
        Its channel of weights, (N, J): a column for each joint, none below 0. Those of a vertex count relative to
        their sum; a vertex without weights follows the first joint. `joint_weights` makes one of joints and
        weights as glTF has them.

    Raises
    ------
    ArgumentError
        There is no such channel, or it has labels.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
    >>> upper = np.clip(0.5 + vertices[:, 2], 0, 1)
    >>> weights = np.stack([1 - upper, upper], axis=1)
    >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, channels={"weights": weights})
    >>> body = nrs.SkinnedMesh(mesh)
    >>> raised = np.eye(4)
    >>> raised[2, 3] = 3.0
    >>> body.pose([np.eye(4), raised])
    >>> bool(body.cut(error=0.05).vertices[:, 2].max() > 3.9)
    True
    """

    __slots__ = ("_channel", "_matrices", "_rest", "_skin")

    _channel: str
    _matrices: NDArray[np.float64]
    _rest: NaniteMesh
    _skin: CoreSkin

    @_advice.teaches(otherwise="give SkinnedMesh(mesh, channel='weights')")
    def __init__(self, mesh: NaniteMesh, *, channel: str = "weights") -> None:
        if not isinstance(mesh, NaniteMesh):
            raise DtypeError(f"mesh: expected a NaniteMesh, not {type(mesh).__name__}")
        if not isinstance(channel, str):
            raise DtypeError(f"channel: expected a name, not {type(channel).__name__}")
        self._skin = mesh._core.skin(channel)
        self._rest, self._channel = mesh, channel
        self._materials = mesh.materials
        self._matrices = np.tile(np.eye(4), (self._skin.joints, 1, 1))
        self._core = self._posed(self._matrices)
        self._scenes = weakref.WeakSet()

    @staticmethod
    def joint_weights(
        joints: ArrayLike, weights: ArrayLike, *, joint_count: int | None = None
    ) -> NDArray[np.float32]:
        """Make the channel of weights from what glTF and others have: the joints of each vertex and their weights.

        Parameters
        ----------
        joints : (N, K) array of any integer type
            Numbers of the joints that act on each vertex.
        weights : (N, K) floating-point array
            How much each acts; 0 where it does not.
        joint_count : int, optional
            J. By default one more than the largest number.

        Returns
        -------
        (N, J) float32 array
            Rows that add up to 1. Where a row has no weights, its first joint has all.

        Examples
        --------
        >>> nrs.SkinnedMesh.joint_weights([[0, 2], [1, 0]], [[1.0, 3.0], [0.0, 0.0]])
        array([[0.25, 0.  , 0.75],
               [0.  , 1.  , 0.  ]], dtype=float32)
        """
        numbers, parts = np.asarray(joints), _reals(weights, "weights")
        if numbers.ndim != 2 or numbers.dtype.kind not in "iu":
            raise DtypeError(f"joints: expected (N, K) integers, not {numbers.shape} of {numbers.dtype}")
        if parts.shape != numbers.shape:
            raise ArgumentError(f"weights: expected {numbers.shape} as joints are, not {parts.shape}")
        wrong = ~(np.isfinite(parts) & (parts >= 0))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ArgumentError(f"weights: row {row} has {parts[row, column]}, which no joint can have")
        largest = int(numbers.max()) if numbers.size else -1
        count = largest + 1 if joint_count is None else _checks.whole(joint_count, "joint_count", 1)
        outside = (numbers < 0) | (numbers >= count)
        if outside.any():
            row, column = np.argwhere(outside)[0]
            raise ArgumentError(f"joints: row {row} has joint {numbers[row, column]} of {count}")
        parts[parts.sum(axis=1) == 0, 0] = 1.0
        parts /= parts.sum(axis=1, keepdims=True)
        out = np.zeros((len(numbers), count), np.float64)
        np.add.at(out, (np.arange(len(numbers))[:, None], numbers), parts)
        return out.astype(np.float32)

    @property
    def rest(self) -> NaniteMesh:
        """The mesh at rest."""
        return self._rest

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self._skin.joints

    @property
    def matrices(self) -> NDArray[np.float64]:
        """The pose it is in, (J, 4, 4), a copy."""
        return self._matrices.copy()

    def pose(self, matrices: ArrayLike) -> None:
        """Move the joints: all instances in all scenes show the new pose from now on.

        Frames that were rendered before keep theirs.

        Parameters
        ----------
        matrices : (J, 4, 4) array
            For each joint the map from where the mesh is at rest to where the joint takes it, in the mesh's space:
            of glTF the joint's place times its inverse bind matrix. The last row is 0, 0, 0, 1. One that mirrors
            turns faces over; to mirror all, give the pose of the instance that does.

        Raises
        ------
        ArgumentError, DtypeError
            Not finite, or of another shape. The mesh stays as it was.
        """
        given = _reals(matrices, "matrices")
        if given.shape != self._matrices.shape:
            raise ArgumentError(f"matrices: expected {self._matrices.shape}, not {given.shape}")
        if not (given[:, 3] == (0, 0, 0, 1)).all():
            joint = int(np.argwhere((given[:, 3] != (0, 0, 0, 1)).any(axis=1))[0, 0])
            raise ArgumentError(f"matrices: the last row of joint {joint} is not 0, 0, 0, 1")
        self._move(self._posed(given))
        self._matrices = given

    def _posed(self, matrices: NDArray[np.float64]) -> Any:
        return self._skin.posed(np.ascontiguousarray(matrices[:, :3]).reshape(-1, 4))

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _from_parts, (self._rest, self._channel, self._matrices)

    def __repr__(self) -> str:
        """Sizes."""
        return f"SkinnedMesh({len(self):,} faces, {self.joints:,} joints)"


def _reals(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """A float64 copy of real numbers."""
    array = as_array(value, name)
    if array.dtype.kind not in "fiub":
        raise DtypeError(f"{name}: expected real numbers, not {array.dtype}")
    return np.array(array, np.float64)


def _from_parts(mesh: NaniteMesh, channel: str, matrices: NDArray[np.float64]) -> SkinnedMesh:
    skinned = SkinnedMesh(mesh, channel=channel)
    skinned.pose(matrices)
    return skinned
