"""Files that do not fit, read in pieces: against the same files read as a whole."""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from conftest import SOAK
from nanite_rs import _piece_gltf, _piece_text
from nanite_rs.cli import main
from oracles import materials
from oracles.documents import Document, png
from test_build_file import LITTLE, is_closed, key, write_ply
from test_gltf import draco_document, meshopt_document

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch) -> None:
    """Texts are read in many blocks."""
    monkeypatch.setattr(_piece_text, "BLOCK", 1 << 15)


def arrays() -> tuple[np.ndarray, np.ndarray]:
    """A closed mesh that is no graph over a plane, of several blocks."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=60_000 if SOAK else 16_000)
    return vertices.astype(np.float64), faces


def both(path: Path, folder: Path, memory: int = LITTLE) -> tuple[nrs.Cut, nrs.Cut]:
    """Cuts of all detail of a file in blocks, and of the same file in memory."""
    mesh = nrs.build_file(path, folder / "blocks.nanite", memory=memory)
    mesh.check()
    nrs.NaniteMesh.from_file(path).save(folder / "memory.nanite")
    whole = nrs.NaniteMesh.open(folder / "memory.nanite")
    return mesh.cut(error=0.0), whole.cut(error=0.0)


def rows_of(cut: nrs.Cut, values: np.ndarray) -> np.ndarray:
    """Values of all corners in an order that is that of the triangles."""
    corners = np.asarray(cut.vertices, np.float64)[cut.faces].reshape(len(cut.faces) * 3, 3)
    rows = np.asarray(values, np.float64)[cut.faces].reshape(len(cut.faces) * 3, -1)
    rows = np.concatenate([corners, rows], axis=1)
    return rows[np.lexsort(rows.T[::-1])]


def assert_same(a: nrs.Cut, b: nrs.Cut) -> None:
    assert materials.of_faces(a) == materials.of_faces(b)
    assert key(a.vertices, a.faces) == key(b.vertices, b.faces)
    assert (a.colors is None) == (b.colors is None)
    if a.colors is not None and b.colors is not None:
        assert a.colors.dtype == b.colors.dtype
        assert np.array_equal(rows_of(a, a.colors), rows_of(b, b.colors))
    assert len(a.uvs) == len(b.uvs)
    for own, other in zip(a.uvs, b.uvs, strict=True):
        assert np.array_equal(rows_of(a, own), rows_of(b, other))
    assert list(a.channels) == list(b.channels)
    for name in a.channels:
        assert a.channels[name].dtype == b.channels[name].dtype
        assert np.array_equal(rows_of(a, a.channels[name]), rows_of(b, b.channels[name]))


def write_text_ply(path: Path, vertices, faces, end: str = "\n", **columns) -> None:
    lines = ["ply", "format ascii 1.0", "comment a text", f"element vertex {len(vertices)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    kinds = {"u1": "uchar", "f4": "float", "i4": "int"}
    lines += [f"property {kinds[rows.dtype.str[1:]]} {name}" for name, rows in columns.items()]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    for row, point in enumerate(vertices.tolist()):
        extra = [f"{rows[row]}" for rows in columns.values()]
        lines.append(" ".join([*map(repr, point), *extra]))
    lines += [" ".join(map(str, [len(face), *face])) for face in np.asarray(faces).tolist()]
    path.write_bytes(end.join([*lines, ""]).encode())


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_text_ply(end, tmp_path) -> None:
    vertices, faces = arrays()
    red = np.linspace(0, 255, len(vertices)).astype(np.uint8)
    heat = vertices[:, 0].astype(np.float32)
    label = (vertices[:, 1] > 0).astype(np.int32)
    colors = {"red": red, "green": red[::-1], "blue": red}
    write_text_ply(tmp_path / "x.ply", vertices + 0.1, faces, end, **colors, heat=heat, part=label)
    assert_same(*both(tmp_path / "x.ply", tmp_path))


def test_text_ply_of_polygons(tmp_path) -> None:
    x, y = np.meshgrid(np.arange(80), np.arange(80), indexing="ij")
    points = np.stack([x, y, 2 * np.sin(x / 5) * np.cos(y / 9)], -1).reshape(-1, 3)
    corner = np.arange(79)[:, None] * 80 + np.arange(79)
    quads = np.stack([corner, corner + 80, corner + 81, corner + 1], -1).reshape(-1, 4)
    write_text_ply(tmp_path / "x.ply", points, quads)
    assert_same(*both(tmp_path / "x.ply", tmp_path))


@pytest.mark.parametrize("scale", [1.0, 255.0, 0.1])
def test_colors_are_scaled_by_the_range_of_the_whole(scale, tmp_path) -> None:
    """A block by itself may be dark."""
    vertices, faces = arrays()
    shade = (np.linspace(0, 255, len(vertices)).astype(int) / 255 * scale).astype(np.float32)
    write_text_ply(tmp_path / "x.ply", vertices, faces, red=shade, green=shade, blue=shade)
    assert_same(*both(tmp_path / "x.ply", tmp_path))


def test_channels_of_binary_ply(tmp_path) -> None:
    vertices, faces = arrays()
    vertices = vertices.astype(np.float32)
    part = (vertices[:, 1] > 0).astype(np.uint8)
    columns = {"heat": vertices[:, 0], "part": part, "label": part.astype(np.float32)}
    write_ply(tmp_path / "x.ply", vertices, faces, **columns)
    a, b = both(tmp_path / "x.ply", tmp_path)
    assert a.channels["part"].dtype == np.uint8
    assert a.channels["label"].dtype.kind == "i"
    assert_same(a, b)


def write_text_stl(path: Path, vertices, faces) -> None:
    lines = ["solid a thing"]
    for number, face in enumerate(np.asarray(vertices)[faces].tolist()):
        if number == len(faces) // 2:
            lines += ["endsolid a thing", "solid another"]
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += ["  vertex " + " ".join(map(repr, point)) for point in face]
        lines += [" endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid another", ""]))


def test_text_stl(tmp_path) -> None:
    vertices, faces = arrays()
    write_text_stl(tmp_path / "x.stl", vertices, faces)
    a, b = both(tmp_path / "x.stl", tmp_path)
    assert_same(a, b)
    assert is_closed(nrs.NaniteMesh.open(tmp_path / "blocks.nanite").cut(target_faces=500))


@pytest.mark.parametrize("kind", ["VisCAM", "Magics", "something else"])
def test_attributes_of_stl(kind, tmp_path) -> None:
    """Colours, as two programs write them; else labels of faces."""
    vertices, faces = arrays()
    row = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    row["corners"] = vertices[faces]
    number = np.arange(len(faces)) * 40 // len(faces)
    row["more"] = {"VisCAM": np.where(number > 3, 0x8000 | 700 * number, 0), "Magics": 700 * number}.get(
        kind, number
    )
    head = (b"COLOR=\x10\x20\x30\xff" if kind == "Magics" else b"").ljust(80)
    (tmp_path / "x.stl").write_bytes(head + np.uint32(len(faces)).tobytes() + row.tobytes())
    a, b = both(tmp_path / "x.stl", tmp_path)
    assert_same(a, b)
    assert (a.colors is None) == (kind == "something else")
    if a.colors is None:
        assert np.array_equal(np.bincount(a.face_channels["attributes"]), np.bincount(number))


def write_obj(path: Path, vertices, faces, kind: str) -> None:
    """OBJ whose corners have the form that ``kind`` says, such as v/t/n."""
    lines = ["# a knot", "o knot"]
    rows = [" ".join(map(repr, point)) for point in vertices.tolist()]
    if "c" in kind:
        rows = [f"{row} {k % 7 / 8} 0.5 1" for k, row in enumerate(rows)]
    uvs = [f"vt {k % 64 / 64} {k // 64 / 64}" for k in range(len(vertices))] if "t" in kind else []
    normals = [f"vn 0 {k % 5} 1" for k in range(len(vertices))] if "n" in kind else []

    def corner(k: int, back: int) -> str:
        at = k - back if back else k + 1
        return kind.partition(" ")[0].replace("v", str(at)).replace("t", str(at)).replace("n", str(at))

    if "ahead" in kind:
        lines += ["f " + " ".join(corner(k, 0) for k in face) for face in faces.tolist()]
    lines += [f"v {row}" for row in rows] + uvs + normals
    if "ahead" not in kind:
        back = len(vertices) if "back" in kind else 0
        lines += ["f " + " ".join(corner(k, back) for k in face) for face in faces.tolist()]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize(
    "kind", ["v", "v/t", "v//n", "v/t/n", "v c", "v/t c", "v back", "v/t/n back", "v ahead"]
)
def test_obj(kind, tmp_path) -> None:
    vertices, faces = arrays()
    write_obj(tmp_path / "x.obj", vertices, faces, kind)
    assert_same(*both(tmp_path / "x.obj", tmp_path))


def test_obj_of_all_that_may_be(tmp_path) -> None:
    """Polygons, negative numbers amid vertices, lines that go on, comments, statements that are left, materials."""
    lines = ["mtllib x.mtl", "V 0 0 -0.25 # unused", "s off"]
    for i in range(60):
        lines += [f"  v {i} {j} \\\n {np.sin(i / 5) * np.cos(j / 9):.6f}" for j in range(60)]
        lines.append("usemtl red" if i % 2 else "usemtl a#blue")
        lines += [f"f {-120 + j} {-60 + j} {-59 + j} {-119 + j}" for j in range(59) if i] + ["p 1", "g a"]
    (tmp_path / "x.obj").write_text("\n".join(lines))
    (tmp_path / "x.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl a#blue\nKd 0 0 1\n")
    with pytest.warns(UserWarning, match="points and lines"):
        a, b = both(tmp_path / "x.obj", tmp_path)
    assert_same(a, b)
    assert sorted(np.bincount(a.face_materials)) == sorted(np.bincount(b.face_materials))


V = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
STL = (
    "solid\n"
    + 3 * "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        (
            "x.ply",
            PLY + "0 0 0\n1 0 0\n1 x 0\n0 1 0\n3 0 1 2\n3 0 2 3\n",
            'line 12: .*"x".*row 2 of 4|row 2 of 4',
        ),
        ("x.ply", PLY + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 7\n", r"faces\[1\] refers to vertex 7"),
        ("x.ply", PLY + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n", "row 1 of 2.*end of the file"),
        ("x.ply", PLY + "0 0 0\n1 0 0\n1 1 0 5\n0 1 0\n3 0 1 2\n", "row 2.*too many"),
        ("x.ply", PLY.replace("float x", "floaf x"), "is no type of PLY"),
        (
            "x.ply",
            PLY.replace("property float x\n", "") + "0 0\n0 1\n1 1\n0 0\n3 0 1 2\n3 0 1 2\n",
            "no property x",
        ),
        ("x.stl", STL + "facet normal 0 0 1\nouter loop\nvertex 0 0,5 0\n", 'line 25: facet 3.*found "0,5"'),
        ("x.stl", STL, "without endsolid"),
        ("x.stl", "solid\nendsolid\n", "no triangles"),
        ("x.obj", V + "f 0 1 2\n", 'line 5: expected the number of a vertex of 4, found "0"'),
        ("x.obj", V + "f 1 2 9\n", r"faces\[0\]: there is no vertex 9, only 4"),
        ("x.obj", V + "f 1 2 3\nf -5 1 2\n", 'line 6: expected the number of a vertex of 4, found "-5"'),
        ("x.obj", V + "f 1/1 2 3\n", "there is no texture vertex 1, only 0"),
        ("x.obj", V + "f 1/1/1/1 2 3\n", "line 5: expected a corner"),
        ("x.obj", V + "f 1 2 three\n", 'line 5: expected the number of a vertex of 4, found "three"'),
        ("x.obj", V + "v 0,5 1 2\n", 'line 5: expected a number, found "0,5"'),
        ("x.obj", V + "v 1 2\n", "line 5: expected 3 numbers, found the end of the line"),
        ("x.obj", V, "no triangles"),
    ],
)
def test_bad_texts_say_what_is_wrong(name, text, match, tmp_path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises((nrs.FormatError, nrs.MeshError), match=match) as error:
        nrs.build_file(tmp_path / name, tmp_path / "x.nanite", memory=64)
    assert str(tmp_path / name) in str(error.value)
    with pytest.raises(type(error.value)):
        nrs.NaniteMesh.from_file(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_vertices_that_are_not_finite(tmp_path) -> None:
    vertices, faces = arrays()
    unused = np.concatenate([vertices[:10], np.full((1, 3), np.nan), vertices[10:]]).astype(np.float32)
    write_ply(tmp_path / "x.ply", unused, np.where(faces >= 10, faces + 1, faces))
    assert_same(*both(tmp_path / "x.ply", tmp_path))
    write_ply(tmp_path / "x.ply", unused, faces)
    with pytest.raises(nrs.MeshError, match=r"vertices\[10\] is not finite, and faces\[\d+\] refers to it"):
        nrs.build_file(tmp_path / "x.ply", tmp_path / "x.nanite", memory=LITTLE)


def is_joined(cut: nrs.Cut) -> bool:
    """Whether a cut is closed, where vertices of one place may differ in their normals."""
    points, place = np.unique(cut.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points, place.reshape(-1)[cut.faces], process=False).is_watertight


def quarters() -> list[tuple[np.ndarray, np.ndarray]]:
    """A closed mesh in four parts."""
    vertices, faces = arrays()
    middle = vertices[faces].mean(axis=1)
    number = 2 * (middle[:, 0] > 0) + (middle[:, 1] > 0)
    parts = []
    for k in range(4):
        used, corners = np.unique(faces[number == k], return_inverse=True)
        parts.append((vertices[used].astype(np.float32).astype(np.float64), corners.reshape(-1, 3)))
    return parts


def write_tiles(folder: Path) -> list[Path]:
    folder.mkdir()
    a, b, c, d = quarters()
    paths = [folder / name for name in ("tile_1.ply", "tile_2.stl", "tile_9.obj", "tile_10.glb")]
    write_text_ply(paths[0], *a)
    write_text_stl(paths[1], *b)
    write_obj(paths[2], *c, "v")
    trimesh.Trimesh(*d, process=False).export(paths[3])
    return paths


@pytest.mark.parametrize("memory", [LITTLE, 1 << 24])
@pytest.mark.parametrize("kind", ["folder", "list", "glob"])
def test_tiles_of_many_formats_are_one_surface(kind, memory, tmp_path) -> None:
    paths = write_tiles(tmp_path / "tiles")
    (tmp_path / "tiles" / "read.me").write_text("no mesh")
    sources = {"folder": tmp_path / "tiles", "list": paths, "glob": (path for path in paths)}
    mesh = nrs.build_file(sources[kind], tmp_path / "x.nanite", memory=memory)
    assert mesh.report.border_edges == 0
    assert len(mesh) == len(arrays()[1])
    assert is_joined(mesh.cut(target_faces=800))
    # That of the GLB, and none.
    assert np.unique(mesh.cut(error=0.0).face_materials).tolist() == [0, 1]


def test_tiles_that_have_other_attributes(tmp_path) -> None:
    """What a tile has not is filled in, as for the parts of one file."""
    (tmp_path / "tiles").mkdir()
    parts = quarters()
    red = np.full(len(parts[1][0]), 51, np.uint8)
    part = np.full(len(parts[1][0]), 7, np.uint8)
    write_text_ply(tmp_path / "tiles" / "0.ply", *parts[0])
    write_text_ply(tmp_path / "tiles" / "1.ply", *parts[1], red=red, green=red, blue=red, part=part)
    write_text_ply(tmp_path / "tiles" / "2.ply", *parts[2], part=np.full(len(parts[2][0]), 9, np.int32))
    write_obj(tmp_path / "tiles" / "3.obj", *parts[3], "v/t c")
    cut = nrs.build_file(tmp_path / "tiles", tmp_path / "x.nanite", memory=LITTLE).cut(error=0.0)
    assert len(cut) == len(arrays()[1])
    assert set(cut.channels["part"].tolist()) == {0, 7, 9}
    assert cut.channels["part"].dtype == np.int32
    white = np.iinfo(cut.colors.dtype).max if cut.colors.dtype.kind == "u" else 1.0
    shades = {tuple(row) for row in np.rint(cut.colors / white * 255).astype(int).tolist()}
    assert {(51, 51, 51, 255), (255, 255, 255, 255)} <= shades
    assert len(cut.uvs) == 1


def test_folders_without_meshes(tmp_path) -> None:
    (tmp_path / "none").mkdir()
    with pytest.raises(nrs.ArgumentError, match="no files in it that end in"):
        nrs.build_file(tmp_path / "none", tmp_path / "x.nanite")
    write_tiles(tmp_path / "tiles")
    (tmp_path / "tiles" / "tile_3.ply").write_text(PLY)
    with pytest.raises(nrs.FormatError, match=r"tile_3\.ply"):
        nrs.build_file(tmp_path / "tiles", tmp_path / "x.nanite")


def test_tiles_are_read_once(tmp_path, monkeypatch) -> None:
    class Stop(Exception):
        pass

    def stop(done, total):
        if done > 0.5 * total:
            raise Stop

    paths = write_tiles(tmp_path / "tiles")
    how = {"memory": LITTLE, "resume": True}
    with pytest.raises(Stop):
        nrs.build_file(tmp_path / "tiles", tmp_path / "x.nanite", progress=stop, **how)
    with monkeypatch.context() as patch:
        patch.setattr("nanite_rs._piece_files._add_file", None)
        patch.setattr("nanite_rs._piece_files._reader", None)
        nrs.build_file(tmp_path / "tiles", tmp_path / "x.nanite", **how)
    expected = (tmp_path / "x.nanite").read_bytes()
    nrs.build_file(paths, tmp_path / "x.nanite", memory=LITTLE)
    assert (tmp_path / "x.nanite").read_bytes() == expected


def test_the_command_line_takes_folders(tmp_path) -> None:
    write_tiles(tmp_path / "tiles")
    command = ["build", str(tmp_path / "tiles"), "-o", str(tmp_path / "x.nanite"), "--quiet"]
    assert main(command) == 0
    assert nrs.NaniteMesh.open(tmp_path / "x.nanite").report.border_edges == 0


def write_gltf(path: Path, colors: bool) -> None:
    """Three instances of two meshes, one of which is mirrored."""
    scene = trimesh.Scene()
    for number, (vertices, faces) in enumerate(quarters()[:2]):
        ball = trimesh.Trimesh(vertices, faces, process=False)
        if colors:
            shade = np.linspace(0, 255, len(vertices)).astype(np.uint8)
            ball.visual.vertex_colors = np.stack([shade, shade[::-1], shade, shade], axis=1)
        ball.vertex_attributes["_heat"] = vertices[:, 0].astype(np.float32)
        scene.add_geometry(ball, geom_name=f"part {number}", node_name=f"node {number}")
    pose = np.diag([-2.0, 2.0, 2.0, 1.0])
    pose[:3, 3] = 4.0, 0.0, 0.5
    scene.graph.update("mirrored", geometry="part 0", matrix=pose)
    scene.export(path)


@pytest.mark.parametrize("colors", [False, True])
@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf(colors, ending, tmp_path) -> None:
    write_gltf(tmp_path / f"x.{ending}", colors)
    if ending == "gltf":
        # JSON alone has little size.
        with (tmp_path / "x.gltf").open("a") as file:
            file.write(" " * LITTLE)
    assert_same(*both(tmp_path / f"x.{ending}", tmp_path))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(POSITION=99), r"accessors\[99\]"),
        (lambda d: d["accessors"][0].update(sparse={}), r"count: expected a whole number"),
        (lambda d: d["accessors"][0].update(count=10**7), "ends at byte"),
        (lambda d: d["nodes"][0].update(skin=0), "skins and morph targets"),
        (lambda d: d.update(extensionsRequired=["EXT_strange"]), "EXT_strange"),
    ],
)
def test_bad_gltf_says_what_is_wrong(change, match, tmp_path) -> None:
    trimesh.Scene(trimesh.Trimesh(*quarters()[0], process=False)).export(tmp_path / "x.gltf")
    content = json.loads((tmp_path / "x.gltf").read_text())
    change(content)
    (tmp_path / "x.gltf").write_text(json.dumps(content))
    with pytest.raises(nrs.FormatError, match=match):
        nrs.build_file(tmp_path / "x.gltf", tmp_path / "x.nanite", memory=64)


def compressed(kind: str, path: Path) -> None:
    """GLB of some thousand triangles: of Draco, of meshoptimizer, or with a sparse accessor."""
    if kind == "draco":
        document, *_ = draco_document(4)
    elif kind == "meshopt":
        document, _ = meshopt_document("EXT_meshopt_compression", "TRIANGLES", 4)
    else:
        ball = trimesh.creation.icosphere(subdivisions=4)
        document = Document()
        points = np.float32(ball.vertices)
        some = np.array([5, 70, 900], np.uint16), points[[5, 70, 900]] * 1.5
        places = document.accessor(points, sparse=some)
        order = document.accessor(np.ascontiguousarray(ball.faces.reshape(-1, 1), np.uint32))
        document.mesh({"attributes": {"POSITION": places}, "indices": order})
    document.save(path)


@pytest.mark.parametrize("kind", ["draco", "meshopt", "sparse"])
def test_compressed_gltf(kind, tmp_path) -> None:
    compressed(kind, tmp_path / "x.glb")
    a, b = both(tmp_path / "x.glb", tmp_path, memory=1 << 17)
    assert len(a.faces) == 5120
    assert_same(a, b)


def test_sizes_of_gltf_are_those_of_all_its_buffers(tmp_path) -> None:
    write_gltf(tmp_path / "x.gltf", True)
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert _piece_gltf.size_of(str(tmp_path / "x.gltf")) == pytest.approx(size, rel=0.01)
    compressed("draco", tmp_path / "x.glb")
    stored = 2562 * 12 + 2562 * 8 + 5120 * 12
    assert _piece_gltf.size_of(str(tmp_path / "x.glb")) == stored > 1.5 * (tmp_path / "x.glb").stat().st_size


def write_faces(path: Path, kind: str, vertices, rows, *, of_faces="", of_vertices="", comment="") -> None:
    """PLY with rows of faces or strips: each the values of its properties, where lists are lists."""
    name = "tristrips" if "strips" in path.stem else "face"
    head = (
        f"ply\nformat {kind} 1.0\n{comment}element vertex {len(vertices)}\n"
        f"property float x\nproperty float y\nproperty float z\n{of_vertices}"
        f"element {name} {len(rows)}\nproperty list uchar int vertex_indices\n{of_faces}end_header\n"
    )
    if "strips" in path.stem:
        head = head.replace("list uchar", "list int")
    if kind == "ascii":
        lines = [" ".join(map(repr, row)) for row in np.asarray(vertices).tolist()]
        for row in rows:
            words = [
                f"{len(part)} {' '.join(map(str, part))}" if isinstance(part, list) else f"{part}"
                for part in row
            ]
            lines.append(" ".join(words))
        path.write_text(head + "\n".join([*lines, ""]))
        return
    order = ">" if "big" in kind else "<"
    types = [
        line.split()[1:-1] for line in head.partition("element vertex")[2].splitlines() if "property" in line
    ]
    letters = {"float": "f", "int": "i", "uchar": "B", "short": "h"}
    data = [np.asarray(vertices, f"{order}f4").tobytes()]
    for row in rows:
        for words, part in zip(types[-len(row) :], row, strict=True):
            if words[0] == "list":
                data.append(struct.pack(order + letters[words[1]], len(part)))
            values = part if isinstance(part, list) else [part]
            data.append(struct.pack(f"{order}{len(values)}{letters[words[-1]]}", *values))
    path.write_bytes(head.encode() + b"".join(data))


KINDS = ("ascii", "binary_little_endian", "binary_big_endian")


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a wavy square, and its quads."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    points = np.stack([x, y, np.sin(x / 3) * np.cos(y / 5)], axis=-1).reshape(-1, 3).astype(np.float32)
    at = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).reshape(-1)
    return points, np.stack([at, at + 1, at + size + 1, at + size], axis=1)


@pytest.mark.parametrize("kind", KINDS)
def test_ply_of_polygons(kind, tmp_path) -> None:
    points, quads = grid(60)
    # Triangles first, so that later blocks differ from the first.
    rows = [[face] for face in quads[:1000, :3].tolist()] + [[face] for face in quads[1000:].tolist()]
    write_faces(tmp_path / "x.ply", kind, points, [*rows, [[1, 2]]])
    with pytest.warns(UserWarning, match="fewer than three"):
        assert_same(*both(tmp_path / "x.ply", tmp_path))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("long", [False, True])
def test_ply_of_strips(kind, long, tmp_path) -> None:
    """One strip of many rows, which is longer than a block, or one for each row."""
    points, _ = grid(60)
    strips = [[at for x in range(60) for at in (y * 60 + x, y * 60 + 60 + x)] for y in range(59)]
    joined = [at for strip in strips for at in (*strip, -1)]
    write_faces(tmp_path / "strips.ply", kind, points, [[joined]] if long else [[strip] for strip in strips])
    a, b = both(tmp_path / "strips.ply", tmp_path)
    assert len(a.faces) == 2 * 59 * 59
    assert_same(a, b)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("own", ["", "property float s\nproperty float t\n"])
def test_ply_with_uvs_of_corners(kind, own, tmp_path) -> None:
    """Charts: a column of the surface has each its own; one has none."""
    points, quads = grid(60)
    charts = (quads % 60 // 7)[:, 0]
    places = points[quads][..., :2] / 60 + charts[:, None, None]
    rows = []
    for quad, uv, chart in zip(quads.tolist(), places.tolist(), charts.tolist(), strict=True):
        rows.append([quad, [] if chart == 3 else np.float32(uv).reshape(-1).tolist(), chart % 3 - 1, chart])
    of_faces = "property list uchar float texcoord\nproperty int texnumber\nproperty short chart\n"
    textures = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    if own:
        points = np.concatenate([points, points[:, :2]], axis=1)
    path = tmp_path / "x.ply"
    write_faces(path, kind, points, rows, of_faces=of_faces, of_vertices=own, comment=textures)
    for name, shade in (("a.png", 10), ("b.png", 200)):
        (tmp_path / name).write_bytes(png(np.full((2, 2, 3), shade, np.uint8)))
    a, b = both(path, tmp_path)
    assert_same(a, b)
    assert len(a.uvs) == 1 + bool(own)
    assert sorted(np.bincount(a.face_materials)) == sorted(np.bincount(b.face_materials))
    assert np.array_equal(np.sort(a.face_channels["chart"]), np.sort(b.face_channels["chart"]))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("own", [False, True])
def test_ply_with_colors_of_faces(kind, own, tmp_path) -> None:
    """They are taken where vertices have none."""
    points, quads = grid(60)
    rows = [[quad, k % 3 * 100, 7, 200] for k, quad in enumerate(quads.tolist())]
    of_faces = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    of_vertices = of_faces.replace("uchar", "float") if own else ""
    points = np.concatenate([points, np.abs(points) / 60], axis=1) if own else points
    write_faces(tmp_path / "x.ply", kind, points, rows, of_faces=of_faces, of_vertices=of_vertices)
    a, b = both(tmp_path / "x.ply", tmp_path)
    assert a.colors is not None
    assert_same(a, b)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_faces_are_averaged(kind, tmp_path) -> None:
    points, quads = grid(60)
    heat = np.float32(np.sin(np.arange(len(quads)) / 100))
    broken = np.where(np.arange(len(quads)) == 3000, np.nan, heat)
    rows = [[quad, *more] for quad, *more in zip(quads.tolist(), heat.tolist(), broken.tolist(), strict=True)]
    of_faces = "property float heat\nproperty float broken\n"
    write_faces(tmp_path / "x.ply", kind, points, rows, of_faces=of_faces)
    with pytest.warns(UserWarning, match=r"averaged to vertices \(heat\)") as seen:
        a, b = both(tmp_path / "x.ply", tmp_path)
    assert sum("not finite (broken)" in str(warning.message) for warning in seen) == 2
    assert list(a.channels) == ["heat"]
    assert_same(a, b)


@pytest.mark.parametrize("kind", KINDS[1:])
def test_cut_off_rows_say_where(kind, tmp_path) -> None:
    """As in memory, wherever a file is cut off."""
    points, quads = grid(40)
    write_faces(tmp_path / "x.ply", kind, points, [[quad] for quad in quads.tolist()])
    data = (tmp_path / "x.ply").read_bytes()
    head = data.index(b"end_header\n") + 11
    for length in (
        head,
        head + 5,
        head + 12 * 100,
        head + 12 * 1600 + 3,
        head + 12 * 1600 + 17 * 900 + 2,
        len(data) - 1,
    ):
        (tmp_path / "x.ply").write_bytes(data[:length])
        said = []
        for memory in (1 << 15, 1 << 30):
            with pytest.raises(nrs.FormatError) as caught:
                nrs.build_file(tmp_path / "x.ply", tmp_path / "x.nanite", memory=memory)
            said.append(str(caught.value))
        assert said[0] == said[1]


@pytest.mark.parametrize("text", [False, True])
def test_labels_of_faces_are_kept(text, tmp_path) -> None:
    """But for those that differ too much, and what is no integer."""
    vertices, faces = arrays()
    vertices = vertices.astype(np.float32)
    centers = vertices[faces].mean(axis=1)
    segment = (centers[:, 0] > 0).astype(np.uint8) + 2 * (centers[:, 1] > 0).astype(np.uint8)
    row = np.zeros(
        len(faces),
        [("n", "u1"), ("f", "<i4", 3), ("segment", "u1"), ("row", "<i4"), ("heat", "<f4"), ("part", "<i2")],
    )
    row["n"], row["f"], row["segment"], row["row"] = 3, faces, segment, np.arange(len(faces))
    row["part"] = -7 * (centers[:, 2] > 0)
    points = np.zeros(len(vertices), [("p", "<f4", 3), ("part", "u1")])
    points["p"], points["part"] = vertices, 1
    kind = "ascii" if text else "binary_little_endian"
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nproperty uchar part\nelement face {len(faces)}\nproperty list uchar int vertex_index\n"
        "property uchar segment\nproperty int row\nproperty float heat\nproperty short part\nend_header\n"
    )
    if text:
        lines = [" ".join([*(str(x) for x in p), str(k)]) for p, k in points.tolist()]
        lines += [f"3 {' '.join(map(str, f))} {' '.join(map(str, rest))}" for _, f, *rest in row.tolist()]
        data = "\n".join([*lines, ""]).encode()
    else:
        data = points.tobytes() + row.tobytes()
    path = tmp_path / "labels.ply"
    path.write_bytes(head.encode() + data)
    options = nrs.BuildOptions(face_ids=True)
    match = r"data of faces that differ too much to be kept apart \(row\)"
    with pytest.warns(UserWarning, match=match):
        built = nrs.build_file(path, tmp_path / "a.nanite", memory=1 << 20, options=options)
    with pytest.warns(UserWarning, match=match):
        whole = nrs.NaniteMesh.from_file(path, options=options)
    for made in (built, whole):
        made.check()
        full, order = made.cut(error=0.0), np.argsort(made.source_face_ids)
        assert np.array_equal(full.face_channels["segment"][order], segment)
        assert np.array_equal(full.face_channels["face_part"][order], row["part"])
        assert set(full.face_channels) == {"segment", "face_part"}
        assert set(np.unique(full.channels["part"])) == {1}
