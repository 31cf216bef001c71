"""Finding out why a picture shows nothing, or not everything, by coarse frames of what was likely meant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nanite_rs import _core

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs.camera import Camera

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_POOL = 512 << 20
# What a renderer of the core is told: depth alone, with what is in memory.
_COARSE = {
    "pixel_error": 8.0,
    "occlusion": True,
    "raster": "auto",
    "outputs": None,
    "depth_only": True,
    "samples": 1,
    "shading": "pyrender",
    "transfer": "gamma22",
    "wait": False,
    "shadows": "off",
    "shadow_memory": 0,
    "shadow_samples": 1,
    "max_layers": 0,
    "transparent_ids": False,
    "motion": False,
}


class _Depth:
    """Coarse pictures of a scene's depth. Of streamed meshes nothing but their coarsest pages is read."""

    def __init__(self, scene: _core.Scene, camera: Camera, size: tuple[int, int]) -> None:
        self._scene, self._renderer = scene, _core.Renderer(*size, "cpu", _POOL)
        self._kind, self._parameters, self.near, self.far = camera._spec()
        self.nearest = max(self.near * 1e-6, 1e-30)
        """A near distance that cuts nothing off."""

    def __call__(self, pose: NDArray[np.float64], near: float, far: float | None) -> NDArray[np.float32]:
        (frame,) = self._renderer.render(
            self._scene,
            [((self._kind, self._parameters, near, far), pose, 0, None, None, None, None)],
            _COARSE,
        )
        return frame.depth()


def cut_off(scene: _core.Scene, camera: Camera, pose: ArrayLike, size: tuple[int, int]) -> bool:
    """Whether anything is seen nearer than the near distance."""
    depth = _Depth(scene, camera, size)
    seen = depth(np.asarray(pose, np.float64), depth.nearest, depth.far)
    # Coarse levels may reach a little in front of the surface.
    return bool(((seen > 0.0) & (seen < 0.98 * depth.near)).any())


def reason(scene: _core.Scene, camera: Camera, pose: ArrayLike, size: tuple[int, int]) -> str:
    """Say what would show something."""
    if scene.instance_count == 0:
        return "the scene has no mesh; add one with scene.add(mesh)"
    depth = _Depth(scene, camera, size)
    near, far = depth.near, depth.far
    given: NDArray[np.float64] = np.asarray(pose, np.float64)
    unclipped = depth(given, depth.nearest, None)
    if unclipped.any():
        if far is not None and unclipped.max() > far:
            return f"all of it is farther than zfar={far:g}; give a larger one, or None"
        return f"all of it is nearer than znear={near:g}; give a smaller one"
    world_to_camera = np.asarray(np.linalg.inv(given), np.float64)
    tries = {
        "np.linalg.inv(pose), if that maps world to camera": world_to_camera,
        "pose @ np.diag([1, -1, -1, 1]), if the camera looks along its +Z as in OpenCV": given @ _FLIP,
        "np.linalg.inv(pose) @ np.diag([1, -1, -1, 1]), if that maps world to an OpenCV camera": world_to_camera
        @ _FLIP,
    }
    found = [advice for advice, at in tries.items() if depth(at, near, far).any()]
    if found:
        return (
            f"the camera looks along its −Z, and nothing is there; would show something: {'; '.join(found)}"
        )
    if min(size) < 8:
        return f"a picture of {size[0]} × {size[1]} pixels is too small: a pixel shows what is at its centre"
    return (
        "check that pose is camera-to-world and looks along −Z at the mesh, that instances are visible, and that "
        "the camera is not inside a mesh, whose back faces only Material(double_sided=True) shows"
    )
