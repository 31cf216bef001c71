"""docs/pyrender.md: each call of pyrender in its table, and ours beside it, draw the same."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import compare, picture

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "pyrender.md"
SIZE = 240, 180
EYE = nrs.look_at((0.5, 0.6, 4.0), (0.0, 0.0, 0.0))
SUN = nrs.look_at((1.0, 2.0, 2.0), (0.0, 0.0, 0.0))
BALL = trimesh.creation.icosphere(subdivisions=3)
BOX = trimesh.creation.box((1.0, 0.8, 0.6))
ASIDE = nrs.look_at((1.4, 0.2, -0.5), (1.4, 0.2, 1.0))
AMBIENT = (0.2, 0.2, 0.2)


class Both:
    """A scene of pyrender and one of ours, with a sun and a camera each."""

    def __init__(self, pyrender, *, lit: bool = True) -> None:
        self.pyrender = pyrender
        self.theirs = pyrender.Scene(ambient_light=AMBIENT, bg_color=(0.0, 0.0, 0.0, 0.0))
        self.ours = nrs.Scene(ambient_light=AMBIENT, bg_color=(0.0, 0.0, 0.0))
        self.theirs.add(pyrender.PerspectiveCamera(yfov=0.8), pose=EYE)
        self.camera = nrs.PerspectiveCamera(yfov=0.8)
        if lit:
            self.theirs.add(pyrender.DirectionalLight(intensity=3.0), pose=SUN)
            self.ours.add(nrs.DirectionalLight(intensity=3.0), pose=SUN)

    def add(self, mesh, pose=None, **look):
        """The same mesh on both sides; returns the nodes."""
        material = self.pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(0.8, 0.5, 0.3, 1.0), metallicFactor=0.1, roughnessFactor=0.6, **look
        )
        own = nrs.Material(
            base_color=(0.8, 0.5, 0.3),
            metallic=0.1,
            roughness=0.6,
            smooth=False,
            double_sided=bool(look.get("doubleSided")),
        )
        theirs = self.pyrender.Mesh.from_trimesh(mesh, material=material, smooth=False)
        return self.theirs.add(theirs, pose=pose), self.ours.add(mesh, pose=pose, material=own)

    def render(self, flags: int = 0, point_size: float = 1.0, **options):
        renderer = picture._offscreen(*SIZE)
        renderer.point_size = point_size
        try:
            made = renderer.render(self.theirs, flags=flags)
        finally:
            renderer.point_size = 1.0
        color, depth = (None, made) if flags & self.pyrender.RenderFlags.DEPTH_ONLY else made
        with nrs.Renderer(*SIZE, backend="cpu") as ours:
            frame = ours.render(self.ours, self.camera, EYE, pixel_error=0.0, **options)
        return color, depth, frame

    def check(self, flags: int = 0, **options):
        """Both draw the same, but for outlines."""
        color, depth, frame = self.render(flags, **options)
        assert ((frame.depth > 0) != (depth > 0)).mean() < 1e-3
        assert (depth > 0).mean() > 0.03
        inside = compare.away_from_silhouettes(depth, 0.01) & (frame.depth > 0)
        assert np.abs(frame.depth - depth)[inside].max() < 0.01
        if color is not None:
            assert compare.psnr(frame.color, color[..., :3], inside) >= 38
        return color, depth, frame


def scene(both):
    both.add(BALL)
    color, _, frame = both.check()
    assert not frame.color[frame.depth == 0].any()
    assert not color[..., :3][frame.depth == 0].any()


def adding(both):
    both.add(BALL, ASIDE)
    both.check()


def instances(both):
    material = both.pyrender.MetallicRoughnessMaterial(baseColorFactor=(0.8, 0.5, 0.3, 1.0))
    poses = np.array([ASIDE, np.eye(4)])
    both.theirs.add(both.pyrender.Mesh.from_trimesh(BOX, material=material, poses=poses, smooth=False))
    mesh = nrs.TriangleMesh.from_trimesh(BOX)
    look = nrs.Material(base_color=(0.8, 0.5, 0.3), metallic=1.0, roughness=1.0, smooth=False)
    nodes = [both.ours.add(mesh, pose=pose, material=look) for pose in poses]
    assert nodes[0].mesh is nodes[1].mesh
    both.check()


def moving(both):
    theirs, ours = both.add(BOX)
    both.theirs.set_pose(theirs, ASIDE)
    ours.pose = ASIDE
    both.check()


def removing(both):
    both.add(BALL)
    theirs, ours = both.add(BOX, ASIDE)
    both.theirs.remove_node(theirs)
    ours.remove()
    both.check()


def hiding(both):
    both.add(BALL)
    theirs, ours = both.add(BOX, ASIDE)
    theirs.mesh.is_visible = False
    ours.visible = False
    both.check()


def new_vertices(both):
    theirs, ours = both.add(BALL)
    bent = BALL.vertices * (1.0, 0.6, 1.2)
    look = theirs.mesh.primitives[0].material
    both.theirs.remove_node(theirs)
    again = trimesh.Trimesh(bent, BALL.faces, process=False)
    both.theirs.add(both.pyrender.Mesh.from_trimesh(again, material=look, smooth=False))
    ours.mesh.update(bent, normals="recompute")
    both.check()


def points(both):
    places = np.random.default_rng(0).uniform(-1, 1, (300, 3)).astype(np.float32)
    colors = np.abs(places)
    both.theirs.add(both.pyrender.Mesh.from_points(places, colors=colors))
    both.ours.add(nrs.Points(places, colors=colors, radius=0.5))
    color, depth, frame = both.render(both.pyrender.RenderFlags.FLAT, shading="flat", transfer="linear")
    same = (depth > 0) & (np.abs(frame.depth - depth) < 0.01)
    assert same.sum() > 0.9 * (depth > 0).sum() > 200
    assert compare.psnr(frame.color, color[..., :3], same) >= 38


def lines(both):
    places = np.random.default_rng(1).uniform(-1, 1, (24, 3)).astype(np.float32)
    colors = 0.5 + 0.25 * places
    both.theirs.add(both.pyrender.Mesh([both.pyrender.Primitive(places, color_0=colors, mode=1)]))
    both.ours.add(nrs.Lines(places, np.arange(24).reshape(12, 2), colors=colors, width=1.0))
    color, depth, frame = both.render(both.pyrender.RenderFlags.FLAT, shading="flat", transfer="linear")
    same = (depth > 0) & (np.abs(frame.depth - depth) < 0.01)
    assert same.sum() > 0.6 * (depth > 0).sum() > 300
    assert compare.psnr(frame.color, color[..., :3], same) >= 38


def wireframe(both):
    both.add(BOX)
    _, depth, frame = both.render(both.pyrender.RenderFlags.ALL_WIREFRAME)
    ours = frame.view("wireframe")
    drawn = (depth > 0) & (frame.depth > 0)
    # Where pyrender draws an edge that is in front, ours is dark.
    front = drawn & (np.abs(depth - frame.depth) < 0.01)
    assert front.sum() > 100
    assert (ours[front].max(axis=1) < 160).mean() > 0.9
    edges = frame.view("shaded", edges=True)
    assert (edges[front].max(axis=1) <= frame.color[front].max(axis=1)).all()


def blending(both):
    look = {"metallicFactor": 0.1, "roughnessFactor": 0.6}
    glass = both.pyrender.MetallicRoughnessMaterial(
        baseColorFactor=(0.8, 0.5, 0.3, 0.5), alphaMode="BLEND", **look
    )
    both.theirs.add(both.pyrender.Mesh.from_trimesh(BOX, material=glass, smooth=False))
    own = nrs.Material(
        base_color=(0.8, 0.5, 0.3, 0.5), metallic=0.1, roughness=0.6, smooth=False, alpha_mode="blend"
    )
    both.ours.add(BOX, material=own)
    color, _, frame = both.render(transparent_ids=True)
    glass_alone = frame.instance_id == 0
    # Before black, half of the light: half of the encoded colour there, half in linear light here.
    linear = (color[..., :3] / 255.0 / 0.5) ** 2.2 * 0.5
    inside = compare.away_from_silhouettes(frame.depth, 0.01) & glass_alone
    assert inside.sum() > 800
    assert np.abs(frame.linear - linear)[inside].max() < 0.02


def cameras(both):
    both.add(BOX)
    kinds = {
        "PerspectiveCamera": {"yfov": 0.8},
        "IntrinsicsCamera": {"fx": 200.0, "fy": 210.0, "cx": 118.0, "cy": 92.0},
        "OrthographicCamera": {"xmag": 2.0, "ymag": 1.5},
    }
    for name, given in kinds.items():
        both.theirs.remove_node(both.theirs.main_camera_node)
        both.theirs.add(getattr(both.pyrender, name)(**given), pose=EYE)
        both.camera = getattr(nrs, name)(**given)
        color, depth, frame = both.render()
        assert ((frame.depth > 0) != (depth > 0)).mean() < 2e-3, name
        inside = compare.away_from_silhouettes(frame.depth, 0.01) & (depth > 0)
        assert compare.psnr(frame.color, color[..., :3], inside) >= 38, name


def lights(both):
    both.add(BALL)
    lamps = [("PointLight", {"intensity": 20.0}), ("SpotLight", {"intensity": 60.0, "outerConeAngle": 0.3})]
    for name, given in lamps:
        color = (1.0, 0.8, 0.6)
        cone = {"innerConeAngle": 0.1} if name == "SpotLight" else {}
        at = nrs.look_at((-1.5, 1.0, 2.5), (0.0, 0.0, 0.0))
        both.theirs.add(getattr(both.pyrender, name)(color=color, **given, **cone), pose=at)
        both.ours.add(getattr(nrs, name)(color=color, **given, **cone), pose=at)
    both.check()


def shadows(both):
    floor = trimesh.creation.box((5.0, 0.1, 5.0))
    both.add(floor, nrs.look_at((0, -1.1, 0), (0, -1.1, -1)))
    both.add(BALL)
    plain = both.render()[2]
    flags = both.pyrender.RenderFlags
    # Of spots and points it has none on OSMesa, whose textures it leaves unbound.
    color, depth, frame = both.render(flags.SHADOWS_DIRECTIONAL, shadows=True)
    inside = compare.away_from_silhouettes(depth, 0.01) & (frame.depth > 0)
    # pyrender's shadows end in steps: most pixels agree on which side of one they are.
    ours = plain.color[..., 0].astype(int) - frame.color[..., 0] > 20
    unshadowed, *_ = both.render()
    theirs = unshadowed[..., 0].astype(int) - color[..., 0] > 20
    assert ours[inside].sum() > 500
    assert (ours != theirs)[inside].mean() < 0.05


def segmentation(both):
    first, second = both.add(BALL), both.add(BOX, ASIDE)
    names = {first[0]: (10, 0, 0), second[0]: (20, 0, 0)}
    theirs, _ = picture._offscreen(*SIZE).render(
        both.theirs, flags=both.pyrender.RenderFlags.SEG, seg_node_map=names
    )
    _, _, frame = both.render()
    ours = np.zeros(SIZE[::-1], int)
    for (_, node), value in zip((first, second), (10, 20), strict=True):
        ours[frame.instance_id == node.instance_id] = value
    assert (ours != theirs[..., 0]).mean() < 1e-3
    assert {0, 10, 20} <= set(np.unique(ours).tolist())


def depth_alone(both):
    both.add(BALL)
    both.check(both.pyrender.RenderFlags.DEPTH_ONLY, depth_only=True)


def flat(both):
    both.add(BALL)
    # Base colours as they are, which pyrender does not encode.
    both.check(both.pyrender.RenderFlags.FLAT, shading="flat", transfer="linear")


def back_faces(both):
    half = trimesh.Trimesh(BALL.vertices, BALL.faces[BALL.triangles_center[:, 2] < 0.0])
    theirs, ours = both.add(half)
    assert not both.render()[2].depth[90, 120]
    ours.material = nrs.Material(
        base_color=(0.8, 0.5, 0.3), metallic=0.1, roughness=0.6, smooth=False, double_sided=True
    )
    assert theirs is not None
    _, depth, frame = both.render(both.pyrender.RenderFlags.SKIP_CULL_FACES)
    assert ((frame.depth > 0) != (depth > 0)).mean() < 1e-3
    assert depth[90, 120] > 0.0
    assert frame.depth[90, 120] == pytest.approx(depth[90, 120], abs=1e-3)


def alpha(both):
    both.add(BALL)
    color, depth, frame = both.render(both.pyrender.RenderFlags.RGBA)
    # On OSMesa it has no alpha, and nothing but its meshes that could have.
    theirs = color[..., 3] > 0 if color.shape[2] == 4 else depth > 0
    assert (theirs != (frame.rgba[..., 3] > 0)).mean() < 1e-3
    np.testing.assert_array_equal(
        frame.rgba[theirs & (frame.depth > 0)][:, :3], frame.color[theirs & (frame.depth > 0)]
    )


def viewer(both):
    both.add(BALL)
    with nrs.Viewer(both.ours) as shown:
        assert shown.image().any()


ROWS = {
    "Scene(ambient_light=, bg_color=)": scene,
    "Mesh.from_trimesh(tm), scene.add(mesh, pose=)": adding,
    "Mesh.from_trimesh(tm, poses=poses)": instances,
    "scene.set_pose(node, pose)": moving,
    "scene.remove_node(node)": removing,
    "mesh.is_visible = False": hiding,
    "a new Mesh in every frame": new_vertices,
    "Mesh.from_points(points, colors=), OffscreenRenderer(point_size=)": points,
    "Primitive(positions, mode=1): lines, loops and strips": lines,
    "RenderFlags.ALL_WIREFRAME": wireframe,
    'MetallicRoughnessMaterial(baseColorFactor=, alphaMode="BLEND")': blending,
    "PerspectiveCamera, IntrinsicsCamera, OrthographicCamera": cameras,
    "DirectionalLight, PointLight, SpotLight": lights,
    "RenderFlags.SHADOWS_ALL": shadows,
    "RenderFlags.SEG, seg_node_map": segmentation,
    "RenderFlags.DEPTH_ONLY": depth_alone,
    "RenderFlags.FLAT": flat,
    "RenderFlags.SKIP_CULL_FACES": back_faces,
    "RenderFlags.RGBA": alpha,
    "Viewer(scene)": viewer,
}


def test_every_row_of_the_table_is_tested():
    text = GUIDE.read_text(encoding="utf-8")
    table = re.search(r"\| pyrender \| here \|\n\|---\|---\|\n(.*?)\n\n", text, re.DOTALL)
    rows = [re.split(r"(?<!\\)\|", row)[1].strip().replace("`", "") for row in table[1].splitlines()]
    assert rows == list(ROWS)


@pytest.mark.parametrize("row", ROWS)
def test_both_draw_the_same(row):
    ROWS[row](Both(picture.import_pyrender()))
