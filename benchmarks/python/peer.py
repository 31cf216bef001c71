"""pyrender on OSMesa, as the frame benchmarks use it."""

from __future__ import annotations

import os

os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")

import numpy as np

np.infty = np.inf  # noqa: NPY201  pyrender 0.1.45 still asks for it

SIZE = (1280, 720)
YFOV = 0.8


class Pyrender:
    """One smooth mesh, or several instances of it, under one directional light."""

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        normals: np.ndarray,
        poses: list[np.ndarray] | None = None,
    ) -> None:
        import pyrender

        primitive = pyrender.Primitive(
            positions=np.asarray(vertices, np.float32),
            normals=np.asarray(normals, np.float32),
            indices=np.asarray(faces, np.uint32),
            poses=None if poses is None else np.stack(poses),
            material=pyrender.MetallicRoughnessMaterial(
                baseColorFactor=(0.7, 0.65, 0.6, 1.0), metallicFactor=0.1, roughnessFactor=0.5
            ),
        )
        self.scene = pyrender.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0.0, 0.0, 0.0, 0.0))
        self.scene.add(pyrender.Mesh([primitive]))
        self.camera = self.scene.add(pyrender.PerspectiveCamera(yfov=YFOV, znear=0.05), pose=np.eye(4))
        self.light = self.scene.add(
            pyrender.DirectionalLight(color=np.ones(3), intensity=3.0), pose=np.eye(4)
        )
        self.renderer = pyrender.OffscreenRenderer(*SIZE)

    def render(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colour and depth from a pose; the light shines along the view."""
        self.scene.set_pose(self.camera, pose)
        self.scene.set_pose(self.light, pose)
        return self.renderer.render(self.scene)

    def driver(self) -> str:
        """What OpenGL calls the device that drew the last picture."""
        from OpenGL import GL

        return GL.glGetString(GL.GL_RENDERER).decode()

    def close(self) -> None:
        """Frees the context."""
        self.renderer.delete()


def orbit(step: int, distance: float, target: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Pose number ``step`` of a slow orbit, one degree a step: no two frames are the same."""
    angle = np.radians(step)
    back = np.array([np.sin(angle), 0.2, np.cos(angle)])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(back, right), back
    pose[:3, 3] = np.asarray(target) + back * distance
    return pose
