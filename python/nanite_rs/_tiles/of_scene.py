"""The tiles of a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _core, _export_scene
from nanite_rs._asset import Notes
from nanite_rs._progress import reporter
from nanite_rs._tiles import write
from nanite_rs._tiles.place import TURN, Upright
from nanite_rs._tiles.target import CONTENT, opened
from nanite_rs.exceptions import ArgumentError
from nanite_rs.material import several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.strokes import Lines, Points
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from numpy.typing import NDArray

    from nanite_rs._progress import Progress
    from nanite_rs.assembly import Placed
    from nanite_rs.cut import Cut
    from nanite_rs.report import TilesReport
    from nanite_rs.scene import Scene


def export(
    scene: Scene,
    folder: object,
    how: write.How,
    up: object,
    options: Mapping[str, Any] | None,
    overwrite: bool,
    progress: Progress,
) -> TilesReport:
    """Write the tiles of what a scene shows: those of a mesh once, for all of its instances."""
    notes = Notes()
    _export_scene.unwritten(scene, notes)
    if any(light.visible for light in scene.lights):
        notes.add("lights")
    shown = []
    for node in _export_scene.all_placed(node for node in scene.instances if node.visible):
        if isinstance(node.mesh, Points | Lines):
            notes.add("points and lines")
        else:
            shown.append(node)
    if not shown:
        raise ArgumentError("to_3dtiles: the scene shows no mesh")
    place = Upright("y" if up is None else up)
    # What a pose does before axes are turned, it does after.
    turn = TURN if up in (None, "y") else np.eye(4)
    with opened(folder, options, overwrite) as target, reporter(progress, "tiling") as report:
        made: dict[Hashable, tuple[write.Made, write.Node]] = {}
        json = write.Json(target, regions=False)
        rows, corners = [], []
        largest = 0.0
        for node in shown:
            look = several(node.material, "material")
            key = id(node.mesh), look
            if key not in made:
                writing = write.Writing(
                    _core_of(node), look, place, how, target, f"{CONTENT}/{len(made)}/", notes
                )
                own = writing.run(report)
                made[key] = own, write.whole(own.roots)
            root = made[key][1]
            pose = turn @ node.pose @ turn.T
            rows.append(json.row(root, pose))
            corners.append(_corners(root) @ pose[:3, :3].T + pose[:3, 3])
            largest = max(largest, root.geometric_error * float(np.linalg.norm(pose[:3, :3], 2)))
        points = np.concatenate(corners)
        around = write.Node(
            0, np.zeros(3), largest, 0.0, 0.0, lower=points.min(axis=0), upper=points.max(axis=0)
        )
        around.geometric_error = largest
        row = {
            "boundingVolume": json.volume(around),
            "geometricError": largest,
            "refine": "REPLACE",
            "children": rows,
        }
        json.write(row, write.size_of(around))
        write.show(target, how)
        found = write.report(target, [own for own, _ in made.values()])
    notes.warn(found.path)
    return found


def _core_of(node: Placed) -> _core.Mesh:
    """Return the levels of a mesh; one without any gets some, and one that joints move those of its pose."""
    mesh = node.mesh
    if isinstance(mesh, NaniteMesh):
        core: _core.Mesh = mesh._core
        return core
    if isinstance(mesh, TriangleMesh):
        return _export_scene.with_levels(mesh)._core
    cut: Cut = mesh.cut(error=0.0)
    return NaniteMesh.from_arrays(
        cut.vertices,
        cut.faces,
        normals=cut.normals,
        colors=cut.fine_colors,
        uvs=cut.uvs or None,
        channels=cut._vertex_channels,
        face_materials=cut.face_materials,
        face_channels=dict(cut.face_channels),
        progress=False,
    )._core


def _corners(node: write.Node) -> NDArray[np.float64]:
    if node.lower is None or node.upper is None:
        return np.zeros((1, 3))
    ends = np.stack([node.lower, node.upper])
    grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    return np.take_along_axis(ends, grid, axis=0)
