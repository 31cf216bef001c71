"""Pictures by pyrender on OSMesa: one sample per pixel, the oracle for coverage, depth and colour."""

from __future__ import annotations

import os

os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from .camera import View

np.infty = np.inf  # noqa: NPY201  pyrender 0.1.45 still asks for it


class Light:
    """A light with its pose; ``kind`` is ``directional`` or ``point``."""

    def __init__(
        self,
        kind: str,
        pose: np.ndarray,
        intensity: float,
        color: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> None:
        self.kind, self.pose, self.intensity = kind, np.asarray(pose, float), float(intensity)
        self.color = np.asarray(color, float)  # pyrender takes integers for 0 to 255


class Material:
    """Metallic-roughness factors."""

    def __init__(
        self,
        base: tuple[float, float, float, float] = (0.7, 0.65, 0.6, 1.0),
        metallic: float = 0.1,
        roughness: float = 0.5,
        double_sided: bool = False,
    ) -> None:
        self.base, self.metallic, self.roughness, self.double_sided = base, metallic, roughness, double_sided


def import_pyrender():
    """pyrender on OSMesa; skips the calling test, with the reason, where it cannot be had."""
    try:
        import pyrender
        from OpenGL import osmesa  # noqa: F401  the library, not only its binding

        return pyrender
    except Exception as reason:  # missing package or missing libOSMesa: PyOpenGL raises several types
        pytest.skip(f"pyrender on OSMesa is not available (apt-get install libosmesa6): {reason!r}")


_renderer = None


def _offscreen(width: int, height: int):
    """One renderer for the process: contexts share no meshes, and a resize makes a new one in place."""
    global _renderer  # noqa: PLW0603
    pyrender = import_pyrender()
    if _renderer is None:
        try:
            _renderer = pyrender.OffscreenRenderer(width, height)
        except Exception as reason:
            pytest.skip(f"pyrender on OSMesa has no context: {reason!r}")
    _renderer.viewport_width, _renderer.viewport_height = width, height
    return _renderer


class Picture:
    """A mesh, its material and lights, ready to be rendered from any view."""

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        normals: np.ndarray,
        *,
        colors: np.ndarray | None = None,
        material: Material | None = None,
        lights: tuple[Light, ...] = (),
        ambient: tuple[float, float, float] = (0.1, 0.1, 0.1),
        poses: np.ndarray | None = None,
    ) -> None:
        pyrender = import_pyrender()
        material = material or Material()
        primitive = pyrender.Primitive(
            positions=np.asarray(vertices, np.float32),
            normals=np.asarray(normals, np.float32),
            indices=np.asarray(faces, np.uint32),
            color_0=None if colors is None else np.asarray(colors, np.float32) / 255,
            material=pyrender.MetallicRoughnessMaterial(
                baseColorFactor=material.base,
                metallicFactor=material.metallic,
                roughnessFactor=material.roughness,
                doubleSided=material.double_sided,
            ),
            poses=poses,
        )
        self.scene = pyrender.Scene(ambient_light=ambient, bg_color=(0.0, 0.0, 0.0, 0.0))
        self.scene.add(pyrender.Mesh([primitive]))
        for light in lights:
            kind = {"directional": pyrender.DirectionalLight, "point": pyrender.PointLight}[light.kind]
            self.scene.add(kind(color=light.color, intensity=light.intensity), pose=light.pose)

    def render(self, view: View, zfar: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Colour (H, W, 3) uint8 and linear depth (H, W) float32, 0 for background."""
        color, depth = self._draw(view, zfar, import_pyrender().RenderFlags.NONE)
        return np.array(color[..., :3]), np.array(depth)

    def depth(self, view: View, zfar: float | None = None) -> np.ndarray:
        """Linear depth as above, by the pass that draws nothing else."""
        return np.array(self._draw(view, zfar, import_pyrender().RenderFlags.DEPTH_ONLY))

    def _draw(self, view: View, zfar: float | None, flags: int):
        camera = import_pyrender().PerspectiveCamera(yfov=view.yfov, znear=view.znear, zfar=zfar)
        node = self.scene.add(camera, pose=view.pose)
        try:
            return _offscreen(view.width, view.height).render(self.scene, flags=flags)
        finally:
            self.scene.remove_node(node)
