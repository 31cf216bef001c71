"""Scenes from files and trimesh objects: OBJ with MTL, materials of trimesh, and what comes out of `load_scene`."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image as Pillow

import nanite_rs as nrs
from nanite_rs.assets import read_asset
from oracles import data
from oracles.documents import QUAD, Document, png

RNG = np.random.default_rng(9)
PIXELS = RNG.integers(0, 256, (4, 8, 3), dtype=np.uint8)

OBJ = """
mtllib looks.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 0
v 2 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl red
f 1/1 2/2 3/3
f 1/1 3/3 4/4
usemtl painted
f 2/1 5/2 6/3
f 2/1 6/3 3/4
"""


def write(folder, mtl: str, obj: str = OBJ):
    (folder / "looks.mtl").write_text(mtl)
    (folder / "a.obj").write_text(obj)
    return folder / "a.obj"


def looks(asset) -> dict[float, nrs.Material]:
    """Materials by where their surface begins along x."""
    parts = [part for mesh in asset.meshes for part in mesh]
    return {float(part.source.vertices[:, 0].min()): part.material for part in parts}


# ------------------------------------------------------------------------------------------------------------ OBJ


def test_obj_with_two_materials(tmp_path) -> None:
    (tmp_path / "maps").mkdir()
    Pillow.fromarray(PIXELS).save(tmp_path / "maps" / "some wood.png")
    mtl = (
        "newmtl red\nKd 0.9 0.1 0.2\nNs 96\nKe 1 2 3\nnewmtl painted\nKd 1 1 1\nmap_Kd maps\\some wood.png\n"
    )
    asset = read_asset(write(tmp_path, mtl))
    found = looks(asset)
    assert found[0.0].base_color == pytest.approx((0.9, 0.1, 0.2))
    assert found[0.0].roughness == pytest.approx((2 / 98) ** 0.25)
    assert found[0.0].emissive == (1.0, 2.0, 3.0)
    assert found[0.0].metallic == 0.0
    assert np.array_equal(found[1.0].base_color_texture.image.pixels, PIXELS)
    part = next(p for mesh in asset.meshes for p in mesh if p.material is found[1.0])
    # OBJ counts v from below, as textures here do.
    corner = np.flatnonzero((part.source.vertices == [1, 0, 0]).all(axis=1))
    assert np.array_equal(part.source.uvs[0][corner[0]], [0, 0])
    assert not str(asset.notes)


def test_options_of_maps(tmp_path) -> None:
    Pillow.fromarray(PIXELS).save(tmp_path / "a.png")
    mtl = "newmtl red\nmap_Kd -s 2 3 1 -o 0.25 0.5 -clamp on -bm 1.0 a.png\nnewmtl painted\nmap_Ke a.png\n"
    found = looks(read_asset(write(tmp_path, mtl)))
    texture = found[0.0].base_color_texture
    assert texture.wrap == ("clamp", "clamp")
    assert found[0.0].base_color == (1.0, 1.0, 1.0)
    assert found[1.0].emissive == (1.0, 1.0, 1.0)
    # uv · s + o from below is what counts.
    for u, v in RNG.random((5, 2)):
        assert np.allclose(np.array(texture._rows()) @ [u, v, 1.0], [2 * u + 0.25, 1.0 - (3 * v + 0.5)])


def test_maps_of_holes(tmp_path) -> None:
    holes = RNG.integers(0, 256, (4, 8), dtype=np.uint8)
    Pillow.fromarray(PIXELS).save(tmp_path / "a.png")
    Pillow.fromarray(holes).save(tmp_path / "holes.png")
    Pillow.fromarray(np.dstack([PIXELS, holes])).save(tmp_path / "both.png")
    mtl = "newmtl red\nmap_Kd a.png\nmap_d holes.png\nnewmtl painted\nmap_Kd both.png\nmap_d both.png\n"
    for material in looks(read_asset(write(tmp_path, mtl))).values():
        assert material.alpha_mode == "mask"
        assert np.array_equal(material.base_color_texture.image.pixels, np.dstack([PIXELS, holes]))


@pytest.mark.parametrize(
    ("line", "alpha", "mode"),
    [("d 0.25", 0.25, "blend"), ("Tr 0.75", 0.25, "blend"), ("Tr 1", 1.0, "opaque")],
)
def test_transparency(tmp_path, line, alpha, mode) -> None:
    asset = read_asset(write(tmp_path, f"newmtl red\n{line}\nnewmtl painted\n"))
    material = looks(asset)[0.0]
    assert (*material.base_color, 1.0)[3] == alpha
    assert material.alpha_mode == mode


def test_missing_and_bad_files_of_obj(tmp_path) -> None:
    path = write(tmp_path, "newmtl red\nmap_Kd none.png\nnewmtl painted\nKd 1 0 0\n")
    with pytest.raises(nrs.MissingFileError, match=r"a\.obj: material 'red': map_kd: .*none\.png"):
        read_asset(path)
    asset = read_asset(path, drop_bad_textures=True)
    assert looks(asset)[0.0].base_color_texture is None
    assert "cannot be read" in str(asset.notes)
    (tmp_path / "none.png").write_bytes(png(PIXELS)[:50])
    with pytest.raises(nrs.FormatError, match=r"a\.obj: material 'red': map_kd: .*none\.png"):
        read_asset(path)
    with pytest.raises(nrs.FormatError, match=r"material 'red': kd: expected 3 numbers"):
        read_asset(write(tmp_path, "newmtl red\nKd one 2\n"))
    (tmp_path / "looks.mtl").unlink()
    asset = read_asset(path)
    assert str(asset.notes) == "materials of files that are missing (looks.mtl)"
    assert all(isinstance(material, nrs.Material) for material in looks(asset).values())


def test_a_real_obj(tmp_path) -> None:
    path = data.require("nasty", "capsule", "capsule.obj")
    ((part,),) = read_asset(path).meshes
    assert np.array_equal(
        part.material.base_color_texture.image.pixels, np.asarray(Pillow.open(path.with_name("capsule0.jpg")))
    )
    theirs = trimesh.load_mesh(path, process=False)
    assert np.allclose(part.source.uvs[0], theirs.visual.uv)
    spider = data.require("nasty", "spider", "spider.obj")
    with pytest.raises(nrs.MissingFileError, match="wal67ar_small"):
        nrs.load_scene(spider)
    with pytest.warns(UserWarning, match="cannot be read") as caught:
        loaded = nrs.load_scene(spider, bad_textures="drop")
    assert len(caught) == 1
    assert sum(len(own) for own in loaded.instances.values()) == len(loaded.scene)


# -------------------------------------------------------------------------------------------------------- trimesh


def test_trimesh_scenes_keep_their_textures() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    image = Pillow.fromarray(PIXELS)
    pbr = trimesh.visual.material.PBRMaterial(
        name="wood",
        baseColorFactor=[0.5, 0.25, 1.0, 1.0],
        baseColorTexture=image,
        normalTexture=image,
        roughnessFactor=0.25,
        emissiveFactor=[0.1, 0.2, 0.3],
        alphaMode="MASK",
        alphaCutoff=0.75,
        doubleSided=True,
    )
    ball.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2], material=pbr)
    simple = trimesh.creation.box()
    simple.visual = trimesh.visual.TextureVisuals(
        uv=simple.vertices[:, :2],
        material=trimesh.visual.material.SimpleMaterial(image=image, diffuse=[255, 0, 51], glossiness=98.0),
    )
    scene = trimesh.Scene({"ball": ball, "box": simple})
    scene.add_geometry(
        ball, node_name="again", transform=trimesh.transformations.translation_matrix([3, 0, 0])
    )
    loaded = nrs.load_scene(scene)
    assert len(loaded.scene) == 3
    first = loaded.instances["ball"][0].material
    assert first.base_color == pytest.approx((0.5, 0.25, 1.0), abs=1 / 255)
    assert (first.metallic, first.roughness) == (1.0, 0.25)
    assert first.emissive == pytest.approx((0.1, 0.2, 0.3))
    assert (first.alpha_mode, first.alpha_cutoff, first.double_sided) == ("mask", 0.75, True)
    assert first.base_color_texture.image is first.normal_texture.image
    assert np.array_equal(first.normal_texture.image.pixels, PIXELS)
    box = loaded.instances["box"][0].material
    assert box.base_color == pytest.approx((1.0, 0.0, 0.2))
    assert box.roughness == pytest.approx((2 / 100) ** 0.25)
    assert np.array_equal(box.base_color_texture.image.pixels, PIXELS)
    assert np.allclose(loaded.instances["again"][0].pose[:3, 3], [3, 0, 0])


def test_several_materials_of_one_mesh() -> None:
    box = trimesh.creation.box()
    numbers = np.arange(12) % 3
    several = trimesh.visual.material.MultiMaterial(
        [trimesh.visual.material.PBRMaterial(baseColorFactor=[k, 0, 0, 255]) for k in (0, 51, 102)]
    )
    box.visual = trimesh.visual.TextureVisuals(
        uv=box.vertices[:, :2], material=several, face_materials=numbers
    )
    loaded = nrs.load_scene(box, virtual="always")
    (node,) = loaded.instances["mesh"]
    assert sorted(node.mesh.cut(error=0.0).face_materials) == sorted(numbers)
    materials = node.material
    assert [material.base_color[0] for material in materials] == pytest.approx([0.0, 0.2, 0.4])


def test_vertex_colors_are_on_white() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.visual.vertex_colors = RNG.integers(0, 255, (len(ball.vertices), 4), dtype=np.uint8)
    (node,) = nrs.load_scene(ball, virtual="always").instances["mesh"]
    assert node.material.base_color == (1.0, 1.0, 1.0)
    assert node.mesh.cut(error=0.0).colors is not None


def test_colors_that_are_all_white_are_dropped(tmp_path) -> None:
    document = Document()
    for color in (255, 254):
        primitive = document.quad()
        colors = np.full((4, 4), 255, np.uint8)
        colors[0, 0] = color
        primitive["attributes"]["COLOR_0"] = document.accessor(colors, normalized=True)
        document.mesh(primitive, name=str(color))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"), virtual="always")
    assert loaded.instances["255"][0].mesh.cut(error=0.0).colors is None
    assert loaded.instances["254"][0].mesh.cut(error=0.0).colors is not None


def test_cameras_of_trimesh() -> None:
    scene = trimesh.Scene(trimesh.creation.box())
    scene.set_camera(angles=(0.3, 0.2, 0.1), distance=5.0, fov=(60.0, 45.0))
    loaded = nrs.load_scene(scene)
    ((camera, pose),) = loaded.cameras
    assert camera.yfov == pytest.approx(np.radians(45.0))
    assert np.allclose(pose, scene.camera_transform)


# ----------------------------------------------------------------------------------------------------- what is made


@pytest.fixture
def street(tmp_path):
    """Two nodes of one mesh of two primitives, one flattened to nothing, a light and a camera."""
    document = Document()
    document.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 3.0}]}
    }
    document.row(
        "materials",
        name="glass",
        alphaMode="BLEND",
        pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.3]},
    )
    document.mesh(document.quad(), document.quad(material=0), name="house")
    document.row("nodes", mesh=0, name="house", translation=[3, 0, 0])
    document.row("nodes", mesh=0, name="shadow", scale=[1, 0, 1])
    document.row("nodes", name="sun", extensions={"KHR_lights_punctual": {"light": 0}})
    document.row("cameras", type="perspective", perspective={"yfov": 0.9, "znear": 0.1})
    document.row("nodes", camera=0, translation=[2, 0.5, 5])
    return document.save(tmp_path / "street.glb")


def test_a_scene_from_a_file(street) -> None:
    with pytest.warns(UserWarning, match=r"street\.glb: not everything is kept") as caught:
        loaded = nrs.load_scene(street)
    (warning,) = caught
    assert "nodes flattened to nothing (shadow)" in str(warning.message)
    assert warning.filename == __file__
    assert list(loaded.instances) == ["house", "house_1"]
    first, second = loaded.instances["house"], loaded.instances["house_1"]
    assert first[0].mesh is second[0].mesh
    assert first[1].mesh is second[1].mesh
    assert np.array_equal(second[0].pose[:3, 3], [3, 0, 0])
    assert [light.light.intensity for light in loaded.lights] == [3.0]
    assert np.array_equal(loaded.bounds, [[0, 0, 0], [4, 1, 0]])
    assert "4 instances of 2 meshes, 0 virtual, 1 lights, 1 cameras" in repr(loaded)
    scene, camera, pose = loaded
    assert scene is loaded.scene
    assert camera.yfov == 0.9
    assert np.array_equal(pose[:3, 3], [2, 0.5, 5])
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frame = renderer.render(*loaded)
    ids = set(np.unique(frame.instance_id[frame.depth > 0]).tolist())
    assert ids <= {node.instance_id for own in loaded.instances.values() for node in own}
    assert len(ids) >= 2


def test_scenes_are_added_to(street) -> None:
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(2):
            assert nrs.load_scene(street, scene=scene).scene is scene
    assert len(scene) == 8


def test_scenes_are_left_as_they_were_where_loading_fails(tmp_path, monkeypatch) -> None:
    """The first mesh is in the scene when the second one cannot be built."""
    document = Document()
    document.mesh(document.quad())
    holed = document.quad()
    holed["attributes"]["POSITION"] = document.accessor(np.where(QUAD == 0, np.nan, QUAD).astype(np.float32))
    document.mesh(holed)
    document.row("nodes", mesh=0)
    document.row("nodes", mesh=1)
    scene = nrs.Scene()
    added = []
    add = nrs.Scene.add
    monkeypatch.setattr(
        nrs.Scene, "add", lambda *args, **kwargs: added.append(add(*args, **kwargs)) or added[-1]
    )
    with pytest.raises(nrs.MeshError, match="not finite"):
        nrs.load_scene(document.save(tmp_path / "a.glb"), scene=scene)
    assert len(added) == 1
    assert len(scene) == 0


def test_lights_out_of_range_are_named_with_their_file(tmp_path) -> None:
    document = Document()
    document.mesh(document.quad())
    document.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 1e39}]}
    }
    document.row("nodes", mesh=0)
    document.row("nodes", name="sun", extensions={"KHR_lights_punctual": {"light": 0}})
    with pytest.raises(nrs.ArgumentError, match=r"a\.glb: light: intensity"):
        nrs.load_scene(document.save(tmp_path / "a.glb"))


def test_materials_that_cannot_be_are_named_with_their_file(tmp_path) -> None:
    document = Document()
    document.row("materials", name="lamp", emissiveFactor=[1e39, 0, 0])
    document.mesh(document.quad(), document.quad(material=0))
    with pytest.raises(nrs.ArgumentError, match=r"a\.glb: material 'lamp': emissive: must be finite"):
        nrs.load_scene(document.save(tmp_path / "a.glb"))
    (tmp_path / "b.mtl").write_text("newmtl lamp\nKe 1e39 0 0\n")
    (tmp_path / "b.obj").write_text("mtllib b.mtl\nusemtl lamp\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(nrs.ArgumentError, match=r"b\.obj: material 'lamp': emissive: must be finite"):
        nrs.load_scene(tmp_path / "b.obj")
    box = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(name="lamp", emissiveFactor=[np.inf, 0, 0])
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    with pytest.raises(nrs.ArgumentError, match=r"trimesh scene: material 'lamp': emissive: must be finite"):
        nrs.load_scene(box)


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 1), (0, 1, 0), (0, -1, 0)])
def test_views_see_everything(direction) -> None:
    boxes = trimesh.Scene(
        [
            trimesh.creation.box(transform=trimesh.transformations.translation_matrix([k, 0, 2 * k]))
            for k in range(4)
        ]
    )
    loaded = nrs.load_scene(boxes)
    camera, pose = loaded.view(direction)
    with nrs.Renderer(96, 64, backend="cpu") as renderer:
        covered = renderer.render(loaded.scene, camera, pose).depth > 0
    assert covered.any()
    assert not covered[[0, -1]].any()
    assert not covered[:, [0, -1]].any()


def test_options_reach_the_build(tmp_path) -> None:
    path = tmp_path / "ball.glb"
    trimesh.creation.icosphere(subdivisions=4).export(path)
    (few,) = nrs.load_scene(path, options=nrs.BuildOptions(cluster_triangles=32)).instances.values()
    (many,) = nrs.load_scene(path, virtual="always").instances.values()
    assert few[0].mesh.report.clusters > many[0].mesh.report.clusters


def test_built_meshes_are_scenes_too(tmp_path) -> None:
    nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000)).save(tmp_path / "ball.nanite")
    loaded = nrs.load_scene(tmp_path / "ball.nanite")
    assert len(loaded.instances["ball"][0].mesh) == 2_000


def test_what_cannot_be_loaded(tmp_path) -> None:
    for source in (None, 3, trimesh.path.Path2D()):
        with pytest.raises(nrs.DtypeError, match="source: expected a path, an open binary file or bytes"):
            nrs.load_scene(source)
    with pytest.raises(nrs.ArgumentError, match="bad_textures"):
        nrs.load_scene("a.glb", bad_textures="maybe")
    with pytest.raises(nrs.MissingFileError, match=r"none\.glb"):
        nrs.load_scene(tmp_path / "none.glb")
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(nrs.FileError, match="directory"):
        nrs.load_scene(tmp_path / "folder.glb")
    (tmp_path / "a.xyzw").write_bytes(b"x")
    with pytest.raises(nrs.FormatError, match=r"extension \.xyzw is unknown"):
        nrs.load_scene(tmp_path / "a.xyzw")
    (tmp_path / "a.glb.gz").write_bytes(b"x")
    with pytest.raises(nrs.FormatError, match="cannot be unpacked"):
        nrs.load_scene(tmp_path / "a.glb.gz")
    Document().save(tmp_path / "empty.gltf")
    with pytest.raises(nrs.MeshError, match=r"empty\.gltf: there are no triangles"):
        nrs.load_scene(tmp_path / "empty.gltf")
    document = Document()
    primitive = document.quad()
    primitive["attributes"]["POSITION"] = document.accessor(
        np.where(QUAD == 1, np.nan, QUAD).astype(np.float32)
    )
    document.mesh(primitive)
    with pytest.raises(nrs.MeshError, match=r"nan\.glb: meshes\[0\], primitive 0: vertices"):
        nrs.load_scene(document.save(tmp_path / "nan.glb"))


def test_small_meshes_are_ordinary_ones() -> None:
    parts = trimesh.Scene()
    large, small = trimesh.creation.icosphere(subdivisions=6), trimesh.creation.icosphere(subdivisions=3)
    parts.add_geometry(large, node_name="large")
    parts.add_geometry(small, node_name="small", geom_name="small")
    for k in range(20):
        parts.graph.update(frame_to=f"small {k}", geometry="small", matrix=np.eye(4))
    kinds = {}
    for virtual, options in (
        ("auto", None),
        ("always", None),
        ("never", None),
        ("auto", nrs.BuildOptions(error="quadric")),
    ):
        loaded = nrs.load_scene(parts, virtual=virtual, options=options, progress=False)
        of = {type(node.mesh) for name, own in loaded.instances.items() if name != "large" for node in own}
        kinds[virtual, options is None] = {type(loaded.instances["large"][0].mesh)}, of
    both = {nrs.NaniteMesh}, {nrs.NaniteMesh}
    assert kinds["auto", True][0] == {nrs.NaniteMesh}
    assert kinds["always", True] == kinds["auto", False] == both
    assert kinds["never", True] == ({nrs.TriangleMesh}, {nrs.TriangleMesh})
    one = nrs.load_scene(small)
    assert "1 meshes, 0 virtual" in repr(one)
    assert len(one.instances["mesh"][0].mesh.cut(error=0.0)) == len(small.faces)
    # 1,280 triangles twenty times are many, once they are few.
    assert kinds["auto", True][1] == {nrs.NaniteMesh}
    with pytest.raises(nrs.ArgumentError, match=r'^virtual: must be "auto", "always" or "never"'):
        nrs.load_scene(small, virtual="sometimes")
