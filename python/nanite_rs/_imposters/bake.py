"""Views of a scene from the directions of a grid, each texel the mean of several samples."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs._imposters import octahedron, texels
from nanite_rs.camera import OrthographicCamera
from nanite_rs.exceptions import ArgumentError, MeshError
from nanite_rs.material import several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.renderer import Renderer
from nanite_rs.scene import Scene
from nanite_rs.strokes import Lines, Points
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from nanite_rs.material import Look, Material
    from nanite_rs.scene import MeshNode

Layers: TypeAlias = "dict[str, NDArray[Any]]"
"""The images that an imposter keeps, by name: (views, views, size, size[, channels])."""

SAMPLES: Final = 4
"""Samples along each side of a texel: coverage in sixteenths."""
_AWAY: Final = 2.0
"""Radii from the centre to the camera: all of the sphere is between 1 and 3 in front of it."""


def sphere(nodes: Sequence[MeshNode]) -> tuple[NDArray[np.float64], float]:
    """Return the centre of the box around what instances show, and the radius from there, rounded outwards.

    Raises
    ------
    ArgumentError
        An instance is of points or lines.
    MeshError
        There is nothing, or it has no extent that single precision holds.
    """
    if not nodes:
        raise MeshError("mesh: there is nothing to see")
    corners: dict[int, NDArray[np.float64]] = {}
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for node in nodes:
        if isinstance(node.mesh, Points | Lines):
            raise ArgumentError(f"mesh: imposters are of surfaces, not of {type(node.mesh).__name__}")
        if id(node.mesh) not in corners:
            corners[id(node.mesh)] = _points(node.mesh)
        at = _posed(corners[id(node.mesh)], node)
        low, high = np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))
    center = low / 2.0 + high / 2.0
    with np.errstate(over="ignore"):
        far = max(
            float(np.linalg.norm(_posed(corners[id(node.mesh)], node) - center, axis=1).max())
            for node in nodes
        )
    # Vertices are rounded to single precision when they are drawn.
    radius = far * (1.0 + 1e-6) + 1e-6 * float(np.abs(center).max())
    if not 1e-30 <= far <= 3e38 or not math.isfinite(radius):
        raise MeshError(f"mesh: its radius is {far:g}; an imposter needs an extent of 1e-30 to 3e38")
    return center, radius


def _points(mesh: Any) -> NDArray[np.float64]:
    """Return points whose hull holds a mesh, (N, 3)."""
    if isinstance(mesh, NaniteMesh):
        return np.asarray(mesh.cut(error=0.0).vertices, np.float64)
    if isinstance(mesh, TriangleMesh):
        return np.asarray(mesh.vertices, np.float64)
    low, high = mesh.bounds
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)


def _posed(points: NDArray[np.float64], node: MeshNode) -> NDArray[np.float64]:
    pose = node.pose
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def normalized(nodes: Sequence[MeshNode], center: NDArray[np.float64], radius: float) -> Scene:
    """Return a scene of the same instances in the unit sphere, where what blends has holes instead."""
    scene = Scene()
    into = np.diag([1.0 / radius] * 3 + [1.0])
    into[:3, 3] = -center / radius
    for node in nodes:
        scene.add(node.mesh, pose=into @ node.pose, material=_tested(node.material))
    return scene


def _tested(look: Look) -> list[Material]:
    return [
        replace(one, alpha_mode="mask", alpha_cutoff=0.5) if one.alpha_mode == "blend" else one
        for one in several(look, "material")
    ]


def baked(
    scene: Scene,
    *,
    views: int,
    size: int,
    full: bool,
    up: Literal["y", "z"],
    backend: Literal["auto", "cpu", "gpu"],
) -> Layers:
    """Return the layers of all views, (views, views, size, size[, channels]), of a scene in the unit sphere.

    Raises
    ------
    MeshError
        No view shows anything.
    """
    axes = octahedron.AXES[up]
    directions = octahedron.grid(views, full=full) @ axes
    layers: Layers = {
        name: np.zeros((views, views, size, size, count)[: 4 + (count > 1)], dtype)
        for name, (count, dtype) in texels.LAYERS.items()
    }
    # On the border of the full map a direction has several places.
    known: dict[tuple[float, ...], tuple[int, int]] = {}
    seen = False
    with Renderer(size * SAMPLES, size * SAMPLES, backend=backend) as renderer:
        renderer._blank = False  # one-sided surfaces may show nothing in the first views
        for row, column in np.ndindex(views, views):
            direction = directions[row, column]
            first = known.setdefault(tuple((direction.round(9) + 0.0).tolist()), (row, column))
            if first != (row, column):
                for layer in layers.values():
                    layer[row, column] = layer[first]
                continue
            view = texels.reduced(_view(renderer, scene, octahedron.frame(direction, axes)), SAMPLES)
            seen = seen or bool((view[..., texels.ALPHA] > 0.0).any())
            for name, layer in texels.packed(texels.filled(view)).items():
                layers[name][row, column] = layer
    if not seen:
        raise MeshError("mesh: no view shows anything; all of it is transparent, or without area")
    return layers


def _view(renderer: Renderer, scene: Scene, frame: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the samples of a view at full detail; the frame's rows are right, up and back."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = frame.T, _AWAY * frame[2]
    shown = renderer.render(
        scene,
        OrthographicCamera(1.0, 1.0, znear=0.5 * (_AWAY - 1.0)),
        pose,
        pixel_error=0.0,
        shading="gltf",
        outputs=("depth", "base_color", "shading_normal", "orm"),
    )
    out = np.empty((renderer.height, renderer.width, texels.CHANNELS), np.float32)
    out[..., texels.COLOR] = shown.base_color
    out[..., texels.ALPHA] = shown.depth > 0.0
    out[..., texels.NORMAL] = shown.shading_normal
    out[..., texels.DEPTH] = shown.depth - (_AWAY - 1.0)
    out[..., texels.ORM] = shown.orm
    # What an empty view keeps: the middle of the sphere, facing the viewer.
    empty = shown.depth == 0.0
    out[empty, texels.NORMAL] = frame[2]
    out[empty, texels.DEPTH] = 1.0
    out[empty, texels.ORM] = (1.0, 1.0, 0.0)
    return out
