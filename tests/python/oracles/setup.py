"""One scene in the forms of nanite_rs and of pyrender: same mesh, normals, material, lights and view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import nanite_rs as nrs

from . import camera, picture, subjects, topology

UP = {"lucy": (0.0, 0.0, 1.0)}
"""Which way is up, where it is not +Y."""
DIRECTION = {
    "lucy": (0.6, -1.0, 0.1),
    "horse": (0.3, -0.2, 1.0),
    "armadillo": (-0.4, 0.2, -1.0),
    "plane": (0.4, 0.5, 1.0),
    "terrain": (0.4, 0.5, 1.0),
    "mountain": (0.4, 0.5, 1.0),
}
"""From where to look."""
OPEN = frozenset({"bunny", "terrain", "plane", "mountain", "soup", "ribbon"})
"""Meshes with holes, through which back faces show: rendered double-sided."""


@dataclass
class Setup:
    """A mesh with normals, its material and lights and a view."""

    name: str
    mesh: subjects.Mesh
    view: camera.View
    normals: np.ndarray
    material: picture.Material
    lights: tuple[picture.Light, ...]
    ambient: tuple[float, float, float] = (0.1, 0.1, 0.1)
    colors: np.ndarray | None = None
    _built: nrs.NaniteMesh | None = field(default=None, repr=False)

    @property
    def built(self) -> nrs.NaniteMesh:
        """The mesh as nanite_rs holds it, built once."""
        if self._built is None:
            self._built = nrs.NaniteMesh.from_arrays(
                self.mesh.vertices,
                self.mesh.faces,
                normals=self.normals,
                colors=self.colors,
                options=nrs.BuildOptions(face_ids=True),
                progress=False,
            )
        return self._built

    def oracle(self) -> picture.Picture:
        """The scene for pyrender."""
        return picture.Picture(
            self.mesh.vertices,
            self.mesh.faces,
            self.normals,
            colors=self.colors,
            material=self.material,
            lights=self.lights,
            ambient=self.ambient,
        )

    def scene(self) -> nrs.Scene:
        """The scene for nanite_rs."""
        scene = nrs.Scene(ambient_light=self.ambient, bg_color=(0.0, 0.0, 0.0))
        material = nrs.Material(
            base_color=self.material.base,
            metallic=self.material.metallic,
            roughness=self.material.roughness,
            double_sided=self.material.double_sided,
        )
        scene.add(self.built, material=material)
        for light in self.lights:
            kind = {"directional": nrs.DirectionalLight, "point": nrs.PointLight}[light.kind]
            scene.add(kind(color=light.color, intensity=light.intensity), pose=light.pose)
        return scene

    def render(self, pixel_error: float, backend: str = "cpu"):
        """A frame by nanite_rs."""
        lens = nrs.PerspectiveCamera(yfov=self.view.yfov, znear=self.view.znear)
        with nrs.Renderer(self.view.width, self.view.height, backend=backend) as renderer:
            return renderer.render(self.scene(), lens, self.view.pose, pixel_error=pixel_error)


def setup(name: str, *, fill: float = 0.92) -> Setup:
    """The scene of a subject: a key light beside the camera, a dim one from behind it, a point light."""
    mesh = subjects.subject(name)
    up = UP.get(name, (0.0, 1.0, 0.0))
    view = camera.framing(mesh.used, DIRECTION.get(name, (0.35, 0.25, 1.0)), fill=fill, up=up)
    right, above, back = view.pose[:3, 0], view.pose[:3, 1], view.pose[:3, 2]
    size = mesh.diagonal

    def shining_from(direction: np.ndarray) -> np.ndarray:
        return camera.look_at(mesh.center + size * 2 * direction, mesh.center, up)

    lights = (
        picture.Light("directional", shining_from(back + 0.6 * above - 0.5 * right), 3.0),
        picture.Light("directional", shining_from(back - 0.8 * right - 0.3 * above), 1.0, (0.6, 0.7, 1.0)),
        picture.Light("point", _at(mesh.center + size * (0.8 * right + 0.6 * above + back)), 2.0 * size**2),
    )
    return Setup(
        name,
        mesh,
        view,
        topology.vertex_normals(mesh.vertices, mesh.faces),
        picture.Material(double_sided=name in OPEN),
        lights,
    )


def _at(position: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose
