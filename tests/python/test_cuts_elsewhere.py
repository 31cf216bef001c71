"""Cuts to a tenth as GLB, read by trimesh and drawn by pyrender: what others see is what we do."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import camera, data, picture
from oracles.compare import psnr
from test_content import grid, nearest_places

WIDTH, HEIGHT = 480, 320
#: What pyrender, or trimesh before it, leaves out of a file: compared is what it has kept.
LEFT_OUT = {
    "FlightHelmet": "what is behind glass",
    "MultiUVTest": "the second UV set",
    "SheenChair": "the second UV set",
    "VertexColorTest": "linear vertex colours, which it takes for sRGB",
    "house": "the second UV set",
}
#: What it blends in an order that changes from run to run: drawn without blending.
UNSORTED = "house", "scene"
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
    if path.stem in UNSORTED:
        for node in theirs.mesh_nodes:
            for primitive in node.mesh.primitives:
                primitive.material.alphaMode = "OPAQUE"
    if path.stem in LEFT_OUT or path.stem in UNSORTED:
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
    assert psnr(drawn, seen) >= 40.0


def shortest_edge(mesh: nrs.NaniteMesh) -> float:
    """The shortest of the edges that deviations are measured by: for each group, of its mean area."""
    clusters = mesh.clusters()
    counts = np.diff(clusters.triangle_offsets)
    first = np.repeat(clusters.vertex_offsets[:-1], counts)
    corners = clusters.vertices.astype(float)[clusters.triangles + first[:, None]]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    groups = np.repeat(clusters.groups, counts)
    whole = np.bincount(groups, areas) / np.maximum(np.bincount(groups), 1)
    return float(np.sqrt(4.0 / np.sqrt(3.0) * whole[whole > 0.0].min()))


@pytest.mark.parametrize("shape", ["ball", "card"])
def test_uvs_of_a_tenth(shape, tmp_path) -> None:
    """Points of a file that trimesh has read lie near points of the source with UVs as near as is stated."""
    if shape == "ball":
        vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000)
        uvs = 0.5 + 0.3 * vertices[:, :2] + 0.02 * np.sin(6.0 * vertices[:, [2, 0]])
    else:
        vertices, faces = grid(63)
        x, y = vertices[:, 0], vertices[:, 1]
        vertices[:, 2] = 0.1 * np.sin(3.0 * x)
        uvs = np.stack([x + 0.05 * np.sin(9.0 * y), y], axis=-1)
    vertices, uvs = vertices.astype(np.float32), uvs.astype(np.float32)
    texture = nrs.Texture(nrs.Image(np.full((8, 8, 3), 200, np.uint8)))
    look = nrs.Material(base_color_texture=texture)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, uvs=uvs, materials=[look])
    cut = mesh.cut(target_reduction=0.9)
    cut.export(tmp_path / "tenth.glb")
    (read,) = trimesh.load(tmp_path / "tenth.glb").geometry.values()
    assert len(read.faces) == len(cut)
    rng = np.random.default_rng(7)
    chosen, at = rng.integers(len(read.faces), size=300), rng.dirichlet([1.0] * 3, 300)
    points = np.einsum("nk,nkd->nd", at, read.vertices[read.faces[chosen]])
    here = np.einsum("nk,nkd->nd", at, read.visual.uv[read.faces[chosen]])
    away, off = np.zeros((2, 300, len(faces)))
    for k, point in enumerate(points):
        place = nearest_places(point[None], vertices[faces].astype(float))[0]
        away[k] = np.linalg.norm(
            np.einsum("tk,tkd->td", place, vertices[faces].astype(float)) - point, axis=1
        )
        off[k] = np.linalg.norm(np.einsum("tk,tkd->td", place, uvs[faces].astype(float)) - here[k], axis=1)
    stated, edge = cut.attribute_error, shortest_edge(mesh)
    assert 0.0 < stated < 0.9 * edge
    near = away <= (cut.error + stated) * (1.0 + 1e-5)
    found = np.where(near, off, np.inf).min(axis=1)
    print(f"{shape}: UVs off by {found.max():.4f}, stated {stated / edge:.4f}; {len(cut)} faces")
    assert 0.0 < found.max() <= stated / edge
