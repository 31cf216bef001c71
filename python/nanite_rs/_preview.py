"""A picture of a whole mesh, cut or scene: its camera and lights."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from nanite_rs import _images, _notebook
from nanite_rs._geometry import Geometry, Shape
from nanite_rs.assets import LoadedScene
from nanite_rs.camera import PerspectiveCamera
from nanite_rs.cut import Cut
from nanite_rs.exceptions import NaniteError
from nanite_rs.light import DirectionalLight
from nanite_rs.material import Material
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions
from nanite_rs.renderer import Renderer, ShadowsName, StreamWarning
from nanite_rs.scene import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs.frame import Frame
    from nanite_rs.material import Look

SIZE: Final = (480, 360)
"""Pixels of a notebook's picture."""

CUT_FACES: Final = 250_000
"""Most triangles of a cut that notebooks show: they are built to be drawn, which takes a second for a million."""


BACKGROUND: Final = (0.92, 0.93, 0.95)
"""Colour behind what is shown."""

CLAY: Final = Material(base_color=(0.8, 0.8, 0.8), metallic=0.0, roughness=0.6)
"""What shapes are seen best in: brighter than what is drawn of meshes without a material."""

#: Columns: where the X, Y and Z axes of a view with Y up lie in the mesh.
UP: Final = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


def picture(
    renderer: Renderer,
    shown: Shape | LoadedScene,
    *,
    yfov: float = 45.0,
    azimuth: float = 30.0,
    elevation: float = 20.0,
    up: str = "y",
    distance: float = 1.0,
    pixel_error: float = 1.0,
    samples: Literal[1, 4, 16] = 1,
    material: Material | None = None,
    shadows: bool | ShadowsName = False,
    framed: Shape | None = None,
) -> Frame:
    """A frame of a mesh alone, or of a scene with its materials; at ``distance`` 1 it fills the picture.

    Angles are degrees, the elevation above the horizon of ``up``; ``material`` is that of a mesh. What is
    ``framed`` fills the picture in place of what is shown.
    """
    fit = shown if framed is None else framed
    center = fit.bounds.mean(axis=0)
    fov = np.radians(yfov)
    around, above = np.radians([azimuth, elevation])
    direction = np.array([np.cos(above) * np.sin(around), np.sin(above), np.cos(above) * np.cos(around)])
    axes = UP[up] @ _facing(direction)
    away, radius = framing(outline(fit) - center, axes, fov, renderer.width / renderer.height)
    away *= distance
    pose = posed(axes, center + axes[:, 2] * away)
    if isinstance(shown, LoadedScene):
        # Metals only show reflections, and two lights give few.
        scene, ambient = shown.scene, 0.25
        shading: Literal["gltf", "pyrender"] = "gltf"
    else:
        scene, ambient = Scene(), 0.06
        shading = "pyrender"
        scene.add(shown, material=material or look_of(shown))
    scene.ambient_light, scene.bg_color = (ambient, ambient, ambient + 0.01), BACKGROUND
    for light, turned in LIGHTS:
        scene.add(light, pose=posed(axes @ turned, center))
    camera = PerspectiveCamera(yfov=fov, znear=max(away - 1.5 * radius, away * 1e-3))
    return renderer.render(
        scene, camera, pose, pixel_error=pixel_error, samples=samples, shading=shading, shadows=shadows
    )


def look_of(shown: Shape, clay: Material = CLAY) -> Look:
    """What a shape is shown with: its own look, or clay."""
    return (shown.materials or clay) if isinstance(shown, Geometry) else shown._default_look()


def mesh_frame(mesh: Shape, *, pixel_error: float = 1.0, flat: bool = False) -> Frame:
    """A small frame of a mesh, in milliseconds for any size: of a file what it shows is read and not kept."""
    with Renderer(*SIZE, backend="cpu", streaming=True, pool_bytes=1 << 40) as renderer:
        # From both sides, since open surfaces may face away.
        material = replace(CLAY, smooth=not flat, double_sided=True) if isinstance(mesh, Geometry) else None
        return picture(renderer, mesh, pixel_error=pixel_error, samples=4, material=material)


@_notebook.png.register(Shape)
def mesh_png(mesh: Shape) -> bytes | None:
    """PNG of `mesh_frame`; None where the mesh cannot be read."""
    try:
        with warnings.catch_warnings():
            # A damaged file has no picture, rather than one that lacks detail.
            warnings.simplefilter("error", StreamWarning)
            return _images.png(mesh_frame(mesh).color)
    except (NaniteError, StreamWarning):
        return None


def cut_frame(cut: Cut) -> Frame:
    """A small frame of all triangles of a cut, each shaded as it lies."""
    # Only the triangles of this mesh are drawn, those of the cut: nobody reads its errors.
    options = BuildOptions(error="quadric")
    mesh = NaniteMesh.from_arrays(
        cut.vertices, cut.faces, colors=cut.fine_colors, options=options, progress=False
    )
    return mesh_frame(mesh, pixel_error=0.0, flat=True)


@_notebook.png.register(Cut)
def cut_png(cut: Cut) -> bytes | None:
    """PNG of `cut_frame`; None for cuts of more than `CUT_FACES`, and where the caller's changes left no mesh."""
    if len(cut.faces) > CUT_FACES:
        return None
    try:
        return _images.png(cut_frame(cut).color)
    except NaniteError:
        return None


def _facing(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation of what looks against ``direction``, along its own −Z, with Y up."""
    back = direction / np.linalg.norm(direction)
    right = np.cross([0.0, 1.0, 0.0] if abs(back[1]) < 0.999 else [0.0, 0.0, -np.sign(back[1])], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


#: What lights a picture, with the way it faces as the camera sees it: from behind its left shoulder, and a little
#: from the right.
LIGHTS: Final = (
    (DirectionalLight(intensity=2.4), _facing(np.array([-0.8, 0.8, 1.0]))),
    (DirectionalLight(intensity=0.6), _facing(np.array([1.0, 0.0, 0.5]))),
)


def framing(
    points: NDArray[np.float64], axes: NDArray[np.float64], yfov: float, aspect: float
) -> tuple[float, float]:
    """How far along Z of ``axes`` a camera sees all of some points, with a margin; and how far out they lie."""
    local = points @ axes
    tangents = 0.92 * np.tan(yfov / 2.0) * np.array([aspect, 1.0])
    away = max(float((local[:, 2] + (np.abs(local[:, :2]) / tangents).max(axis=1)).max()), 1e-30)
    return away, float(np.linalg.norm(local, axis=1).max())


def posed(rotation: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """A matrix of a rotation and a place."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def outline(shown: Shape | LoadedScene) -> NDArray[np.float64]:
    """Points of all that is shown, (N, 3)."""
    if isinstance(shown, Shape):
        return np.asarray(shown._outline(), np.float64)
    nodes = [node for own in shown.instances.values() for node in own]
    return np.concatenate([node.mesh._outline() @ node.pose[:3, :3].T + node.pose[:3, 3] for node in nodes])
