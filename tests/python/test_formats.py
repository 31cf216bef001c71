"""PLY, STL, OBJ and OFF by their grammars: what other programs write comes in whole, or is named."""

from __future__ import annotations

import itertools
import struct

import meshio
import numpy as np
import pytest
import trimesh
from PIL import Image as Pillow

import nanite_rs as nrs
from nanite_rs.assets import read_asset
from oracles import data

RNG = np.random.default_rng(36)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
V = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def put(folder, name: str, content: str | bytes):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def only(path, **options):
    """The one part of a file."""
    ((part,),) = read_asset(path, **options).meshes
    return part


def rows(source) -> np.ndarray:
    """Triangles as corner positions, in order."""
    corners = np.asarray(source.vertices)[np.asarray(source.faces)].reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


def area(source) -> float:
    a, b, c = (np.asarray(source.vertices)[np.asarray(source.faces)[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


# -------------------------------------------------------------------------------------------------------- polygons

STAR = [
    ((1 if k % 2 else 0.4) * np.cos(k * np.pi / 5), (1 if k % 2 else 0.4) * np.sin(k * np.pi / 5))
    for k in range(10)
]
POLYGONS = {
    "L": [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)],
    "arrow": [(0, 0), (2, 1), (0, 2), (1, 1)],
    "star": STAR,
    "comb": [(0, 0), (7, 0), (7, 3), (6, 1), (5, 3), (4, 1), (3, 3), (2, 1), (1, 3)],
    "straight sides": [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)],
    "keyhole": [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
}


def polygon_files(points: np.ndarray) -> dict[str, str]:
    n, lines = len(points), "\n".join("{!r} {!r} {!r}".format(*map(float, p)) for p in points)
    order = " ".join(map(str, range(n)))
    head = "".join(f"property float64 {axis}\n" for axis in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices"
    return {
        "obj": "".join(f"v {line}\n" for line in lines.splitlines())
        + "f "
        + " ".join(str(k + 1) for k in range(n)),
        "off": f"OFF\n{n} 1 0\n{lines}\n{n} {order}\n",
        "ply": f"ply\nformat ascii 1.0\nelement vertex {n}\n{head}\nend_header\n{lines}\n{n} {order}\n",
    }


@pytest.mark.parametrize("name", POLYGONS)
@pytest.mark.parametrize("backwards", [False, True])
def test_concave_polygons_are_covered_once(tmp_path, name, backwards) -> None:
    flat = np.array(POLYGONS[name][:: -1 if backwards else 1], float)
    x, y = flat.T
    own = abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2))
    # In any plane of space, far out, and begun at any corner.
    turn = trimesh.transformations.random_rotation_matrix(RNG.random(3))[:3, :3]
    for first in (0, 1, len(flat) // 2):
        points = np.roll(np.c_[flat, np.zeros(len(flat))], -first, axis=0) @ turn.T + (
            451234.5,
            5412345.25,
            300.0,
        )
        normal = turn[:, 2] * (-1 if backwards else 1)
        for suffix, content in polygon_files(points).items():
            source = only(put(tmp_path, f"p.{suffix}", content)).source
            assert len(source.faces) == len(flat) - 2
            assert area(source) == pytest.approx(own, rel=1e-6)
            a, b, c = (source.vertices[np.asarray(source.faces)[:, k]] for k in range(3))
            assert (np.cross(b - a, c - a) @ normal > -1e-6).all()


def test_polygons_without_area_are_no_error(tmp_path) -> None:
    text = V + "v 2 0 0\nf 1 2 5 2\nf 1 1 1\nf 1 2\nf 1 2 3 4\n"
    asset = read_asset(put(tmp_path, "a.obj", text))
    assert "faces of fewer than three corners" in str(asset.notes)
    assert area(asset.meshes[0][0].source) == pytest.approx(1.0)


# ------------------------------------------------------------------------------------------------------------- PLY

TYPES = [
    ("char", "int8", "b"), ("uchar", "uint8", "B"), ("short", "int16", "h"), ("ushort", "uint16", "H"),
    ("int", "int32", "i"), ("uint", "uint32", "I"), ("float", "float32", "f"), ("double", "float64", "d"),
]  # fmt: skip
FORMATS = ["ascii", "binary_little_endian", "binary_big_endian"]


def ply(kind: str, elements, *, comments=(), end: str = "\n") -> bytes:
    """Write a PLY file: elements are names, properties as (name, type or (count type, type)), and rows."""
    codes = {name: code for old, new, code in TYPES for name in (old, new)}
    head, body, order = (
        ["ply", f"format {kind} 1.0", *(f"comment {c}" for c in comments)],
        [],
        ">" if "big" in kind else "<",
    )
    for name, properties, table in elements:
        head.append(f"element {name} {len(table)}")
        head += [f"property {t if isinstance(t, str) else 'list ' + ' '.join(t)} {p}" for p, t in properties]
        for row in table:
            words: list[tuple[str, object]] = []
            for (_, kinds), value in zip(properties, row, strict=True):
                if isinstance(kinds, str):
                    words.append((codes[kinds], value))
                else:
                    words += [(codes[kinds[0]], len(value)), *((codes[kinds[1]], v) for v in value)]
            if kind == "ascii":
                body.append((" ".join(f"{v:.17g}" for _, v in words) + end).encode())
            else:
                body.append(b"".join(struct.pack(order + c, v if c in "fd" else int(v)) for c, v in words))
    return (end.join([*head, "end_header"]) + end).encode() + b"".join(body)


XYZ = [("x", "float"), ("y", "double"), ("z", "float32")]


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ply_keeps_every_property(tmp_path, kind, end) -> None:
    properties = [
        ("label", "short"),
        ("s", "float"),
        *XYZ,
        ("t", "float"),
        ("nx", "float"),
        ("ny", "float"),
        ("nz", "float"),
    ]
    properties += [
        ("red", "uint8"),
        ("green", "uint8"),
        ("blue", "uint8"),
        ("quality", "double"),
        ("flag", "int8"),
    ]
    table = [
        (300 + k, 0.25 * k, *p, -0.5 * k, 0, 0, 1, 10 * k, 20, 30, 0.5 * k, -k) for k, p in enumerate(SQUARE)
    ]
    faces = [([0, 1, 2], 7, 0.5), ([0, 2, 3], 9, 1.5)]
    # Faces first, counted by shorts, with properties on both sides.
    content = ply(
        kind,
        [
            ("face", [("vertex_index", ("ushort", "uint")), ("region", "int"), ("weight", "float")], faces),
            ("vertex", properties, table),
        ],
        end=end,
    )
    path = put(tmp_path, "a.ply", content)
    source = only(path).source
    assert np.array_equal(source.vertices, SQUARE)
    assert np.array_equal(source.faces, [f[0] for f in faces])
    assert np.array_equal(source.normals, [[0, 0, 1]] * 4)
    assert np.array_equal(source.colors, [(10 * k, 20, 30, 255) for k in range(4)])
    assert np.array_equal(source.uvs, [[(0.25 * k, -0.5 * k) for k in range(4)]])
    assert {name: values.tolist() for name, values in source.channels.items()} == {
        "label": [300, 301, 302, 303], "quality": [0, 0.5, 1, 1.5], "flag": [0, -1, -2, -3],
    }  # fmt: skip
    assert {name: values.tolist() for name, values in source.face_channels.items()} == {
        "region": [7, 9],
        "weight": [0.5, 1.5],
    }
    assert source.channels["label"].dtype == np.int16
    cut = nrs.NaniteMesh.from_file(path).cut(error=0.0)
    assert len(cut.uvs) == 1
    assert cut.colors is not None
    assert set(cut.channels) == {"label", "quality", "flag", "region", "weight"}
    assert sorted(cut.face_channels["region"].tolist()) == [7, 9]


@pytest.mark.parametrize(
    ("count", "index"),
    list(itertools.product([t[0] for t in TYPES[:6]], ["int8", "ushort", "uint", "float"])),
)
def test_ply_lists_of_every_type(tmp_path, count, index) -> None:
    polygons = [([0, 1, 2, 3], 1), ([0, 2, 1], 2), ([0, 1, 2], 3)]
    for kind in FORMATS:
        faces = ("face", [("vertex_indices", (count, index)), ("n", "ushort")], polygons)
        source = only(put(tmp_path, "a.ply", ply(kind, [("vertex", XYZ, SQUARE), faces]))).source
        assert np.array_equal(source.faces, [[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 1, 2]])
        assert source.face_channels["n"].tolist() == [1, 1, 2, 3]


@pytest.mark.parametrize("kind", FORMATS)
def test_ply_strips(tmp_path, kind) -> None:
    strips = ("tristrips", [("vertex_indices", ("int", "int"))], [([0, 1, 3, 2, -1, 0, 1, 2],), ([1, 2, 3],)])
    source = only(put(tmp_path, "a.ply", ply(kind, [("vertex", XYZ, SQUARE), strips]))).source
    assert np.array_equal(source.faces, [[0, 1, 3], [3, 1, 2], [0, 1, 2], [1, 2, 3]])


@pytest.mark.parametrize(
    ("names", "kind", "values", "expected"),
    [
        ("red green blue", "uchar", (255, 0, 51), (255, 0, 51, 255)),
        ("r g b a", "float", (1.0, 0.0, 0.2, 0.6), (255, 0, 51, 153)),
        ("diffuse_red diffuse_green diffuse_blue", "ushort", (65535, 0, 13107), (255, 0, 51, 255)),
        ("red green blue alpha", "int", (255, 0, 51, 102), (255, 0, 51, 102)),
        ("red green blue", "float", (255.0, 0.0, 51.0), (255, 0, 51, 255)),
    ],
)
@pytest.mark.parametrize("of", ["vertex", "face"])
def test_ply_colors_of_any_type(tmp_path, names, kind, values, expected, of) -> None:
    more, tail = [(name, kind) for name in names.split()], tuple(values)
    own = [(*p, *tail) if of == "vertex" else tuple(p) for p in SQUARE]
    faces = [([0, 1, 2, 3], *(tail if of == "face" else ()))]
    elements = [
        ("vertex", XYZ + (more if of == "vertex" else []), own),
        ("face", [("vertex_indices", ("uchar", "int")), *(more if of == "face" else [])], faces),
    ]
    source = only(put(tmp_path, "a.ply", ply("binary_big_endian", elements))).source
    assert (source.colors == expected).all()
    assert not source.channels
    assert not source.face_channels


def test_ply_colors_keep_more_than_bytes(tmp_path) -> None:
    more = [(name, "ushort") for name in ("red", "green", "blue")]
    table = [(*p, 1000 * k + 7, 3, 5) for k, p in enumerate(SQUARE)]
    elements = [
        ("vertex", XYZ + more, table),
        ("face", [("vertex_indices", ("uchar", "int"))], [([0, 1, 2, 3],)]),
    ]
    source = only(put(tmp_path, "a.ply", ply("ascii", elements))).source
    assert source.colors.dtype == np.uint16
    assert source.colors[:, 0].tolist() == [7, 1007, 2007, 3007]


@pytest.mark.parametrize(
    "names",
    [
        "s t",
        "u v",
        "texture_u texture_v",
        "texture_s texture_t",
        "tex_u tex_v",
        "texcoord_u texcoord_v",
        "u0 v0",
        "U V",
    ],
)
def test_ply_names_of_uvs(tmp_path, names) -> None:
    more = [(name, "double") for name in names.split()] + [("s1", "float"), ("t1", "float"), ("v_", "float")]
    table = [(*p, 0.5 * k, k, 2 * k, 3 * k, k) for k, p in enumerate(SQUARE)]
    elements = [
        ("vertex", XYZ + more, table),
        ("face", [("vertex_indices", ("uchar", "int"))], [([0, 1, 2, 3],)]),
    ]
    source = only(put(tmp_path, "a.ply", ply("ascii", elements))).source
    assert np.array_equal(source.uvs, [[(0.5 * k, k) for k in range(4)], [(2 * k, 3 * k) for k in range(4)]])
    assert list(source.channels) == ["v_"]


@pytest.mark.parametrize("kind", FORMATS)
def test_ply_texture_coordinates_of_corners(tmp_path, kind) -> None:
    for number, color in enumerate([(200, 0, 0), (0, 200, 0)]):
        Pillow.new("RGB", (2, 2), color).save(tmp_path / f"tex {number}.png")
    uvs = [[0, 0, 0.5, 0, 0.5, 0.5], [0.6, 0.6, 1, 1, 0.6, 1], []]
    faces = [([0, 1, 2], uvs[0], 0), ([0, 2, 3], uvs[1], 1), ([1, 2, 3], uvs[2], -1)]
    properties = [
        ("vertex_indices", ("uchar", "int")),
        ("texcoord", ("uchar", "float")),
        ("texnumber", "int"),
    ]
    elements = [("vertex", XYZ, SQUARE), ("face", properties, faces)]
    comments = ["TextureFile tex 0.png", "TextureFile Tex 1.PNG"]
    part = only(put(tmp_path, "a.ply", ply(kind, elements, comments=comments)))
    source = part.source
    assert np.allclose(source.uvs[0][source.faces].reshape(3, 6), [*uvs[:2], [0] * 6])
    assert source.face_materials.tolist() == [0, 1, 2]
    assert [int(look.base_color_texture.image.pixels[0, 0].argmax()) for look in part.material[:2]] == [0, 1]
    assert part.material[2].base_color_texture is None
    with pytest.raises(nrs.MissingFileError, match=r"a\.ply: TextureFile.*none\.png"):
        read_asset(put(tmp_path, "a.ply", ply(kind, elements, comments=["TextureFile none.png"])))


def test_ply_names_what_it_leaves_out(tmp_path) -> None:
    elements = [
        ("vertex", [*XYZ, ("q", "float"), ("tags", ("uchar", "int"))], [(*p, np.nan, [1]) for p in SQUARE]),
        ("face", [("vertex_indices", ("uchar", "int"))], [([0, 1, 2, 3],), ([0, 1],)]),
        ("edge", [("vertex1", "int")], [(0,)]),
    ]
    asset = read_asset(put(tmp_path, "a.ply", ply("binary_little_endian", elements) + b"more"))
    for what in (
        "not finite (q)",
        "lists of vertices (tags)",
        "edges besides faces",
        "4 bytes",
        "1 faces of fewer",
    ):
        assert what in str(asset.notes)
    with pytest.warns(UserWarning, match=r"a\.ply: not everything is kept: .*edge"):
        nrs.NaniteMesh.from_file(tmp_path / "a.ply")
    with pytest.raises(nrs.MeshError, match=r"points\.ply: there are no triangles in it"):
        nrs.NaniteMesh.from_file(put(tmp_path, "points.ply", ply("ascii", elements[:1])))


def test_ply_errors_say_where(tmp_path) -> None:
    elements = [
        ("vertex", XYZ, SQUARE),
        ("face", [("vertex_indices", ("uchar", "int"))], [([0, 1, 2],), ([0, 2, 3],)]),
    ]
    content = ply("binary_little_endian", elements)
    with pytest.raises(
        nrs.FormatError, match=r"a\.ply: byte \d+: element face, row 1 of 2: .* the file ends at byte"
    ):
        nrs.NaniteMesh.from_file(put(tmp_path, "a.ply", content[:-1]))
    with pytest.raises(nrs.FormatError, match=r"a\.ply: byte \d+: element vertex, row 2 of 4"):
        nrs.NaniteMesh.from_file(put(tmp_path, "a.ply", content[: content.index(b"end_header\n") + 11 + 33]))
    text = ply("ascii", elements).decode()
    for old, new, what in [
        ("3 0 2 3", "3 0 2 4", r"faces\[1\] refers to vertex 4, but there are 4"),
        ("3 0 2 3", "3 0 2", r"line 16: expected i32 of element face, row 1 of 2, property vertex_indices"),
        ("3 0 2 3", "3 0 2 3 4", "line 15: element face, row 1: \"4\" is one value too many"),
        ("1 1 0", "1 1,5 0", r"line 12: expected f64 of element vertex, row 2 of 4, property y, found \"1,5\""),
        ("property double y", "property quad y", "line 5: \"quad\" is no type"),
        ("property double y", "property double why", "element vertex has no property y"),
        ("format ascii", "format morse", "no format"),
    ]:  # fmt: skip
        with pytest.raises((nrs.FormatError, nrs.MeshError), match=what):
            read_asset(put(tmp_path, "a.ply", text.replace(old, new)))


# ------------------------------------------------------------------------------------------------------------- STL


def test_stl_is_told_by_its_size(tmp_path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    binary, text = ball.export(file_type="stl"), ball.export(file_type="stl_ascii").encode()
    expected = rows(ball)
    for content in (
        binary,
        b"solid of bytes".ljust(80) + binary[80:],
        b"solid of bytes".ljust(80) + binary[80:] + b"and more",
        b"\n".ljust(80) + binary[80:],
        text,
        text.upper(),
        b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"),
        text.replace(b"\n", b"\r"),
        text[:6] + b"\n" + text[6:].replace(b"\n", b" "),
    ):
        source = only(put(tmp_path, "a.stl", content)).source
        assert np.allclose(rows(source), expected, atol=1e-6)
    asset = read_asset(put(tmp_path, "a.stl", binary + b"and more"))
    assert str(asset.notes) == "8 bytes behind the last triangle"
    with pytest.raises(
        nrs.FormatError, match=r"a\.stl: byte \d+: the file ends after 78 of the 80 triangles"
    ):
        read_asset(put(tmp_path, "a.stl", binary[:-60]))
    with pytest.raises(nrs.FormatError, match=r"a\.stl: line \d+: .*the file ends after 80 facets"):
        read_asset(put(tmp_path, "a.stl", text[: text.rindex(b"endsolid")]))
    with pytest.raises(nrs.FormatError, match=r"a\.stl: line 4: facet 0: expected a coordinate"):
        read_asset(put(tmp_path, "a.stl", "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0,5 0\n"))


def test_stl_solids_by_name(tmp_path) -> None:
    facet = "facet normal nan nan nan\nouter loop\nvertex {0} 0 0\nvertex {0} 1 0\nvertex {0} 0 1\n"
    facet += "endloop\nendfacet\n"
    text = "".join(
        f"solid {name}\n{facet.format(k)}endsolid {name}\n"
        for k, name in enumerate(["left arm", "", "left arm"])
    )
    asset = read_asset(put(tmp_path, "a.stl", text))
    assert [name for name, _, _ in asset.placed] == ["left arm", "mesh", "left arm_2"]
    assert len(nrs.NaniteMesh.from_file(tmp_path / "a.stl")) == 3


def test_stl_attributes(tmp_path) -> None:
    def content(head: bytes, attributes) -> bytes:
        corners = np.arange(36, dtype="<f4").reshape(2, 3, 6)[..., :3] ** 2
        records = [
            b"\0" * 12 + c.tobytes() + struct.pack("<H", a) for c, a in zip(corners, attributes, strict=True)
        ]
        return head.ljust(80, b" ") + struct.pack("<I", 2) + b"".join(records)

    source = only(put(tmp_path, "a.stl", content(b"VisCAM", [0x8000 | 31 << 10, 0]))).source
    assert np.array_equal(source.colors[::3], [(255, 0, 0, 255), (255, 255, 255, 255)])
    head = b"COLOR=" + bytes([1, 2, 3, 255])
    source = only(put(tmp_path, "a.stl", content(head, [31, 0x8000]))).source
    assert np.array_equal(source.colors[::3], [(255, 0, 0, 255), (1, 2, 3, 255)])
    source = only(put(tmp_path, "a.stl", content(b"", [5, 6]))).source
    assert source.colors is None
    assert source.face_channels["attributes"].tolist() == [5, 6]


# ------------------------------------------------------------------------------------------------------------- OBJ

VT = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
WRITTEN = {
    "continued": V + "f 1 2 \\\n3 4\n",
    "continued, blanks behind": V + "f 1 2 \\ \t\n 3 4\n",
    "a backslash in a comment": "# C:\\dir\\\n" + V + "f 1 2 3 4\n",
    "slashes at the end": V + VT + "f 1/1/ 2/2/ 3/3/ 4/4/\n",
    "empty texture vertices": V + "vn 0 0 1\nf 1//1 2//1 3//1 4//1\n",
    "tabs": V.replace(" ", "\t ") + "f\t1  2\t3   4\n",
    "comments": V.replace("v 1 1 0", "v 1 1 0 # corner") + "f 1 2 3 4# floor\n",
    "weights": V.replace(" 0\n", " 0 1.0\n") + "f 1 2 3 4\n",
    "leading blanks": "  " + V.replace("\n", "\n  ") + "f 1 2 3 4",
    "Fortran": V.replace("1", "1.0D+00") + "f 1 2 3 4\n",
    "ahead": "f 1 2 3 4\n" + V,
    "in between": "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 1 0\nf -4 -2 -1\n",
    "points and lines": V + "p 1 2\nl 1 2 3\nf 1 2 3 4\n",
    "names": "o a b\ng c d\ns 1\n" + V + "s off\nusemtl\nf 1 2 3 4\n",
    "zeros": V + "f 1 2 3 4\n\0\0",
    "not a number, unused": V + "v nan nan nan\nf 1 2 3 4\n",
    "capitals, and the end of DOS": (V + "vn 0 0 1\nf 1 2 3 4\n").upper() + "\x1a",
    "the older word": V + "fo 1 2 3 4\n",
    "two bytes a character": "\ufeff" + V + "f 1 2 3 4\n",
}


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.filterwarnings("ignore:.*not everything is kept")
def test_obj_as_programs_write_it(tmp_path, name, end) -> None:
    text = WRITTEN[name].replace("\n", end)
    path = put(tmp_path, "a.obj", text.encode("utf-16-le" if "two bytes" in name else "utf-8"))
    cut = nrs.NaniteMesh.from_file(path).cut(error=0.0)
    assert len(cut) == 2
    assert area(cut) == pytest.approx(1.0)
    loaded = nrs.load_scene(path)
    assert len(loaded.scene) == 1
    assert len(cut.uvs) == ("slashes" in name)


@pytest.mark.parametrize(
    ("tail", "expected"),
    [
        (" 1 0 0.2", (255, 0, 51, 255)),
        (" 255 0 51", (255, 0, 51, 255)),
        (" 1 1 0 0.2 0.4", (255, 0, 51, 102)),
    ],
)
def test_obj_colors_of_vertices(tmp_path, tail, expected) -> None:
    source = only(put(tmp_path, "a.obj", V.replace("\n", tail + "\n") + VT + "f 1/1 2/2 3/3 4/4\n")).source
    if len(expected) == 4 and expected[3] == 102:
        expected = (255, 0, 51, 102)
    assert (source.colors == expected).all()
    assert len(source.uvs) == 1
    some = V.replace("v 1 1 0", "v 1 1 0 1 0 0")
    source = only(put(tmp_path, "a.obj", some + "f 1 2 3 4\n")).source
    assert np.array_equal(source.colors, [[255] * 4, [255] * 4, [255, 0, 0, 255], [255] * 4])


def test_obj_objects_groups_and_materials_by_name(tmp_path) -> None:
    put(tmp_path, "a.mtl", "newmtl red paint\nKd 1 0 0\nnewmtl b#1\nKd 0 1 0\n")
    text = f"mtllib a.mtl\n{V}o Left arm\nusemtl red  paint\nf 1 2 3\nusemtl b#1\ng x\ns 1\nf 1 3 4\n"
    text += "g y\ns 2\nf 1 2 4\no Top\nusemtl none\nf 2 3 4\n"
    asset = read_asset(put(tmp_path, "a.obj", text))
    assert [name for name, _, _ in asset.placed] == ["Left arm", "Top"]
    arm, (top,) = asset.meshes
    assert [part.material.base_color for part in arm] == [(1, 0, 0), (0, 1, 0)]
    assert [len(part.source.faces) for part in arm] == [1, 2]
    assert arm[1].source.face_channels["group"].tolist() == [0, 1]
    assert arm[1].source.face_channels["smoothing_group"].tolist() == [1, 2]
    assert top.material == nrs.Material()
    assert "materials that no MTL file has (none)" in str(asset.notes)
    assert "groups" in str(asset.notes)
    asset = read_asset(put(tmp_path, "a.obj", V + "f 1 2 4\ng a b\nf 1 2 3\ng c\nf 1 3 4\n"))
    assert [name for name, _, _ in asset.placed] == ["mesh", "a b", "c"]
    assert not str(asset.notes)


def test_obj_keeps_far_coordinates(tmp_path) -> None:
    far = SQUARE * 0.001 + (451234.567, 5412345.678, 321.123)
    text = "".join("v {:.6f} {:.6f} {:.6f}\n".format(*p) for p in far) + "f 1 2 3 4\n"
    assert np.array_equal(only(put(tmp_path, "a.obj", text)).source.vertices, np.round(far, 6))


def test_obj_errors_name_the_line(tmp_path) -> None:
    for tail, what in [
        ("f 0 1 2", "line 5: expected the number of a vertex of 4, found \"0\""),
        ("f 1 2 9", "line 5: there is no vertex 9, only 4"),
        ("f -5 1 2", "line 5: expected the number of a vertex"),
        ("f 1/1 2 3", "line 5: there is no texture vertex 1"),
        ("f 1/2/3/4 2 3", "line 5: expected a corner such as"),
        ("v 0,5 1 2", "line 5: expected a number, found \"0,5\""),
    ]:  # fmt: skip
        for read in (nrs.NaniteMesh.from_file, nrs.load_scene):
            with pytest.raises(nrs.FormatError, match=rf"a\.obj: {what}"):
                read(put(tmp_path, "a.obj", f"{V}{tail}\nf 1 2 3 4\n"))
    asset = read_asset(put(tmp_path, "a.obj", V + "f 1 2 3\ncurv 0 1 1 2\nl 1 2\nmystery 7\n"))
    for what in ("free-form", "points and lines", "mystery"):
        assert what in str(asset.notes)


# ------------------------------------------------------------------------------------------------------------- MTL

NAMES = {
    "blanks": (b"my file.mtl", b"my tex.png", "my file.mtl", "my tex.png"),
    "folders": (b"m.mtl", b"tex dir\\my tex.png", "m.mtl", "tex dir/my tex.png"),
    "another machine": (b"C:\\Users\\a b\\m.mtl", b"/Volumes/a b/my tex.png", "m.mtl", "my tex.png"),
    "UTF-8": ("grün.mtl".encode(), "grønn.png".encode(), "grün.mtl", "grønn.png"),
    "Latin-1": ("grün.mtl".encode("latin-1"), "grønn.png".encode("latin-1"), "grün.mtl", "grønn.png"),
    "Latin-1 on the disk": ("grün.mtl".encode(), "grønn.png".encode(), "gr\udcfcn.mtl", "gr\udcf8nn.png"),
    "decomposed": ("grün.mtl".encode(), b"a.png", "gru\u0308n.mtl", "a.png"),
    "case": (b"M.MTL", b"Textures\\A.PNG", "m.mtl", "textures/a.png"),
    "quotes": (b"./m.mtl", b'"my tex.png"', "m.mtl", "my tex.png"),
    "options behind": (b"m.mtl", b"a b.png -s 2 2 2 -clamp on", "m.mtl", "a b.png"),
    "options in front": (b"m.mtl", b"-bm 0.5 -mm 0 1  my  tex.png", "m.mtl", "my  tex.png"),
    "like options": (b"m.mtl", b"a -s 2.png", "m.mtl", "a -s 2.png"),
}


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("name", NAMES)
def test_mtl_names(tmp_path, name, end) -> None:
    library, picture, on_disk, picture_on_disk = NAMES[name]
    (tmp_path / picture_on_disk).parent.mkdir(exist_ok=True)
    with open(tmp_path / picture_on_disk, "wb") as file:
        Pillow.new("RGB", (2, 2), (200, 20, 20)).save(file, format="PNG")
    lines = [
        b"# C:\\",
        b"\tnewmtl\tm\xc3\xbc  1 # the first",
        b"\tKd\t0.5 0.5 0.5 # grey",
        b"map_Kd\t" + picture,
        b"",
    ]
    (tmp_path / on_disk).write_bytes(end.join(lines))
    obj = [
        b"mtllib " + library,
        *(V + VT).encode().splitlines(),
        b"usemtl m\xfc 1",
        b"f 1/1 2/2 3/3 4/4",
        b"",
    ]
    asset = read_asset(put(tmp_path, "a b.obj", end.join(obj)))
    ((part,),) = asset.meshes
    assert part.material.base_color_texture.image.pixels[0, 0].tolist() == [200, 20, 20]
    assert part.material.base_color[:3] == (0.5, 0.5, 0.5)
    assert part.material.base_color_texture.wrap[0] == ("clamp" if "behind" in name else "repeat")
    assert not str(asset.notes)


def test_several_mtl_files_on_a_line(tmp_path) -> None:
    put(tmp_path, "a.mtl", "newmtl a\nKd 1 0 0\n")
    put(tmp_path, "b.mtl", "\ufeffnewmtl b\nKd 0 1 0\n")
    asset = read_asset(put(tmp_path, "x.obj", f"mtllib a.mtl b.mtl c.mtl\n{V}usemtl b\nf 1 2 3 4\n"))
    assert asset.meshes[0][0].material.base_color == (0, 1, 0)
    assert str(asset.notes) == "materials of files that are missing (c.mtl)"


# ------------------------------------------------------------------------------------------------------------- OFF


def off(keyword: str, tails, faces: str = "4 0 1 2 3\n", first: str = "\n4 1 0\n") -> str:
    lines = ["{:g} {:g} {:g}{}".format(*p, tail) for p, tail in zip(SQUARE, tails, strict=True)]
    return keyword + first + "\n".join(lines) + "\n" + faces


def test_off_keywords(tmp_path) -> None:
    source = only(put(tmp_path, "a.off", off("STCNOFF # all", [" 0 0 1 255 0 51 255 0.5 0.25"] * 4))).source
    assert (source.normals == (0, 0, 1)).all()
    assert (source.colors == (255, 0, 51, 255)).all()
    assert (source.uvs[0] == (0.5, 0.25)).all()
    for tail, expected in (
        (" 1 0 0.2", (255, 0, 51, 255)),
        (" 255 0 51", (255, 0, 51, 255)),
        (" 1. 0 0 .4", (255, 0, 0, 102)),
    ):
        source = only(put(tmp_path, "a.off", off("COFF", [tail] * 4))).source
        assert (source.colors == expected).all()
    plain = only(
        put(tmp_path, "a.off", "# made\r\n\r\n" + off("OFF", [""] * 4, first=" 4 1\r\n # more\r\n"))
    ).source
    assert len(plain.faces) == 2
    for keyword in ("4OFF", "nOFF", "4nOFF"):
        with pytest.raises(
            nrs.FormatError, match=rf"a\.off: line 1: {keyword} has vertices of other than three"
        ):
            read_asset(put(tmp_path, "a.off", off(keyword, [" 1"] * 4)))
    with pytest.raises(nrs.FormatError, match="binary OFF"):
        read_asset(put(tmp_path, "a.off", "OFF BINARY\n"))
    with pytest.raises(nrs.FormatError, match=r"line 7: .*face 0 of 1.*, found the end of the file"):
        read_asset(put(tmp_path, "a.off", off("OFF", [""] * 4, faces="4 0 1")))
    with pytest.raises(nrs.FormatError, match=r"line 7: face 0 of 1: there is no vertex 4, only 4"):
        read_asset(put(tmp_path, "a.off", off("OFF", [""] * 4, faces="3 0 1 4\n")))


def test_off_colors_of_faces(tmp_path) -> None:
    text = off("OFF", [""] * 4, "3 0 1 2 255 0 0\n3 0 2 3 0.0 1.0 0.0 0.4\n3 1 2 3\n", "\n4 3 0\n")
    source = only(put(tmp_path, "a.off", text)).source
    assert np.array_equal(source.colors[source.faces][:, 0], [(255, 0, 0, 255), (0, 255, 0, 102), (255,) * 4])


# ----------------------------------------------------------------------------------------------- against others


@pytest.mark.parametrize("name", ["a.ply", "b.ply", "a.stl", "b.stl", "a.off", "a.obj"])
def test_what_meshio_writes(tmp_path, name) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=2000)
    mesh = meshio.Mesh(np.asarray(vertices, np.float64), [("triangle", np.asarray(faces, np.int64))])
    binary = {} if name.endswith(("off", "obj")) else {"binary": name.startswith("a")}
    meshio.write(tmp_path / name, mesh, **binary)
    ours, theirs = rows(only(tmp_path / name).source), rows(trimesh.load(tmp_path / name, process=False))
    assert np.allclose(ours, theirs, atol=1e-6)


@pytest.mark.parametrize(
    "place",
    [
        ("nasty", "cgal_b9_mesh", "b9_mesh.off"),
        ("nasty", "cycloidal", "cycloidal.ply"),
        ("nasty", "chair_model", "chair_model.obj"),
        ("cad", "octagonal_pocket", "octagonal_pocket.stl"),
        ("scans", "horse_full", "horse.ply"),
        ("scans", "mountain", "mountain.obj"),
    ],
)
def test_real_files_are_as_trimesh_reads_them(place) -> None:
    path = data.require(*place)
    asset = read_asset(path, drop_bad_textures=True)
    theirs = trimesh.load(path, process=False, force="mesh")
    ours = [part.source for mesh in asset.meshes for part in mesh]
    assert sum(len(source.faces) for source in ours) == len(theirs.faces)
    assert sum(area(source) for source in ours) == pytest.approx(float(theirs.area), rel=1e-5)
