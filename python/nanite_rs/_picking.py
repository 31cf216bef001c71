"""Picking: what a pixel of a frame shows, and the error of its cluster as a camera sees it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _core, _paint
from nanite_rs.assembly import Assembly
from nanite_rs.exceptions import ArgumentError, StaleHandleError
from nanite_rs.scene import MeshNode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._frozen import View, ViewFrame
    from nanite_rs.scene import Scene


@dataclass(frozen=True)
class Pick:
    """What a pixel shows; ``print`` it for a table."""

    x: int
    """Column of the pixel."""
    y: int
    """Row of the pixel, 0 on top."""
    instance_id: int
    """`MeshNode.instance_id` of the instance."""
    cluster_id: int
    """Address of the cluster inside its mesh."""
    triangle_id: int
    """Number of the triangle inside its cluster."""
    face_id: int
    """Row of the source ``faces``, or −1 as for `Frame.face_id`; −1 while the cut is frozen."""
    level: int
    """Level of detail of the cluster: times its surface was simplified, 0 for the source; −1 in an assembly, where
    `error` and `pixels` are NaN."""
    group: int
    """Number of the group that the cluster is simplified with; −1 for a root."""
    page: int
    """Number of the page that the cluster lies in."""
    error: float
    """What the rule of the cut compares: how far the cluster is from the source at most, in shape and in what it
    carries, in units of the mesh; 0 at level 0."""
    pixels: float
    """The same in pixels, as this view projects it: a bound for all of the cluster."""
    position: tuple[float, float, float]
    """The point of the surface, in the world."""
    depth: float
    """Its distance along the view axis, world units."""

    def __str__(self) -> str:
        return self.table(self.pixels)

    def table(self, pixels: float) -> str:
        """Return it in four lines.

        Parameters
        ----------
        pixels : float
            What the error is in pixels: `pixels`, or what `Viewer.pixels_now` returns.
        """
        x, y, z = self.position
        return (
            f"instance {self.instance_id}, cluster {self.cluster_id}, triangle {self.triangle_id}\n"
            f"level {self.level}, group {self.group}, page {self.page}\n"
            f"error {self.error:.4g} units = {pixels:.3g} pixels\n"
            f"at ({x:.6g}, {y:.6g}, {z:.6g})"
        )


class ClusterTables:
    """The clusters of meshes by address: each table is made when it is first asked for."""

    def __init__(self) -> None:
        # With what they are of, which is the only one with its id for as long.
        self._tables: dict[int, tuple[_core.Mesh, dict[str, NDArray[Any]]]] = {}

    def of(self, node: MeshNode) -> dict[str, NDArray[Any]]:
        """The table of an instance's mesh."""
        core = node.mesh._core
        if id(core) not in self._tables:
            self._tables[id(core)] = core, _core.cluster_table(core)
        return self._tables[id(core)][1]


def node_of(scene: Scene, instance: int) -> MeshNode:
    """The instance of a number."""
    for at, (mesh, _) in scene._shown.items():
        if at[0] == instance:
            return MeshNode(scene, at, mesh)
    raise StaleHandleError(f"instance {instance} was removed from the scene")


def pixel_at(shown: ViewFrame, x: float, y: float) -> tuple[int, int, float]:
    """Column, row and depth of the pixel at a place; depth 0 where nothing is shown."""
    width, height = shown.view.size
    if not (0 <= x < width and 0 <= y < height):
        raise ArgumentError(f"x, y: ({x}, {y}) lies outside of {width} × {height} pixels")
    column, row = int(x), int(y)
    return column, row, float(shown.frame.depth[row, column])


def point_at(view: View, column: int, row: int, depth: float) -> NDArray[np.float64]:
    """The point in the world that a pixel shows at a depth."""
    width, height = view.size
    per_pixel = 2.0 * math.tan(view.camera.yfov / 2.0) / height
    local = depth * np.array(
        [(column + 0.5 - width / 2.0) * per_pixel, (height / 2.0 - row - 0.5) * per_pixel, -1.0]
    )
    point: NDArray[np.float64] = view.pose[:3, :3] @ local + view.pose[:3, 3]
    return point


def picked(shown: ViewFrame, scene: Scene, tables: ClusterTables, x: float, y: float) -> Pick | None:
    """What the pixel at a place shows; None where nothing is shown."""
    column, row, depth = pixel_at(shown, x, y)
    instance = int(shown.ids.instance[row, column])
    if instance < 0:
        return None
    node = node_of(scene, instance)
    cluster = int(shown.ids.cluster[row, column])
    px, py, pz = (float(c) for c in point_at(shown.view, column, row, depth))
    level, group, error, pixels = -1, -1, math.nan, math.nan
    # Of an assembly no frame tells which of its meshes a pixel shows.
    if not isinstance(node.mesh, Assembly):
        table = tables.of(node)
        at = int(np.searchsorted(table["id"], cluster))
        level, group = int(table["level"][at]), int(table["group"][at])
        error = max(float(table["error"][at]), 0.0)
        pixels = projected(shown.view, node, table["sphere"][at], error)
    return Pick(
        x=column,
        y=row,
        instance_id=instance,
        cluster_id=cluster,
        triangle_id=int(shown.ids.triangle[row, column]),
        face_id=-1 if shown.frozen else int(shown.frame.face_id[row, column]),
        level=level,
        group=group,
        page=cluster >> _paint.PAGE_BITS,
        error=error,
        pixels=pixels,
        position=(px, py, pz),
        depth=depth,
    )


def projected(view: View, node: MeshNode, sphere: NDArray[np.float64], error: float) -> float:
    """An error in units of a mesh, on a sphere, in pixels of a view: the bound of ``src/math/project.rs``."""
    if error <= 0.0:
        return 0.0
    pose, projection = node.pose, view.camera.projection_matrix(*view.size)
    scale = float(np.linalg.svd(pose[:3, :3], compute_uv=False)[0])
    center = pose[:3, :3] @ sphere[:3] + pose[:3, 3]
    x, y, z = (center - view.pose[:3, 3]) @ view.pose[:3, :3]
    moved = error * scale
    radius = sphere[3] * scale + moved
    distance = math.sqrt(x * x + y * y + z * z) - radius
    widest = 1.0 + 1.0 / projection[0, 0] ** 2 + 1.0 / projection[1, 1] ** 2
    depth = -z - radius
    if depth > 0.0:
        widest = min(widest, 1.0 + ((math.hypot(x, y) + radius) / depth) ** 2)
    focal = max(projection[0, 0] * view.size[0], projection[1, 1] * view.size[1]) / 2.0
    return float(moved * focal * widest / max(distance, view.camera.znear))
