"""Surfaces as files of other formats: OBJ, PLY, STL and OFF here, the rest by others."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors, _export_gltf, _export_usd, _trimesh
from nanite_rs._asset import Notes
from nanite_rs._export_packing import Packing
from nanite_rs._export_parts import COLORS, Document, Piece, Surface, image_file, pieces, textures
from nanite_rs._images import beside
from nanite_rs.exceptions import FormatError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray


DOCUMENTS: Final[dict[str, Callable[[Notes, str, Packing | None], Document]]] = {
    "glb": _export_gltf.Document,
    "gltf": _export_gltf.Document,
    **dict.fromkeys(_export_usd.ENDINGS, _export_usd.Document),
}
"""Formats that hold more than one surface, by their endings."""


def export(surface: Surface, path: str, compression: object = None) -> None:
    """Write a surface in the format of a path's ending; what the format cannot hold is named in a warning."""
    notes = Notes()
    write(files_of(surface, path, notes, Packing.of(compression, ending_of(path))))
    notes.warn(path)


def files_of(surface: Surface, path: str, notes: Notes, packing: Packing | None = None) -> dict[str, bytes]:
    """Return the files of a surface by their paths."""
    ending = ending_of(path)
    if ending in DOCUMENTS:
        document = DOCUMENTS[ending](notes, path, packing)
        document.place(document.mesh(surface), np.eye(4))
        return document.files()
    writer = _WRITERS.get(ending)
    return _by_trimesh(surface, path, ending, notes) if writer is None else writer(surface, path, notes)


def write(files: Mapping[str, bytes]) -> None:
    """Write files, each in one step or not at all."""
    for name, content in files.items():
        with beside(name) as temporary:
            Path(temporary).write_bytes(content)


def ending_of(path: str) -> str:
    """Return the ending of a path that can be written; any other is an error."""
    ending = Path(path).suffix.lower().removeprefix(".")
    known = set(_WRITERS) | set(DOCUMENTS)
    if ending not in known:
        import trimesh

        theirs = set(trimesh.exchange.export._mesh_exporters) - {"dict", "dict64", "stl_ascii"}
        if ending not in theirs:
            some = ", ".join(sorted(theirs | known))
            raise FormatError(f"{path}: cannot write that; what can be written are {some}")
    return ending


# ------------------------------------------------------------------------------------------------------- OBJ


def _lines(row: str, values: NDArray[Any]) -> str:
    return (row * len(values)) % tuple(values.reshape(-1).tolist())


def _numbers(values: NDArray[Any]) -> str:
    """Format a number such that it reads back as the same."""
    return "%.17g" if values.dtype == np.float64 else "%.9g"


def _word(label: str) -> str:
    """A name as OBJ and MTL can hold it: one word."""
    return "_".join(label.split())


def _obj(surface: Surface, path: str, notes: Notes) -> dict[str, bytes]:
    digits = _numbers(surface.vertices)
    text = [] if not surface.materials else [f"mtllib {Path(path).stem}.mtl\n"]
    if surface.fine_colors is None:
        text.append(_lines(f"v {digits} {digits} {digits}\n", surface.vertices))
    else:
        rows = np.concatenate(
            [surface.vertices.astype(np.float64), _colors.unit(surface.fine_colors[:, :3])], axis=1
        )
        text.append(_lines(f"v {digits} {digits} {digits} %.9g %.9g %.9g\n", rows))
        _note(
            notes,
            "alpha of vertex colours",
            not _colors.is_white(_colors.as_bytes(surface.fine_colors[:, 3])),
        )
    text.extend(_lines("vt %.9g %.9g\n", uv) for uv in surface.uvs[:1])
    text.append(_lines("vn %.9g %.9g %.9g\n", surface.normals))
    corner = "%d/%d/%d" if surface.uvs else "%d//%d"
    files: dict[str, bytes] = {}
    looks = []
    split = pieces(surface)
    for piece in split:
        if surface.materials or len(split) > 1:
            text.append(f"usemtl {_word(piece.label)}\n")
        corners = np.repeat(piece.used[piece.faces].reshape(-1) + 1, 3 if surface.uvs else 2)
        text.append(_lines(f"f {corner} {corner} {corner}\n", corners.reshape(len(piece.faces), -1)))
        if surface.materials:
            looks.append(_mtl(piece, path, files, notes))
    if looks:
        files[str(Path(path).with_suffix(".mtl"))] = "\n".join(looks).encode()
    files[path] = "".join(text).encode()
    _note(notes, "UV sets beyond the first", len(surface.uvs) > 1)
    for name in surface.channels:
        notes.add("channels", name)
    return files


def _mtl(piece: Piece, path: str, files: dict[str, bytes], notes: Notes) -> str:
    """Write a material of an MTL file; its images go into ``files``."""
    look, name = piece.material, _word(piece.label)
    rough = max(look.roughness, 0.04)
    rows = [
        f"newmtl {name}",
        "Kd %.9g %.9g %.9g" % look.base_color[:3],  # noqa: UP031
        "Ke %.9g %.9g %.9g" % look.emissive,  # noqa: UP031
        f"Ns {max(2.0 / rough**4 - 2.0, 0.0):.9g}",
        f"Pm {look.metallic:.9g}",
    ]
    if look.alpha_mode != "opaque":
        rows.append(f"d {(*look.base_color, 1.0)[3]:.9g}")
    maps = {"base_color_texture": "map_Kd", "emissive_texture": "map_Ke", "normal_texture": "norm"}
    for slot, texture in textures(look):
        if slot not in maps or texture.uv_set or texture.rotation:
            what = slot.replace("_", " ") + ("s" if slot in maps else "s, which MTL has none of")
            notes.add(what + (" on other UV sets, or turned" if slot in maps else ""), name)
            continue
        data, ending = image_file(texture.image, slot in COLORS, notes)
        known = next((file for file, content in files.items() if content is data or content == data), None)
        file = known or str(Path(path).with_name(f"{Path(path).stem}_{len(files)}.{ending}"))
        files[file] = data
        (u, v), (su, sv) = texture.offset, texture.scale
        # Texture coordinates count from below here, from above in glTF: 1 − (sv (1 − v) + ov) = sv v + 1 − sv − ov.
        moved = (
            "" if (u, v, su, sv) == (0, 0, 1, 1) else f"-s {su:.9g} {sv:.9g} 1 -o {u:.9g} {1 - sv - v:.9g} 0 "
        )
        clamped = "-clamp on " if texture.wrap == ("clamp", "clamp") else ""
        rows.append(f"{maps[slot]} {clamped}{moved}{Path(file).name}")
        if slot == "base_color_texture" and look.alpha_mode == "mask":
            rows.append(f"map_d {clamped}{moved}{Path(file).name}")
    _note(notes, "metallic factors", look.metallic > 0.0, name)
    _note(notes, "double-sided materials", look.double_sided, name)
    _note(notes, "flat shading", not look.smooth, name)
    return "\n".join(rows) + "\n"


def _note(notes: Notes, what: str, is_so: Any, whose: str = "") -> None:
    if is_so:
        notes.add(what, whose)


# ------------------------------------------------------------------------------------------- PLY, STL and OFF


def _left_out(surface: Surface, notes: Notes, *what: str) -> None:
    """Note what a format without materials leaves out."""
    found = {
        "colours": surface.colors is not None,
        "UVs": bool(surface.uvs),
        "materials": bool(surface.materials),
        "face materials": surface.face_materials is not None and not surface.materials,
        "digits beyond float32": surface.vertices.dtype == np.float64,
    }
    for name in what:
        _note(notes, name, found.get(name))
    if "channels" in what:
        for name in surface.channels:
            notes.add("channels", name)


def _ply(surface: Surface, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(surface, notes, "materials")
    columns: list[tuple[str, NDArray[Any]]] = []

    def add(names: str | list[str], values: NDArray[Any]) -> None:
        names = names.split() if isinstance(names, str) else names
        columns.extend((name, values.reshape(len(values), -1)[:, k]) for k, name in enumerate(names))

    add("x y z", surface.vertices)
    add("nx ny nz", surface.normals)
    if surface.fine_colors is not None:
        add("red green blue alpha", surface.fine_colors)
    for number, uv in enumerate(surface.uvs):
        add("s t" if not number else f"s{number} t{number}", uv)
    for name, values in surface._vertex_channels.items():
        add(*_properties(name, values))
    vertices = np.rec.fromarrays([values.astype(values.dtype.newbyteorder("<")) for _, values in columns])
    faces = [
        np.full(len(surface.faces), 3, np.uint8),
        *(surface.faces[:, k].astype("<i4") for k in range(3)),
    ]
    head = ["ply", "format binary_little_endian 1.0", "comment nanite_rs", f"element vertex {len(vertices)}"]
    head += [f"property {_PLY[values.dtype.str[1:]]} {name}" for name, values in columns]
    head += [f"element face {len(surface.faces)}", "property list uchar int vertex_indices"]
    if surface.face_materials is not None:
        faces.append(surface.face_materials.astype("<i4"))
        head.append("property int material_index")
    for name, values in surface.face_channels.items():
        names, labels = _properties(name, values)
        rows = labels.reshape(len(labels), -1)
        for k, label in enumerate(names):
            faces.append(rows[:, k].astype(rows.dtype.newbyteorder("<")))
            head.append(f"property {_PLY[rows.dtype.str[1:]]} {label}")
    text = "\n".join([*head, "end_header", ""]).encode()
    return {path: text + vertices.tobytes() + np.rec.fromarrays(faces).tobytes()}


def _properties(name: str, values: NDArray[Any]) -> tuple[list[str], NDArray[Any]]:
    """Names without blanks, a number each, and values of a type that PLY has."""
    values = values.astype(np.uint8) if values.dtype == bool else values
    if values.dtype.itemsize == 8:
        values = values.astype(np.int32 if values.dtype.kind == "i" else np.uint32)
    label = "_".join(name.split()) or "_"
    return [label] if values.ndim == 1 else [f"{label}_{k}" for k in range(values.shape[1])], values


_PLY: Final = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}


def _stl(surface: Surface, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(
        surface, notes, "colours", "UVs", "materials", "face materials", "channels", "digits beyond float32"
    )
    corners = surface.vertices[surface.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    rows = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("size", "<u2")])
    rows["normal"] = across / np.where(length > 0.0, length, 1.0)
    rows["corners"] = corners
    return {path: b"nanite_rs".ljust(80, b"\0") + struct.pack("<I", len(rows)) + rows.tobytes()}


def _off(surface: Surface, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(surface, notes, "colours", "UVs", "materials", "face materials", "channels")
    digits = _numbers(surface.vertices)
    text = f"OFF\n{len(surface.vertices)} {len(surface.faces)} 0\n"
    text += _lines(f"{digits} {digits} {digits}\n", surface.vertices) + _lines("3 %d %d %d\n", surface.faces)
    return {path: text.encode()}


def _by_trimesh(surface: Surface, path: str, ending: str, notes: Notes) -> dict[str, bytes]:
    try:
        content = _trimesh.made(surface, process=False).export(file_type=ending)
    except ImportError as error:
        # trimesh makes the error anew.
        named = re.search(r"'([\w.]+)'", str(error))
        package = error.name or (named[1] if named else "an optional package")
        raise _advice.missing(path, package) from error
    _left_out(surface, notes, "UVs", "materials", "face materials", "channels")
    return {path: content.encode() if isinstance(content, str) else bytes(content)}


_WRITERS: Final = {"obj": _obj, "off": _off, "ply": _ply, "stl": _stl}
