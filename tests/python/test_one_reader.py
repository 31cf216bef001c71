"""`from_file` is `load_scene` flattened: the same readers, whatever is given to read, and materials that stay."""

from __future__ import annotations

import gzip
import io
import os
import pickle
import warnings

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles.documents import QUAD, QUAD_FACES, Document

N = 9
X, Y = (side.ravel() for side in np.meshgrid(*[np.linspace(0, 1, N)] * 2))
GRID = np.stack([X, Y, 0 * X], 1).astype(np.float32)
FIRST = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).reshape(-1, 1)
FACES = np.add(FIRST, [0, 1, N + 1, 0, N + 1, N]).reshape(-1, 3)


def grid(document: Document, **attributes: int) -> dict:
    return {
        "attributes": {"POSITION": document.accessor(GRID), **attributes},
        "indices": document.accessor(FACES.reshape(-1).astype(np.uint16)),
    }


def both(path) -> list[nrs.Cut]:
    """Full detail by either way; of a scene all instances as one."""
    loaded = nrs.load_scene(path, virtual="always")
    nodes = [node for own in loaded.instances.values() for node in own]
    return [nrs.NaniteMesh.from_file(path).cut(error=0), nodes[0].mesh.cut(error=0)]


# ------------------------------------------------------------------------------------------------------------ glTF


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("columns", [3, 4])
@pytest.mark.parametrize("said", [True, False])
def test_colours_of_every_type(tmp_path, kind, columns, said) -> None:
    """Integers of colours are of a fixed point, whether the accessor says so or not."""
    wanted = np.stack([X, Y, 1 - X, 0.5 + Y / 2], 1)[:, :columns]
    stored = wanted.astype(np.float32) if kind is np.float32 else np.rint(wanted * np.iinfo(kind).max)
    document = Document()
    colors = document.accessor(stored.astype(kind), normalized=said and kind is not np.float32)
    document.mesh(grid(document, COLOR_0=colors) | {"material": document.row("materials", name="any")})
    for cut in both(document.save(tmp_path / "a.glb")):
        x, y = cut.vertices[:, 0], cut.vertices[:, 1]
        expected = np.stack([x, y, 1 - x, 0.5 + y / 2], 1)[:, :columns]
        assert np.abs(cut.colors[:, :columns] - 255 * expected).max() <= 0.51
        assert cut.fine_colors.dtype == kind
        white = 1.0 if kind is np.float32 else np.iinfo(kind).max
        assert np.abs(cut.fine_colors[:, :columns] / white - expected).max() <= 0.51 / white
        assert "COLOR_0" not in cut.channels


def test_further_uv_sets_keep_their_numbers(tmp_path) -> None:
    document = Document()
    uv = document.accessor(np.stack([X, 1 - Y], 1).astype(np.float32))
    document.mesh(grid(document, TEXCOORD_2=uv, TEXCOORD_5=uv))
    with pytest.warns(UserWarning, match=r"attributes of vertices \(TEXCOORD_5\)"):
        cuts = both(document.save(tmp_path / "a.glb"))
    for cut in cuts:
        assert len(cut.uvs) == 3
        assert np.allclose(cut.uvs[2], cut.vertices[:, :2], atol=1e-6)


def test_sparse_and_quantized_positions_and_strips(tmp_path) -> None:
    document = Document()
    corners = np.array([[0, 0, 0], [127, 0, 0], [0, 127, 0], [127, 127, 0]], np.int8)
    moved = (np.array([3], np.uint8), np.array([[127, 127, 127]], np.int8))
    position = document.accessor(corners, normalized=True, sparse=moved, stride=4)
    document.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    document.mesh({"attributes": {"POSITION": position}, "mode": 5}, scale=[2, 2, 2])
    path = document.save(tmp_path / "a.glb")
    cut = nrs.NaniteMesh.from_file(path).cut(error=0)
    assert sorted(map(tuple, cut.vertices.tolist())) == [(0, 0, 0), (0, 2, 0), (2, 0, 0), (2, 2, 2)]
    across = np.cross(*(cut.vertices[cut.faces][:, k] - cut.vertices[cut.faces][:, 0] for k in (1, 2)))
    assert (across[:, 2] > 0).all()


def test_all_instances_are_there(tmp_path) -> None:
    """Nodes, nodes below nodes, mirrored ones, and those of EXT_mesh_gpu_instancing."""
    box = trimesh.creation.box()
    document = Document()
    primitive = {
        "attributes": {"POSITION": document.accessor(box.vertices.astype(np.float32))},
        "indices": document.accessor(box.faces.reshape(-1).astype(np.uint16)),
    }
    places = np.array([[0, 0, 0], [5, 0, 0]], np.float32)
    sizes = np.array([[-1, 2, 1.5], [1, 1, 1]], np.float32)
    instancing = {"TRANSLATION": document.accessor(places), "SCALE": document.accessor(sizes)}
    document.mesh(primitive, extensions={"EXT_mesh_gpu_instancing": {"attributes": instancing}})
    document.row("nodes", mesh=0, translation=[0, 9, 0], scale=[1, -1, 2])
    document.row("nodes", children=[1], translation=[0, 0, 20])
    document.json["scenes"] = [{"nodes": [0, 2]}]
    mesh = nrs.NaniteMesh.from_file(document.save(tmp_path / "a.glb"))
    assert len(mesh) == 3 * 12
    assert mesh.cut(error=0).to_trimesh().volume == pytest.approx(3.0 + 1.0 + 2.0)
    assert np.allclose(mesh.bounds, [[-0.5, -1, -0.75], [5.5, 9.5, 21]])


@pytest.mark.parametrize("read", [nrs.load_scene, nrs.NaniteMesh.from_file])
def test_required_extensions_are_refused_by_name(tmp_path, read) -> None:
    document = Document()
    document.mesh(document.quad())
    document.json["extensionsRequired"] = ["EXT_of_tomorrow"]
    with pytest.raises(nrs.FormatError, match=r"a\.glb: it requires EXT_of_tomorrow"):
        read(document.save(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    ("of_mesh", "of_node", "low"),
    [
        ([0.5, 0.25], None, [1.25, 0, 1]),
        ([0.5, 0.25], [0, 0.5], [2.5, 0, 0]),
        (None, [1, 0], [0, 0, 2]),
        ([1, 0], [0, 0], [0, 0, 0]),
    ],
)
def test_morph_targets_at_rest(tmp_path, of_mesh, of_node, low) -> None:
    """Those of the node go before those of the mesh; two nodes of one mesh may differ."""
    document = Document()
    primitive = document.quad()
    primitive["attributes"]["NORMAL"] = document.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    up = document.accessor(np.tile(np.float32([0, 0, 2]), (4, 1)))
    turned = document.accessor(np.tile(np.float32([0, 1, -1]), (4, 1)))
    sparse = np.arange(4, dtype=np.uint8), np.tile(np.float32([5, 0, 0]), (4, 1))
    aside = document.accessor(np.zeros((4, 3), np.float32), stored=False, sparse=sparse)
    primitive["targets"] = [{"POSITION": up, "NORMAL": turned}, {"POSITION": aside}]
    document.mesh(primitive, **({} if of_node is None else {"weights": of_node}))
    if of_mesh is not None:
        document.json["meshes"][0]["weights"] = of_mesh
    document.row("nodes", mesh=0, translation=[100, 0, 0], weights=[0, 0])
    path = document.save(tmp_path / "a.glb")
    first, second = nrs.load_scene(path).instances.values()
    assert np.allclose(first[0].mesh.bounds[0], low)
    assert np.allclose(second[0].mesh.bounds, [[0, 0, 0], [1, 1, 0]])
    cut = nrs.NaniteMesh.from_file(path).cut(error=0)
    moved = cut.vertices[:, 0] < 50
    assert np.allclose(cut.vertices[moved].min(axis=0), low)
    assert np.allclose(cut.vertices[~moved].min(axis=0), [100, 0, 0])
    if low == [0, 0, 2]:
        assert np.allclose(cut.normals[moved], [0, 1, 0], atol=1e-6)


@pytest.mark.parametrize("required", [False, True])
def test_the_centre_of_cesium(tmp_path, required) -> None:
    centre = [1215013.8, -4736315.9, 4081603.8]
    document = Document()
    document.mesh(document.quad(), translation=[0, 0, 7])
    document.json["extensions"] = {"CESIUM_RTC": {"center": centre}}
    document.json["extensionsRequired" if required else "extensionsUsed"] = ["CESIUM_RTC"]
    path = document.save(tmp_path / "a.glb")
    low = np.add(centre, [0, 0, 7])
    for bounds in (nrs.load_scene(path).bounds, nrs.NaniteMesh.from_file(path).bounds):
        assert np.allclose(bounds[0], low, atol=1e-6)
        assert np.allclose(bounds[1] - bounds[0], [1, 1, 0], atol=1e-6)


def test_dracos_numbers_have_the_type_of_their_accessor(tmp_path) -> None:
    """The decoder makes 32 bits of 16: white would come out black."""
    draco = pytest.importorskip("DracoPy")
    extra = {
        "color": np.stack([X, Y, 1 - X, 0 * X + 1], 1) * 65535,
        "id": np.arange(N * N)[:, None] * 1.0,
    }
    short = {name: np.rint(values).astype(np.uint16) for name, values in extra.items()}
    packed = draco.encode(GRID, FACES, preserve_order=True, generic_attributes=short)
    # Generic attributes come first, in their order.
    document = Document()
    view = document.view(packed)
    count = len(draco.decode(packed).points)
    accessors = [
        document.row("accessors", componentType=kind, count=count, type=width, **more)
        for kind, width, more in (
            (5126, "VEC3", {}),
            (5123, "VEC4", {"normalized": True}),
            (5123, "SCALAR", {}),
            (5125, "SCALAR", {}),
        )
    ]
    document.json["accessors"][3]["count"] = FACES.size
    extension = {"bufferView": view, "attributes": {"POSITION": 2, "COLOR_0": 0, "_FEATURE_ID_0": 1}}
    document.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    document.mesh(
        {
            "attributes": dict(zip(("POSITION", "COLOR_0", "_FEATURE_ID_0"), accessors, strict=False)),
            "indices": accessors[3],
            "extensions": {"KHR_draco_mesh_compression": extension},
        }
    )
    for cut in both(document.save(tmp_path / "a.glb")):
        x, y = cut.vertices[:, 0], cut.vertices[:, 1]
        assert cut.fine_colors.dtype == np.uint16
        assert np.abs(cut.fine_colors / 65535 - np.stack([x, y, 1 - x, 0 * x + 1], 1)).max() < 1e-4
        assert cut.channels["_FEATURE_ID_0"].dtype == np.uint16
        assert np.array_equal(cut.channels["_FEATURE_ID_0"], np.rint(x * 8 + y * 72))


@pytest.mark.parametrize(
    ("name", "is_label"),
    [("_BATCHID", True), ("_FEATURE_ID_3", True), ("_object_id", True), ("_LABEL", True), ("_WIDTH", False)],
)
def test_ids_stored_as_floats_are_labels(tmp_path, name, is_label) -> None:
    document = Document()
    ids = document.accessor(np.repeat(np.float32([1000, 1007, 1020]), N * N // 3))
    document.mesh(grid(document, **{name: ids}))
    for cut in both(document.save(tmp_path / "a.glb")):
        assert cut.channels[name].dtype == (np.int32 if is_label else np.float32)
        assert set(cut.channels[name].tolist()) == {1000, 1007, 1020}


def test_what_is_not_kept_is_named(tmp_path) -> None:
    document = Document()
    primitive = document.quad()
    primitive["attributes"]["COLOR_1"] = document.accessor(np.ones((4, 4), np.float32))
    skin = document.row("skins", joints=[0])
    document.mesh(primitive, document.quad(mode=1))
    document.json["extensionsUsed"] = ["EXT_of_tomorrow", "EXT_mesh_features", "KHR_texture_transform"]
    nothing = {"POSITION": primitive["attributes"]["POSITION"]}
    document.row("nodes", mesh=document.row("meshes", primitives=[{"attributes": nothing}]))
    document.json["scenes"] = [{"nodes": [0]}, {"nodes": [1], "name": "night"}]
    turns = {"TRANSLATION": document.accessor(np.zeros((1, 3), np.float32)), "_TREE": 0}
    document.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": turns}}
    document.json["nodes"][1]["skin"] = skin
    document.json["scenes"][0]["nodes"] = [0, 1]
    document.json["scenes"][1]["nodes"] = [0]
    document.row(
        "animations", name="walk", channels=[{"target": {"path": "pointer"}, "sampler": 0}], samplers=[]
    )
    path = document.save(tmp_path / "a.glb")
    for read in (nrs.load_scene, nrs.NaniteMesh.from_file):
        with pytest.warns(UserWarning, match=r"a\.glb: not everything is kept") as caught:
            read(path)
        (warning,) = caught
        assert warning.filename == __file__
        for text in (
            "extensions (EXT_of_tomorrow)",
            "scenes besides the default one (night)",
            "attributes of instances (_TREE)",
            "animated properties (walk: pointer)",
            "vertices (COLOR_1)",
        ):
            assert text in str(warning.message)
        played = read is nrs.load_scene
        assert ("points and lines" in str(warning.message)) != played
        assert ("animations, which are not played (walk)" in str(warning.message)) != played


# --------------------------------------------------------------------------------------------------------- COLLADA

COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>
<unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g" name="g"><mesh><source id="p">
<float_array id="pa" count="9">0 0 0 1 0 0 0 0 2</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


@pytest.mark.parametrize(
    ("unit", "up", "corners"),
    [
        (1, "Y_UP", [[5, 0, 0], [6, 0, 2]]),
        (0.01, "Y_UP", [[0.05, 0, 0], [0.06, 0, 0.02]]),
        (1, "Z_UP", [[5, 0, 0], [6, 2, 0]]),
        (1, "X_UP", [[0, 5, 0], [0, 6, 2]]),
    ],
)
def test_units_and_axes_of_collada(tmp_path, unit, up, corners) -> None:
    pytest.importorskip("collada")
    path = tmp_path / "a.dae"
    path.write_text(COLLADA.format(unit=unit, up=up))
    assert np.allclose(nrs.NaniteMesh.from_file(path).bounds, corners)
    assert np.allclose(nrs.load_scene(path).bounds, corners)


def test_collada_without_its_package_says_what_to_install(tmp_path, monkeypatch) -> None:
    without = set(trimesh.available_formats()) - {"dae", "zae"}
    monkeypatch.setattr(trimesh, "available_formats", lambda: without)
    (tmp_path / "a.dae").write_text(COLLADA.format(unit=1, up="Y_UP"))
    with pytest.raises(nrs.DependencyError, match=r"a\.dae: collada is needed; pip install pycollada"):
        nrs.NaniteMesh.from_file(tmp_path / "a.dae")


# --------------------------------------------------------------------------------------------------- what is given


@pytest.fixture
def ball(tmp_path):
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.glb")
    return tmp_path / "ball.glb"


def test_every_kind_of_path_and_content(ball) -> None:
    data = ball.read_bytes()

    class Place:
        def __fspath__(self) -> bytes:
            return os.fsencode(ball)

    given = [(str(ball), {}), (os.fsencode(ball), {}), (ball, {}), (Place(), {})]
    given += [(io.BytesIO(data), {}), (io.BytesIO(gzip.compress(data)), {"format": "glb"})]
    given += [
        (kind(data), {"format": form}) for kind in (bytes, bytearray, memoryview) for form in ("glb", ".GLB")
    ]
    given += [(data, {}), (gzip.compress(data), {"format": "glb.gz"})]
    for source, options in given:
        assert len(nrs.NaniteMesh.from_file(source, **options)) == 320
        if isinstance(source, io.BytesIO):
            source.seek(0)
        (own,) = nrs.load_scene(source, **options).instances.values()
        assert len(own[0].mesh) == 320
    with ball.open("rb") as file:
        assert len(nrs.NaniteMesh.from_file(file)) == 320
        file.seek(0)
        assert 0 < len(nrs.decimate(file, 100)) <= 100
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80))
    mesh.save(os.fsencode(ball.with_suffix(".nanite")))
    saved = ball.with_suffix(".nanite").read_bytes()
    assert nrs.NaniteMesh.from_file(saved, format="nanite") == nrs.NaniteMesh.open(
        os.fsencode(ball.with_suffix(".nanite"))
    )


def test_files_beside_an_open_file_are_found(tmp_path) -> None:
    document = Document()
    document.mesh(document.quad())
    path = document.save(tmp_path / "a.gltf")
    with path.open("rb") as file:
        assert len(nrs.NaniteMesh.from_file(file)) == 2
    with pytest.raises(nrs.MissingFileError, match=r"nothing says in which folder.*the%20buffer\.bin"):
        nrs.NaniteMesh.from_file(path.read_bytes(), format="gltf")


@pytest.mark.parametrize(
    ("source", "options", "error", "text"),
    [
        (3, {}, nrs.DtypeError, "expected a path, an open binary file or bytes, not int"),
        (None, {}, nrs.DtypeError, "not NoneType"),
        ([b"x"], {}, nrs.DtypeError, "not list"),
        (np.zeros(3), {}, nrs.DtypeError, "not ndarray"),
        (io.StringIO("solid"), {}, nrs.DtypeError, "mode 'rb'"),
        (io.BytesIO(b"\0\1\2"), {}, nrs.ArgumentError, "give format='glb'"),
        (b"\0\1\2", {}, nrs.ArgumentError, "give format='glb'"),
        (b"\0\1\2", {"format": "glb"}, nrs.FormatError, "bytes: "),
        (b"\0\1\2", {"format": "xyzw"}, nrs.FormatError, r"extension \.xyzw is unknown"),
        (b"\0\1\2", {"format": 3}, nrs.DtypeError, "format: expected an ending"),
        (b"\x1f\x8b12345", {"format": "glb"}, nrs.FormatError, "cannot be unpacked"),
        ("a\0b.glb", {}, nrs.FileError, "Invalid argument"),
        ("", {}, nrs.NaniteError, None),
    ],
)
@pytest.mark.parametrize("read", [nrs.load_scene, nrs.NaniteMesh.from_file])
def test_nothing_else_is_read(read, source, options, error, text) -> None:
    with pytest.raises(error, match=text):
        read(source, **options)


def test_closed_files_and_bad_names(tmp_path) -> None:
    file = io.BytesIO(b"")
    file.close()
    with pytest.raises(nrs.ArgumentError, match="the file cannot be read"):
        nrs.NaniteMesh.from_file(file)
    for call in (nrs.NaniteMesh.open, nrs.NaniteMesh.file_info):
        with pytest.raises(nrs.DtypeError, match="path: expected a path, not int"):
            call(3)
    with pytest.raises(nrs.ArgumentError, match="bad_textures"):
        nrs.NaniteMesh.from_file(tmp_path / "a.glb", bad_textures="maybe")


# ------------------------------------------------------------------------------------------------------- materials


def two_looks(document: Document) -> None:
    """Three primitives of two materials, of which one has a texture."""
    pixels = np.random.default_rng(0).integers(0, 255, (4, 4, 3), dtype=np.uint8)
    texture = {"index": document.texture(pixels)}
    document.row("materials", name="wood", pbrMetallicRoughness={"baseColorTexture": texture})
    document.row("materials", name="lamp", emissiveFactor=[1, 0.5, 0], doubleSided=True)
    for number in (1, 0, 1):
        document.mesh(
            document.quad(material=number), translation=[3 * len(document.json.get("nodes", [])), 0, 0]
        )


def test_materials_stay_with_the_mesh(tmp_path) -> None:
    document = Document()
    two_looks(document)
    path = document.save(tmp_path / "a.glb")
    mesh = nrs.NaniteMesh.from_file(path)
    lamp, wood = mesh.materials
    assert lamp.emissive == (1, 0.5, 0)
    assert lamp.double_sided
    assert wood.base_color_texture.image.size == (4, 4)
    loaded = nrs.load_scene(path)
    assert [own[0].material.emissive for own in loaded.instances.values()] == [
        lamp.emissive,
        (0, 0, 0),
        lamp.emissive,
    ]
    cut = mesh.cut(error=0)
    assert cut.materials == mesh.materials
    middle = cut.vertices[cut.faces].mean(axis=1)[:, 0]
    assert np.array_equal(cut.face_materials == 1, (middle > 2) & (middle < 5))
    assert nrs.decimate(path, 6).materials[0] == lamp
    assert nrs.decimate(cut, 6).materials == mesh.materials
    again = pickle.loads(pickle.dumps(mesh))
    assert again == mesh
    assert [m.emissive for m in again.materials] == [m.emissive for m in mesh.materials]
    assert np.array_equal(
        again.materials[1].base_color_texture.image.pixels, wood.base_color_texture.image.pixels
    )
    assert pickle.loads(pickle.dumps(cut)).materials[0] == lamp


def test_scenes_draw_with_them(tmp_path) -> None:
    document = Document()
    two_looks(document)
    path = document.save(tmp_path / "a.glb")
    mesh, loaded = nrs.NaniteMesh.from_file(path), nrs.load_scene(path)
    scene = nrs.Scene()
    assert scene.add(mesh).material == mesh.materials
    camera, pose = loaded.view()
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        colors = []
        for drawn in (scene, loaded.scene):
            drawn.ambient_light = (0.5, 0.5, 0.5)
            colors.append(renderer.render(drawn, camera, pose, shading="gltf", pixel_error=0).color)
    assert np.abs(colors[0].astype(int) - colors[1]).max() <= 1
    assert scene.add(mesh, material=nrs.Material()).material == nrs.Material()


def test_saving_keeps_materials(tmp_path) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=80)
    plain = nrs.NaniteMesh.from_arrays(vertices, faces)
    assert plain.materials == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain.save(tmp_path / "a.nanite")
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, materials=nrs.Material(metallic=1.0))
    assert mesh.materials == (nrs.Material(metallic=1.0),)
    mesh.save(tmp_path / "b.nanite")
    assert nrs.NaniteMesh.open(tmp_path / "b.nanite").materials == mesh.materials


@pytest.mark.parametrize("wrong", [3, "red", [(1, 0, 0)], [nrs.Material(), None]])
def test_materials_that_are_none(wrong) -> None:
    with pytest.raises(nrs.DtypeError, match="materials: expected a Material"):
        nrs.NaniteMesh.from_arrays(QUAD, QUAD_FACES.reshape(-1, 3), materials=wrong)


def test_materials_of_trimesh() -> None:
    pbr = trimesh.visual.material.PBRMaterial
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=1)
    box.visual = trimesh.visual.TextureVisuals(material=pbr(metallicFactor=0.25))
    ball.visual = trimesh.visual.TextureVisuals(material=pbr(metallicFactor=0.75))
    mesh = nrs.NaniteMesh.from_trimesh(trimesh.Scene([box, ball.apply_translation([5, 0, 0])]))
    assert [material.metallic for material in mesh.materials] == [0.25, 0.75]
    cut = mesh.cut(error=0)
    assert np.array_equal(cut.face_materials == 1, cut.vertices[cut.faces].mean(axis=1)[:, 0] > 2)
    assert nrs.NaniteMesh.from_trimesh(trimesh.creation.box()).materials == ()


def test_textures_that_are_missing_leave_the_mesh(tmp_path) -> None:
    document = Document()
    document.row("images", uri="none.png")
    document.row("textures", source=0)
    document.row("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicFactor": 0})
    document.mesh(document.quad(material=0))
    path = document.save(tmp_path / "a.glb")
    with pytest.warns(UserWarning, match=r"textures left out.*none\.png"):
        (look,) = nrs.NaniteMesh.from_file(path).materials
    assert look.metallic == 0
    with pytest.raises(nrs.MissingFileError, match=r"none\.png"):
        nrs.NaniteMesh.from_file(path, bad_textures="raise")


def test_the_command_line_reads_the_same(tmp_path) -> None:
    from nanite_rs.cli import main

    document = Document()
    document.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    position = document.accessor(np.int16(QUAD * 1000), normalized=False, stride=8)
    document.mesh({"attributes": {"POSITION": position}, "indices": document.accessor(QUAD_FACES)})
    path = document.save(tmp_path / "a.glb")
    assert main(["cut", str(path), "-o", str(tmp_path / "b.glb"), "--error", "0", "--quiet"]) == 0
    assert np.allclose(nrs.NaniteMesh.from_file(tmp_path / "b.glb").bounds, [[0, 0, 0], [1000, 1000, 0]])
