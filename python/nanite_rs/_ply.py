"""PLY as meshes: which properties are positions, normals, colours and UVs, and all others by name."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core
from nanite_rs._asset import UV_SETS, Asset, Notes, Source, StrokePart, fitted
from nanite_rs._beside import Pictures, text
from nanite_rs._faces import add, add_channels, colors_of, corner_numbers, exploded, plain, triangulated
from nanite_rs.exceptions import FormatError, MeshError
from nanite_rs.material import Material
from nanite_rs.texture import Texture

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

# Names in use; the types of all of them are free.
_NORMAL: Final = re.compile(r"n(?:ormal)?_?([xyz])")
_UV: Final = re.compile(r"((?:texture|texcoord|tex|uv)?_?\d*_?)([stuv])(_?\d*)")
_COLORS: Final = [
    [prefix + name for name in names]
    for prefix in ("", "diffuse_", "vertex_")
    for names in (("red", "green", "blue", "alpha"), ("r", "g", "b", "a"))
]
#: Names of the list of a face's vertices.
INDICES: Final = ("vertex_indices", "vertex_index", "vertex_indexes", "indices")
#: Comments that name a texture.
TEXTURE: Final = re.compile(rb"comment\s+TextureFile\s+(.+)", re.IGNORECASE)

#: Properties of an element: values, and lengths where they are lists.
_Columns = dict[str, "tuple[NDArray[Any], NDArray[np.uint32] | None]"]


def read(name: str, data: bytes, folder: Path | None, *, drop_bad_textures: bool) -> Asset:
    """Read a PLY file.

    Vertices keep every property: those that are no position, normal, colour or texture coordinate are channels of
    their names. Faces keep theirs as face channels, but for colours, which become those of vertices, and texture
    coordinates of corners. What is left out is noted.
    """
    return _Reader(name, data, folder, drop_bad_textures).asset()


def vertices(name: str, rows: int, columns: _Columns, notes: Notes) -> Source:
    """Return the vertices of a mesh without faces, from the properties of so many rows."""
    source, colors, names = split_vertices(name, rows, columns, notes)
    source.colors = None if colors is None else colors_of(colors)
    add_channels(source.channels, names, notes, "vertices")
    return source


def split_vertices(
    name: str, rows: int, columns: _Columns, notes: Notes
) -> tuple[Source, list[NDArray[Any]] | None, dict[str, NDArray[Any]]]:
    """Return vertices without colours and channels, the columns of colours, and the properties that are left."""
    names = _scalars(columns, "vertices", notes)
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise FormatError(f"{name}: element vertex has no property {missing[0]}")
    points = np.empty((rows, 3))
    for axis, letter in enumerate("xyz"):
        points[:, axis] = names.pop(letter)
    source = Source(points, np.zeros((0, 3), np.int64))
    normal = {match[1]: name for name in names if (match := _NORMAL.fullmatch(name.lower()))}
    if len(normal) == 3:
        source.normals = np.stack([names.pop(normal[axis]) for axis in "xyz"], axis=1).astype(np.float32)
    colors = take_colors(names)
    source.uvs = _take_uvs(names)
    return source, colors, names


def _scalars(columns: _Columns, of: str, notes: Notes, but: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """Scalar properties by name, coordinates in lower case; lists are noted."""
    out = {}
    for name, (values, lengths) in columns.items():
        if lengths is None:
            out[name.lower() if name in ("X", "Y", "Z") else name] = values
        elif name not in but:
            notes.add(f"lists of {of}", name)
    return out


def textures_of(lines: Iterable[bytes]) -> list[str]:
    """Return the textures that comments name."""
    return [text(match[1].strip()) for line in lines if (match := TEXTURE.fullmatch(line))]


def textured(name: str, names: list[str], pictures: Pictures, uv_sets: int, notes: Notes) -> list[Material]:
    """Return the looks of the textures of a file."""
    looks = []
    for texture in names:
        image = pictures.get(f"{name}: TextureFile", texture)
        shown = None if image is None else Texture(image)
        look = Material(base_color=(1.0, 1.0, 1.0), base_color_texture=shown)
        looks.append(fitted(look, texture, uv_sets, notes))
    return looks


class _Reader:
    def __init__(self, name: str, data: bytes, folder: Path | None, drop: bool) -> None:
        self._name = name
        self._asset = Asset(name)
        self._notes = self._asset.notes
        self._pictures = Pictures(folder, drop, self._notes)
        found = _core.read_ply(name, data)
        self._comments: list[bytes] = found["comments"]
        self._elements: dict[str, tuple[int, _Columns]] = {}
        for label, rows, columns in found["elements"]:
            self._elements.setdefault(label.lower(), (rows, columns))
        if found["behind"] and data[-found["behind"] :].strip(b"\0 \t\r\n"):
            self._notes.add(f"{found['behind']} bytes or words behind the last row")

    def asset(self) -> Asset:
        for label, (rows, _) in self._elements.items():
            if rows and label not in ("vertex", "face", "tristrips", "edge"):
                self._notes.add("elements of PLY that are no part of a mesh", label)
        source = self._vertices()
        polygons = self._polygons(source)
        if polygons is None:
            self._cloud(source)
            return self._asset
        if self._elements.get("edge", (0, {}))[0]:
            self._notes.add("edges besides faces")
        self._faces(source, *polygons)
        add(self._asset, "mesh", [("mesh", source, self._material(source))])
        return self._asset

    def _cloud(self, source: Source) -> None:
        """Add what has no faces as points, and its edges as lines."""
        finite = np.asarray(np.isfinite(source.vertices).all(axis=1))
        if not finite.any():
            return
        if not finite.all():
            self._notes.add(f"{len(finite) - finite.sum()} points that are not finite")
        if source.channels:
            self._notes.add("properties of points", ", ".join(source.channels))
        colors = None if source.colors is None else source.colors[:, :3]
        parts = [
            StrokePart("points", source.vertices[finite], None, None if colors is None else colors[finite])
        ]
        rows, columns = self._elements.get("edge", (0, {}))
        if rows and {"vertex1", "vertex2"} <= columns.keys():
            ends = np.stack([columns[name][0] for name in ("vertex1", "vertex2")], axis=1)
            if ends.min() < 0 or ends.max() >= len(finite):
                row = int(np.argmax(((ends < 0) | (ends >= len(finite))).any(axis=1)))
                raise MeshError(f"{self._name}: edge[{row}] refers to none of the {len(finite)} vertices")
            ends = ends[finite[ends.astype(np.int64)].all(axis=1)].astype(np.int64)
            if len(ends):
                number = np.cumsum(finite) - 1
                parts.append(replace(parts[0], name="edges", segments=number[ends]))
        self._asset.placed.append(("points", 0, np.eye(4)))
        self._asset.meshes.append([])
        self._asset.strokes[0] = parts

    # -------------------------------------------------------------------------------------- vertices

    def _vertices(self) -> Source:
        rows, columns = self._elements.get("vertex", (0, {}))
        return vertices(self._name, rows, columns, self._notes)

    # ----------------------------------------------------------------------------------------- faces

    def _polygons(self, source: Source) -> tuple[NDArray[np.uint32], NDArray[np.uint32]] | None:
        """Vertices of all polygons and how many each has; strips follow faces as triangles."""
        count = len(source.vertices)
        corners, counts = [], []
        for label in ("face", "tristrips"):
            _, columns = self._elements.get(label, (0, {}))
            key = next((key for key in INDICES if key in columns), None)
            if key is None:
                continue
            values, lengths = columns[key]
            if lengths is None or not len(values):
                continue
            if label == "tristrips":
                triangles = _core.strips(np.ascontiguousarray(values, np.int64), lengths)
                values, lengths = triangles.reshape(-1), np.full(len(triangles), 3, np.uint32)
            corners.append(corner_numbers(self._name, values, lengths, count))
            counts.append(lengths)
        if not corners:
            return None
        if len(corners) == 1:
            return corners[0], counts[0]
        return np.concatenate(corners), np.concatenate(counts)

    def _faces(self, source: Source, corners: NDArray[np.uint32], counts: NDArray[np.uint32]) -> None:
        """Fill in triangles and what the file says about faces."""
        triangles, polygons, without = triangulated(self._name, source.vertices, corners, counts)
        if without:
            self._notes.add(f"{without} faces of fewer than three corners")
        rows, columns = self._elements.get("face", (0, {}))
        wedges = columns.get("texcoord")
        names = _scalars(columns, "faces", self._notes, (*INDICES, "texcoord"))
        if rows and rows != len(counts):
            # Strips have no properties.
            for name in names:
                self._notes.add("properties of faces in files with strips", name)
            names, wedges = {}, None
        elif rows == 0:
            names, wedges = {}, None
        columns_of_colors = take_colors(names) if source.colors is None else None
        colors = None if columns_of_colors is None else colors_of(columns_of_colors)
        numbers = names.pop("texnumber", None) if wedges is not None else None
        own = (
            None
            if wedges is None or wedges[1] is None
            else wedges_of(self._name, wedges[0], wedges[1], counts)
        )
        if own is None and colors is None:
            # With triangles only, the corners are the list itself.
            whole = isinstance(polygons, slice)
            source.faces = np.asarray(corners.reshape(-1, 3) if whole else corners[triangles])
        else:
            exploded(source, corners, triangles)
        if own is not None:
            source.uvs = [own, *source.uvs][:UV_SETS]
        if colors is not None:
            source.colors = np.repeat(colors, counts, axis=0)
        if numbers is not None:
            source.face_materials = numbers.astype(np.int32)[polygons]
        add_channels(
            source.face_channels,
            {name: values[polygons] for name, values in names.items()},
            self._notes,
            "faces",
        )

    # -------------------------------------------------------------------------------------- materials

    def _material(self, source: Source) -> Material | list[Material]:
        names = textures_of(self._comments)
        looks = textured(self._name, names, self._pictures, len(source.uvs), self._notes)
        numbers, source.face_materials = source.face_materials, None
        if not looks:
            if numbers is not None and numbers.any():
                source.face_channels["texnumber"] = numbers
            return plain(source)
        if numbers is None:
            for name in names[1:]:
                self._notes.add("textures that no face names", name)
            return looks[0]
        # Faces without a texture, such as -1, come last.
        outside = (numbers < 0) | (numbers >= len(looks))
        if outside.any():
            numbers = np.where(outside, len(looks), numbers).astype(np.int32)
            looks.append(plain(source))
        if len(looks) == 1:
            return looks[0]
        source.face_materials = numbers
        return looks


def wedges_of(
    name: str, values: NDArray[Any], lengths: NDArray[np.uint32], counts: NDArray[np.uint32], first: int = 0
) -> NDArray[np.float32] | None:
    """Return texture coordinates of corners, zero where a face has none, and None where none has any."""
    bad = (lengths != 0) & (lengths != 2 * counts)
    if bad.any():
        row = int(np.argmax(bad))
        found = f"{lengths[row]} texture coordinates for {counts[row]} corners"
        raise FormatError(f"{name}: element face, row {first + row}: {found}")
    if not lengths.any():
        return None
    if (lengths != 0).all():
        return values.reshape(-1, 2).astype(np.float32)
    out = np.zeros((int(counts.sum()), 2), np.float32)
    out[np.repeat(lengths != 0, counts)] = values.reshape(-1, 2)
    return out


def take_colors(names: dict[str, NDArray[Any]]) -> list[NDArray[Any]] | None:
    """Take the columns of colours out of properties."""
    lower = {name.lower(): name for name in names}
    for wanted in _COLORS:
        if all(name in lower for name in wanted[:3]):
            return [names.pop(lower[name]) for name in wanted if name in lower]
    return None


def _take_uvs(names: dict[str, NDArray[Any]]) -> list[NDArray[np.float32]]:
    """Take pairs of texture coordinates out of properties, such as s and t, u1 and v1, texture_u and texture_v."""
    pairs: dict[tuple[str, str, str], dict[str, str]] = {}
    for name, values in names.items():
        match = _UV.fullmatch(name.lower())
        if match and values.dtype.kind == "f":
            first = match[2] in "su"
            family = "st" if match[2] in "st" else "uv"
            pairs.setdefault((match[1], family, match[3]), {})["first" if first else "second"] = name
    full = [pair for pair in pairs.values() if len(pair) == 2][:UV_SETS]
    return [
        np.stack([names.pop(pair["first"]), names.pop(pair["second"])], axis=1).astype(np.float32)
        for pair in full
    ]
