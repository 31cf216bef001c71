"""A cut that stays while the camera moves on.

Freezing asks each mesh for its cut for the frozen camera (``mesh.cut(camera=…)``, the same rule as the renderer's),
and builds the triangles of that cut into a mesh which stands in for the instance. Drawn at full detail it shows
exactly these triangles from anywhere. Ids of its pixels lead back to the clusters that the cut is made of: the
frame's ``face_id`` is a row of the cut's faces, and each row has its cluster.

What the frozen camera did not see is there nevertheless, since a cut is of the whole surface; `Frozen.seen` tells
both apart. Of a scene only those instances stay that the camera sees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from nanite_rs._geometry import Geometry
from nanite_rs.exceptions import InternalError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from nanite_rs.camera import PerspectiveCamera
    from nanite_rs.cut import Cut
    from nanite_rs.frame import Frame
    from nanite_rs.scene import MeshNode, Scene


_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True)
class Ids:
    """What each pixel of a frame shows, (H, W) each; nothing where `instance` is −1."""

    instance: NDArray[np.int32]
    cluster: NDArray[np.uint32]
    triangle: NDArray[np.int32]


def ids_of(frame: Frame) -> Ids:
    """The ids of a frame as it has them."""
    return Ids(frame.instance_id, frame.cluster_id, frame.triangle_id)


@dataclass(frozen=True)
class View:
    """Where a camera stands, and how large its picture is."""

    camera: PerspectiveCamera
    pose: NDArray[np.float64]
    size: tuple[int, int]


def cut_of(node: MeshNode, view: View, pixel_error: float) -> Cut:
    """The cut of an instance for a camera in the world.

    The same clusters as the renderer's where the instance is moved, turned, mirrored and scaled as a whole. Where
    it is scaled differently along its axes, errors and distances are those of its largest and smallest scale, so
    that the cut is finer.
    """
    linear, place = node.pose[:3, :3], node.pose[:3, 3]
    left, scales, right = np.linalg.svd(linear)
    small, large = scales[-1], scales[0]
    pose = np.eye(4)
    pose[:3, :3] = (left @ right).T @ view.pose[:3, :3]
    pose[:3, 3] = np.linalg.solve(linear, view.pose[:3, 3] - place)
    camera = replace(view.camera, znear=view.camera.znear / small)
    cut: Cut = node.mesh.cut(
        camera=camera, pose=pose, viewport=view.size, pixel_error=pixel_error * small / large
    )
    return cut


def _built(cut: Cut) -> NaniteMesh:
    """All triangles of a cut as a mesh of their own."""
    # This mesh is drawn at full detail, so nobody reads its errors: the fastest measure will do.
    options = BuildOptions(
        error="quadric",
        face_ids=True,
        normal_weight=0.0,
        color_weight=0.0,
        uv_weight=0.0,
        channel_weight=0.0,
    )
    return NaniteMesh.from_arrays(
        cut.vertices,
        cut.faces,
        normals=cut.normals,
        colors=cut.fine_colors,
        uvs=cut.uvs,
        face_materials=cut.face_materials,
        options=options,
        progress=False,
    )


class Frozen:
    """Stands in a scene for the instances that a frame shows, until `thaw`.

    Points, lines and assemblies stay as they are.
    """

    def __init__(self, scene: Scene, frame: Frame, view: View, pixel_error: float) -> None:
        self.view, self.pixel_error = view, pixel_error
        shown = ids_of(frame)
        covered = shown.instance >= 0
        key = (shown.instance[covered].astype(np.int64) << 32) | shown.cluster[covered]
        seen = np.unique(key)
        instances, clusters = seen >> 32, (seen & 0xFFFFFFFF).astype(np.uint32)
        visible = [node for node in scene.instances if node.visible and isinstance(node.mesh, Geometry)]
        known = {node.instance_id: node for node in visible}
        self._nodes = [known[n] for n in np.unique(instances).tolist() if n in known]
        cuts = [cut_of(node, view, pixel_error) for node in self._nodes]
        built = [_built(cut) for cut in cuts]

        # A row for each cluster of each cut, and for each face the row of its cluster.
        counts = [len(cut.cluster_ids) for cut in cuts]
        first = np.concatenate([[0], np.cumsum(counts)[:-1]]) if counts else np.zeros(0, np.int64)
        self.instance = np.repeat([node.instance_id for node in self._nodes], counts).astype(np.int32)
        """Instance that each cluster is of, (C,) int32."""
        self.cluster = _joined([cut.cluster_ids for cut in cuts], np.uint32)
        """Address of each cluster in its mesh, (C,) uint32."""
        self.level = _joined([cut.cluster_levels for cut in cuts], np.uint8)
        """Level of each cluster, (C,) uint8."""
        self.seen = _joined(
            [
                np.isin(cut.cluster_ids, clusters[instances == node.instance_id])
                for node, cut in zip(self._nodes, cuts, strict=True)
            ],
            np.bool_,
        )
        """Whether the frozen camera saw a pixel of each cluster, (C,) bool."""
        faces = [len(cut) for cut in cuts]
        before = np.concatenate([[0], np.cumsum(faces)[:-1]]) if faces else np.zeros(0, np.int64)
        self._row_of_face = _joined(
            [cut.face_clusters + np.int64(k) for cut, k in zip(cuts, first, strict=True)], np.int64
        )
        self._first_face = _joined(
            [cut._first_face[:-1] + np.int64(k) for cut, k in zip(cuts, before, strict=True)], np.int64
        )

        self._hidden = visible
        for node in visible:
            node.visible = False
        self._stand_ins = [
            scene.add(mesh, pose=node.pose, material=node.material)
            for node, mesh in zip(self._nodes, built, strict=True)
        ]
        self._before = np.full(max((node.instance_id for node in self._stand_ins), default=0) + 2, -1)
        for node, start in zip(self._stand_ins, before, strict=True):
            self._before[node.instance_id] = start

    @property
    def triangles(self) -> int:
        """Triangles of the frozen cuts."""
        return len(self._row_of_face)

    def ids(self, frame: Frame) -> tuple[Ids, NDArray[np.int64]]:
        """What a frame of the stand-ins shows of the frozen cut, and the row of each pixel's cluster or −1."""
        # No stand-in has the last number.
        start = self._before[np.minimum(frame.instance_id, len(self._before) - 1)]
        inside = (frame.instance_id >= 0) & (frame.face_id >= 0) & (start >= 0)
        face = (frame.face_id + start)[inside]
        row = self._row_of_face[face]
        shape = frame.instance_id.shape
        rows = np.full(shape, -1, np.int64)
        instance, cluster = np.full(shape, -1, np.int32), np.full(shape, 0xFFFFFFFF, np.uint32)
        triangle = np.full(shape, -1, np.int32)
        rows[inside], instance[inside], cluster[inside] = row, self.instance[row], self.cluster[row]
        triangle[inside] = face - self._first_face[row]
        # Points and lines are themselves.
        live = (frame.instance_id >= 0) & (start < 0)
        for out, own in (
            (instance, frame.instance_id),
            (cluster, frame.cluster_id),
            (triangle, frame.triangle_id),
        ):
            out[live] = own[live]
        return Ids(instance, cluster, triangle), rows

    def thaw(self) -> None:
        """Take the stand-ins away and show the instances again."""
        for node in self._stand_ins:
            node.remove()
        for node in self._hidden:
            node.visible = True
        self._stand_ins, self._hidden = [], []

    def outline(self, far: float) -> NDArray[np.float64]:
        """Edges of what the frozen camera sees up to a distance, (8, 2, 3) in the world."""
        projection = self.view.camera.projection_matrix(*self.view.size)
        x, y = far / projection[0, 0], far / projection[1, 1]
        local = np.array([(-x, -y, -far), (x, -y, -far), (x, y, -far), (-x, y, -far)])
        corners = local @ self.view.pose[:3, :3].T + self.view.pose[:3, 3]
        eye = np.broadcast_to(self.view.pose[:3, 3], corners.shape)
        sides = np.stack([eye, corners], axis=1)
        return np.concatenate([sides, np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])


class ViewFrame:
    """A frame, where it was taken from, and what its pixels show, found when it is needed."""

    def __init__(self, frame: Frame, view: View, state: tuple[Any, ...], frozen: Frozen | None) -> None:
        self.frame, self.view, self.state, self.frozen = frame, view, state, frozen

    @cached_property
    def ids(self) -> Ids:
        """What pixels show of the instances, frozen or not."""
        return ids_of(self.frame) if self.frozen is None else self._of_frozen[0]

    @property
    def rows(self) -> NDArray[np.int64]:
        """Rows of the frozen cut's clusters."""
        return self._of_frozen[1]

    @property
    def cut(self) -> Frozen:
        """The frozen cut, where there is one."""
        if self.frozen is None:
            raise InternalError("viewer: there is no frozen cut")
        return self.frozen

    @cached_property
    def _of_frozen(self) -> tuple[Ids, NDArray[np.int64]]:
        return self.cut.ids(self.frame)


def _joined(parts: Sequence[NDArray[Any]], dtype: type[_T]) -> NDArray[_T]:
    return np.concatenate(parts).astype(dtype, copy=False) if parts else np.zeros(0, dtype)
