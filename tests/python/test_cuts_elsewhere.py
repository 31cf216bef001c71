"""Cuts to a tenth as GLB, read by trimesh and drawn by pyrender: what others see is what we do."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import camera, data, picture
from oracles.compare import psnr

WIDTH, HEIGHT = 480, 320
#: What pyrender, or trimesh before it, leaves out of a file: compared is what it has kept.
LEFT_OUT = {
    "FlightHelmet": "what is behind glass",
    "MultiUVTest": "the second UV set",
    "SheenChair": "the second UV set",
    "VertexColorTest": "linear vertex colours, which it takes for sRGB",
    "house": "the second UV set",
}
#: Decibels that outlines take, which the two draw by rules of their own: fences and leaves, wires of a car.
THIN = {"house": 2.5, "scene": 0.5}
ASSETS = data.folder_models("gltf")


@pytest.mark.parametrize("path", ASSETS or [None], ids=lambda path: "absent" if path is None else path.stem)
def test_a_tenth(path, tmp_path) -> None:
    if path is None:
        data.require("gltf")
    pyrender = picture.import_pyrender()
    fast = nrs.BuildOptions(quality="fast", error="quadric")
    mesh = nrs.NaniteMesh.from_file(path, options=fast)
    cut = mesh.cut(target_reduction=0.9)
    cut.export(tmp_path / "tenth.glb")
    theirs = pyrender.Scene.from_trimesh_scene(
        trimesh.load(tmp_path / "tenth.glb"), ambient_light=(0.2, 0.2, 0.2), bg_color=(1.0, 1.0, 1.0, 1.0)
    )
    view = camera.framing(np.asarray(cut.vertices, float), (0.4, 0.3, 1.0), width=WIDTH, height=HEIGHT)
    theirs.add(pyrender.PerspectiveCamera(yfov=view.yfov, znear=view.znear), pose=view.pose)
    if path.stem in LEFT_OUT:
        ours = nrs.from_pyrender(theirs).scene
    else:
        ours = nrs.load_scene(tmp_path / "tenth.glb").scene
    theirs.add(pyrender.DirectionalLight(color=np.ones(3), intensity=3.0), pose=view.pose)
    seen = picture._offscreen(WIDTH, HEIGHT).render(theirs)[0][..., :3]
    ours.ambient_light, ours.bg_color = (0.2, 0.2, 0.2), (1.0, 1.0, 1.0)
    ours.add(nrs.DirectionalLight(intensity=3.0), pose=view.pose)
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        lens = nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
        frame = renderer.render(ours, lens, view.pose, pixel_error=0, shading="pyrender")
    drawn = frame.color[..., :3]
    assert (seen < 250).any(axis=2).mean() > 0.01
    assert psnr(drawn, seen) >= 40.0 - THIN.get(path.stem, 0.0)
