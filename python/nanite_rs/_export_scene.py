"""Scenes as files of other formats: nodes, meshes, looks and lights as GLB and glTF, one surface as others."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _colors, _export
from nanite_rs._asset import Asset, Notes, Part, Source
from nanite_rs._export_packing import Packing
from nanite_rs._export_parts import Arrays, Document
from nanite_rs._flatten import flattened
from nanite_rs.assembly import Placed, placed
from nanite_rs.exceptions import ArgumentError
from nanite_rs.material import several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.strokes import Lines, Points
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable

    from numpy.typing import NDArray

    from nanite_rs._geometry import Shape
    from nanite_rs.cut import Cut
    from nanite_rs.material import Material
    from nanite_rs.scene import MeshNode, Scene

# Cosine between axes of a pose up to which these count as being at right angles.
_SKEW: Final = 1e-6
# Part of the size of a scene that float32 may round.
_DIGITS: Final = 1e-6


def export(
    scene: Scene, path: str, error: float | None, reduction: float | None, compression: object
) -> None:
    """Write what is visible of a scene; what the format cannot hold is named in a warning."""
    if error is not None and reduction is not None:
        raise ArgumentError("export: expected error or target_reduction, found both")
    ending = _export.ending_of(path)
    packing = Packing.of(compression, ending)
    shown = [node for node in scene.instances if node.visible]
    if not shown:
        raise ArgumentError("export: the scene shows no mesh")
    parts = all_placed(shown)
    notes = Notes()
    unwritten(scene, notes)
    cuts = _Cuts(error, reduction)
    if ending in _export.DOCUMENTS:
        document = _export.DOCUMENTS[ending](notes, path, packing)
        _fill(document, scene, parts, cuts, notes)
        files = document.files()
    else:
        files = _export.files_of(_joined(path, parts, cuts, notes), path, notes)
        if any(light.visible for light in scene.lights):
            notes.add("lights")
    _export.write(files)
    notes.warn(path)


def all_placed(nodes: Iterable[MeshNode]) -> list[Placed]:
    """What instances show, assemblies part by part, each with a name of its own."""
    out = []
    for node in nodes:
        parts = list(placed(node.mesh, node.pose, node.material, node.instance_id))
        for number, part in enumerate(parts):
            behind = f"_{number}" if len(parts) > 1 else ""
            out.append(replace(part, name=f"instance_{node.instance_id}{behind}"))
    return out


def unwritten(scene: Scene, notes: Notes) -> None:
    """Note what no format has."""
    if any(scene.ambient_light):
        notes.add("ambient light")
    if scene.environment is not None:
        notes.add("the environment")
    if len(scene.instances) > sum(node.visible for node in scene.instances):
        notes.add("what is hidden")


class _Cuts:
    """The cuts of meshes; each is made once."""

    def __init__(self, error: float | None, reduction: float | None) -> None:
        self._error, self._reduction = error, reduction
        self._known: dict[Hashable, tuple[Shape, Cut]] = {}

    def of(self, node: Placed) -> Cut:
        """Return the cut of an instance; errors are in units of the world."""
        mesh, error = node.mesh, 0.0
        if isinstance(mesh, TriangleMesh):
            key: Hashable = id(mesh)
        elif self._reduction is None:
            if self._error is not None:
                error = self._error / max(
                    float(np.linalg.svd(node.pose[:3, :3], compute_uv=False)[0]), 1e-300
                )
            key = id(mesh), error
        else:
            key = id(mesh), None
        if key not in self._known:
            self._known[key] = mesh, self._made(mesh, error)
        return self._known[key][1]

    def _made(self, mesh: Any, error: float) -> Cut:
        if isinstance(mesh, TriangleMesh):
            # It has no levels of its own, and one here.
            return with_levels(mesh).cut(error=0.0)
        if self._reduction is None:
            made: Cut = mesh.cut(error=error)
            return made
        reduced: Cut = mesh.cut(target_reduction=self._reduction)
        return reduced


def with_levels(mesh: TriangleMesh) -> NaniteMesh:
    """Return an ordinary mesh as one with levels of detail."""
    _, (vertices, faces, arrays) = mesh._parts()
    return NaniteMesh.from_arrays(vertices, faces, **arrays, progress=False)


# -------------------------------------------------------------------------------------------------- nodes


def _fill(document: Document, scene: Scene, shown: list[Placed], cuts: _Cuts, notes: Notes) -> None:
    """Add what is visible to a document."""
    known: dict[Hashable, int] = {}
    for node in shown:
        mesh, pose = node.mesh, node.pose
        look = several(node.material, "material")
        if isinstance(mesh, Points | Lines):
            key: Hashable = id(mesh), look
            if key not in known:
                known[key] = _strokes(document, mesh, look[0], notes)
        else:
            cut, turn = cuts.of(node), np.eye(3)
            if _is_skewed(pose):
                # A node has no such pose.
                turn, pose = pose[:3, :3].copy(), pose.copy()
                pose[:3, :3] = np.eye(3)
            key = id(cut), look, turn.tobytes()
            if key not in known:
                known[key] = document.mesh(_turned(Arrays.of(cut, look), turn))
        document.place(known[key], pose, node.name)
    for light in scene.lights:
        if light.visible:
            document.shine(light.light, light.pose)


def _strokes(document: Document, mesh: Points | Lines, look: Material, notes: Notes) -> int:
    notes.add("sizes of points and lines")
    segments = mesh.segments if isinstance(mesh, Lines) else None
    shown = replace(look, unlit=True, alpha_mode="opaque")
    colors = None if mesh.colors is None else _colors.rgba(mesh.colors)
    return document.strokes(mesh.positions, segments, colors, shown)


def _is_skewed(pose: NDArray[np.float64]) -> bool:
    """Whether axes that were at right angles are not in the world."""
    axes = pose[:3, :3] / np.maximum(np.linalg.norm(pose[:3, :3], axis=0), 1e-300)
    return bool(np.abs(axes.T @ axes - np.eye(3)).max() > _SKEW)


def _turned(surface: Arrays, turn: NDArray[np.float64]) -> Arrays:
    """Return a surface as this map leaves it."""
    if np.array_equal(turn, np.eye(3)):
        return surface
    across = np.stack([np.cross(turn[(k + 1) % 3], turn[(k + 2) % 3]) for k in range(3)])
    mirrored = np.linalg.det(turn) < 0.0
    normals = surface.normals @ (across.T * (-1.0 if mirrored else 1.0))
    return replace(
        surface,
        vertices=surface.vertices.astype(np.float64) @ turn.T,
        faces=surface.faces[:, ::-1] if mirrored else surface.faces,
        normals=_units(normals),
    )


# -------------------------------------------------------------------------------------------- one surface


def described(name: str, scene: Scene) -> Asset:
    """Describe all meshes that a scene shows, at full detail."""
    shown = [node for node in scene.instances if node.visible]
    return _described(name, all_placed(shown), _Cuts(0.0, None), Notes())[0]


def _described(path: str, shown: list[Placed], cuts: _Cuts, notes: Notes) -> tuple[Asset, bool]:
    """Describe instances; and whether all positions are in single precision."""
    asset = Asset(path, notes=notes)
    single = True
    for node in shown:
        if isinstance(node.mesh, Points | Lines):
            notes.add("points and lines")
            continue
        cut, look = cuts.of(node), several(node.material, "material")
        single &= cut.vertices.dtype == np.float32
        source = Source(
            vertices=cut.vertices.astype(np.float64),
            faces=cut.faces.astype(np.int64),
            normals=cut.normals,
            colors=cut.fine_colors,
            uvs=list(cut.uvs),
            channels=dict(cut._vertex_channels),
            face_materials=cut.face_materials,
            face_channels=dict(cut.face_channels),
        )
        asset.placed.append((node.name, len(asset.meshes), node.pose))
        asset.meshes.append([Part(node.name, source, list(look))])
    return asset, single


def _joined(path: str, shown: list[Placed], cuts: _Cuts, notes: Notes) -> Arrays:
    """Return all instances where they stand, as one surface."""
    asset, single = _described(path, shown, cuts, notes)
    source = flattened(asset)
    vertices = source.vertices
    far, size = float(np.abs(vertices).max()), float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if single and np.spacing(np.float32(far)) <= _DIGITS * size:
        vertices = vertices.astype(np.float32)
    numbers, normals = source.face_materials, source.normals
    return Arrays(
        vertices=vertices,
        faces=source.faces.astype(np.int32),
        normals=np.zeros_like(vertices, np.float32) if normals is None else _units(normals),
        fine_colors=source.colors,
        uvs=source.uvs,
        face_materials=None if numbers is None else numbers.astype(np.int32),
        materials=source.materials,
        channels=source.channels,
        face_channels=source.face_channels,
    )


def _units(normals: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0.0, length, 1.0), np.float32)
