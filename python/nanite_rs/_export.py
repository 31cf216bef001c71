"""Cuts as files of other formats: GLB and glTF with all attributes, other formats with those that they support."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors
from nanite_rs._asset import GLTF_SLOTS, MINIFICATION, TEXTURES, WRAPS, Notes
from nanite_rs._images import JPEG, PNG, beside
from nanite_rs.exceptions import FormatError
from nanite_rs.material import Material, default_material

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from nanite_rs.cut import Cut
    from nanite_rs.texture import Image, Texture

# Textures whose integers are sRGB.
COLORS: Final = ("base_color_texture", "emissive_texture")

_WRAP_NUMBERS: Final[dict[str, int]] = {wrap: number for number, wrap in WRAPS.items()}


def export(cut: Cut, path: str) -> None:
    """Write a cut in the format of the ending of ``path``; what the format cannot hold is named in a warning."""
    ending = ending_of(path)
    notes = Notes()
    writer = _WRITERS.get(ending)
    if writer is None:
        files = _by_trimesh(cut, path, ending, notes)
    else:
        files = writer(cut, path, notes)
    for name, content in files.items():
        with beside(name) as temporary:
            Path(temporary).write_bytes(content)
    notes.warn(path)


def ending_of(path: str) -> str:
    """Return the ending of a path that can be written; any other is an error."""
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending not in _WRITERS:
        import trimesh

        theirs = set(trimesh.exchange.export._mesh_exporters) - {"dict", "dict64", "stl_ascii"}
        if ending not in theirs:
            known = ", ".join(sorted(theirs | set(_WRITERS)))
            raise FormatError(f"{path}: cannot write that; what can be written are {known}")
    return ending


# ------------------------------------------------------------------------------------------ what is written


@dataclass
class Piece:
    """The faces of one material, with numbers among the vertices that they use."""

    number: int
    """Face material."""
    label: str
    """What a file calls it."""
    material: Material
    used: NDArray[np.int64]
    faces: NDArray[np.int64]


def labels(materials: Sequence[Material]) -> list[str]:
    """Name materials as they are named, and apart: those without a name by their number."""
    found: dict[str, None] = {}
    for number, material in enumerate(materials):
        own = material.name or f"material_{number}"
        found[own if own not in found else f"{own}_{number}"] = None
    return list(found) if len(found) == len(materials) else [f"material_{k}" for k in range(len(materials))]


def pieces(cut: Cut) -> list[Piece]:
    """Split a cut by looks, or by face materials where it has no looks."""
    numbers = cut.face_materials
    rows = np.zeros(len(cut.faces), np.int64) if numbers is None else numbers.astype(np.int64)
    last = len(cut.materials) - 1
    if cut.materials:
        # The last material stands for all further numbers, and for negative ones.
        rows = np.where((rows < 0) | (rows > last), last, rows)
    names = labels(cut.materials)
    out = []
    for number in np.unique(rows).tolist():
        used, faces = np.unique(cut.faces[rows == number], return_inverse=True)
        colored = cut.colors is not None
        material = cut.materials[number] if cut.materials else default_material(colored=colored)
        label = names[number] if names else f"material_{number}"
        out.append(Piece(number, label, material, used, faces.reshape(-1, 3)))
    return out


def textures(material: Material) -> Iterator[tuple[str, Texture]]:
    """Return the textures of a material with the names of their slots."""
    for slot in TEXTURES:
        texture = getattr(material, slot)
        if texture is not None:
            yield slot, texture


def png(pixels: NDArray[Any]) -> bytes:
    """Encode (H, W, 1 to 4) uint8 or uint16 as PNG."""
    height, width, channels = pixels.shape
    rows = np.ascontiguousarray(pixels, ">u2" if pixels.dtype.itemsize == 2 else np.uint8)
    raw = rows.view(np.uint8).reshape(height, -1)
    filtered = np.empty((height, raw.shape[1] + 1), np.uint8)
    filtered[:, 0] = 2  # each row as the difference from the one above
    filtered[:, 1:] = raw
    filtered[1:, 1:] -= raw[:-1]

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    kind = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    head = struct.pack(">IIBBBBB", width, height, 8 * pixels.dtype.itemsize, kind, 0, 0, 0)
    body = zlib.compress(filtered.tobytes(), 6)
    return PNG + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def integers(image: Image, color: bool, notes: Notes) -> NDArray[Any]:
    """Return the pixels as files have them: uint8 or uint16, colours in sRGB."""
    pixels = image.pixels
    if pixels.dtype.kind != "f":
        return pixels
    if pixels.min() < 0.0 or pixels.max() > 1.0:
        notes.add("pixels below 0 and above 1")
    pixels = np.clip(pixels, 0.0, 1.0)
    if color:
        # Floats are linear; alpha is linear in files too.
        count = pixels.shape[2] - (pixels.shape[2] in (2, 4))
        bright = pixels[..., :count]
        curve = np.where(bright <= 0.0031308, bright * 12.92, 1.055 * bright ** (1 / 2.4) - 0.055)
        pixels = np.concatenate([curve, pixels[..., count:]], axis=2)
    return np.rint(pixels * 65535.0).astype(np.uint16)


def image_file(image: Image, color: bool, notes: Notes) -> tuple[bytes, str]:
    """Return an image as the file that it came from, or as PNG, and its ending."""
    data = image.encoded()
    if data is not None and data.startswith((PNG, JPEG)):
        return data, "png" if data.startswith(PNG) else "jpg"
    return png(integers(image, color, notes)), "png"


# ------------------------------------------------------------------------------------------------------ glTF


class _Gltf:
    """A document that is filled table by table, and the bytes that it refers to."""

    def __init__(self, notes: Notes) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "nanite_rs"}, "scene": 0}
        self.body = bytearray()
        self._notes = notes
        self._known: dict[Any, int] = {}
        self._extensions: set[str] = set()

    def row(self, table: str, fields: dict[str, Any], key: Any = None) -> int:
        """Add a row; one of the same key is there once."""
        rows = self.json.setdefault(table, [])
        if key is not None and (table, key) in self._known:
            return self._known[table, key]
        rows.append(fields)
        if key is not None:
            self._known[table, key] = len(rows) - 1
        return len(rows) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        """Add bytes."""
        self.body += bytes(-len(self.body) % 4)
        fields |= {"buffer": 0, "byteOffset": len(self.body), "byteLength": len(data)}
        self.body += data
        return self.row("bufferViews", fields)

    def accessor(self, array: NDArray[Any], *, target: int = 34962, **fields: Any) -> int:
        """Add numbers, (N,) or (N, K), rows of vertices at multiples of four bytes."""
        rows = np.ascontiguousarray(array).reshape(len(array), -1)
        width = rows.shape[1]
        raw = rows.view(np.uint8).reshape(len(rows), -1)
        pad = -raw.shape[1] % 4 if target == 34962 else 0
        if pad:
            raw = np.concatenate([raw, np.zeros((len(raw), pad), np.uint8)], axis=1)
            view = self.view(raw.tobytes(), target=target, byteStride=raw.shape[1])
        else:
            view = self.view(raw.tobytes(), target=target)
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        fields |= {
            "bufferView": view,
            "componentType": kinds[rows.dtype.str[1:]],
            "count": len(rows),
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[width],
        }
        return self.row("accessors", fields)

    def extension(self, name: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return an extension for what has it."""
        self._extensions.add(name)
        return {name: fields}

    # ---------------------------------------------------------------------------------------- looks

    def material(self, look: Material, name: str) -> int:
        """Add a material with its textures."""
        slots = dict(textures(look))

        def info(slot: str, **more: Any) -> dict[str, Any]:
            texture = slots.get(slot)
            return {} if texture is None else {GLTF_SLOTS[slot]: self._texture(texture, slot) | more}

        rough: dict[str, Any] = {
            "baseColorFactor": [*look.base_color, 1.0][:4],
            "metallicFactor": look.metallic,
            "roughnessFactor": look.roughness,
            **info("base_color_texture"),
            **info("metallic_roughness_texture"),
        }
        fields: dict[str, Any] = {"name": name, "pbrMetallicRoughness": rough}
        fields |= info("normal_texture", scale=look.normal_scale)
        fields |= info("occlusion_texture", strength=look.occlusion_strength)
        fields |= info("emissive_texture")
        brightest = max(look.emissive)
        if brightest > 0.0:
            fields["emissiveFactor"] = [value / max(brightest, 1.0) for value in look.emissive]
        extensions: dict[str, Any] = {}
        if brightest > 1.0:
            strength = {"emissiveStrength": brightest}
            extensions |= self.extension("KHR_materials_emissive_strength", strength)
        if look.unlit:
            extensions |= self.extension("KHR_materials_unlit", {})
        if extensions:
            fields["extensions"] = extensions
        if look.double_sided:
            fields["doubleSided"] = True
        if look.alpha_mode != "opaque":
            fields["alphaMode"] = look.alpha_mode.upper()
        if look.alpha_mode == "mask":
            fields["alphaCutoff"] = look.alpha_cutoff
        return self.row("materials", fields)

    def _texture(self, texture: Texture, slot: str) -> dict[str, Any]:
        color = slot in COLORS
        key = id(texture.image), color and texture.image.pixels.dtype.kind == "f"
        if ("images", key) not in self._known:
            data, ending = image_file(texture.image, color, self._notes)
            kind = "image/png" if ending == "png" else "image/jpeg"
            self.row("images", {"bufferView": self.view(data), "mimeType": kind}, key)
        sampler = {
            "magFilter": 9728 if texture.filter == "nearest" else 9729,
            "minFilter": MINIFICATION[texture.filter, texture.mipmaps],
            "wrapS": _WRAP_NUMBERS[texture.wrap[0]],
            "wrapT": _WRAP_NUMBERS[texture.wrap[1]],
        }
        fields = {
            "source": self._known["images", key],
            "sampler": self.row("samplers", sampler, tuple(sampler.values())),
        }
        out: dict[str, Any] = {"index": self.row("textures", fields, tuple(fields.values()))}
        if texture.uv_set:
            out["texCoord"] = texture.uv_set
        moved = {
            "offset": list(texture.offset),
            "rotation": float(texture.rotation),
            "scale": list(texture.scale),
        }
        if moved != {"offset": [0.0, 0.0], "rotation": 0.0, "scale": [1.0, 1.0]}:
            out["extensions"] = self.extension("KHR_texture_transform", moved)
        return out

    def finished(self, **buffer: Any) -> bytes:
        """Return the JSON, with the buffer that it refers to."""
        if self._extensions:
            self.json["extensionsUsed"] = sorted(self._extensions)
        self.json["buffers"] = [{"byteLength": len(self.body), **buffer}]
        return json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()


def _document(cut: Cut, notes: Notes) -> _Gltf:
    out = _Gltf(notes)
    vertices, node = cut.vertices, {"mesh": 0}
    if vertices.dtype == np.float64:
        # Accessors hold float32, so the node has the large part of positions.
        origin = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        vertices, node = (vertices - origin).astype(np.float32), {"mesh": 0, "translation": origin.tolist()}
    extra, colors = _channels(cut, notes), cut.fine_colors
    primitives = []
    for piece in pieces(cut):
        own = vertices[piece.used]
        attributes = {
            "POSITION": out.accessor(own, min=own.min(axis=0).tolist(), max=own.max(axis=0).tolist())
        }
        if piece.material.smooth:  # without normals faces are flat
            attributes["NORMAL"] = out.accessor(cut.normals[piece.used])
        if colors is not None:
            whole = {"normalized": True} if colors.dtype.kind == "u" else {}
            attributes["COLOR_0"] = out.accessor(colors[piece.used], **whole)
        for number, uv in enumerate(cut.uvs):
            upright = uv[piece.used].astype(np.float64) * (1.0, -1.0) + (0.0, 1.0)
            attributes[f"TEXCOORD_{number}"] = out.accessor(upright.astype(np.float32))
        for name, values in extra.items():
            attributes[name] = out.accessor(values[piece.used])
        kind = np.uint16 if len(piece.used) < 65535 else np.uint32
        indices = out.accessor(piece.faces.reshape(-1).astype(kind), target=34963)
        material = out.material(piece.material, piece.label)
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
    out.row("meshes", {"primitives": primitives})
    out.row("nodes", node)
    out.row("scenes", {"nodes": [0]})
    return out


def _channels(cut: Cut, notes: Notes) -> dict[str, NDArray[Any]]:
    """Channels as application-specific attributes: names begin with an underscore, integers have 16 bits."""
    out = {}
    for name in cut.channels:
        values = cut.channels[name]
        if values.dtype == bool:
            values = values.astype(np.uint8)
        elif values.dtype.kind in "iu" and values.dtype.itemsize > 2:
            if np.abs(values.astype(np.int64)).max(initial=0) > 1 << 24:
                notes.add("labels beyond 2^24, which glTF has no type for", name)
                continue
            values = values.astype(np.float32)
        if values.ndim == 2 and values.shape[1] > 4:
            notes.add("channels of more than four numbers", name)
            continue
        out[name if name.startswith("_") else f"_{name}"] = values
    return out


def _glb(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    document = _document(cut, notes)
    text = document.finished()
    text += b" " * (-len(text) % 4)
    body = bytes(document.body) + bytes(-len(document.body) % 4)
    length = 28 + len(text) + len(body)
    if length >= 1 << 32:
        raise FormatError(f"{path}: {length:,} bytes are more than a GLB can have; .gltf can")
    head = struct.pack("<4sII", b"glTF", 2, length)
    return {
        path: b"".join(
            [
                head,
                struct.pack("<I4s", len(text), b"JSON"),
                text,
                struct.pack("<I4s", len(body), b"BIN\0"),
                body,
            ]
        )
    }


def _gltf(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    from urllib.parse import quote

    document, body = _document(cut, notes), Path(path).with_suffix(".bin")
    text = document.finished(uri=quote(body.name))
    return {str(body): bytes(document.body), path: text}


# ------------------------------------------------------------------------------------------------------- OBJ


def _lines(row: str, values: NDArray[Any]) -> str:
    return (row * len(values)) % tuple(values.reshape(-1).tolist())


def _numbers(values: NDArray[Any]) -> str:
    """Format a number such that it reads back as the same."""
    return "%.17g" if values.dtype == np.float64 else "%.9g"


def _word(label: str) -> str:
    """A name as OBJ and MTL can hold it: one word."""
    return "_".join(label.split())


def _obj(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    digits = _numbers(cut.vertices)
    text = [] if not cut.materials else [f"mtllib {Path(path).stem}.mtl\n"]
    if cut.fine_colors is None:
        text.append(_lines(f"v {digits} {digits} {digits}\n", cut.vertices))
    else:
        rows = np.concatenate([cut.vertices.astype(np.float64), _colors.unit(cut.fine_colors[:, :3])], axis=1)
        text.append(_lines(f"v {digits} {digits} {digits} %.9g %.9g %.9g\n", rows))
        _note(notes, "alpha of vertex colours", not _colors.is_white(_colors.as_bytes(cut.fine_colors[:, 3])))
    text.extend(_lines("vt %.9g %.9g\n", uv) for uv in cut.uvs[:1])
    text.append(_lines("vn %.9g %.9g %.9g\n", cut.normals))
    corner = "%d/%d/%d" if cut.uvs else "%d//%d"
    files: dict[str, bytes] = {}
    looks = []
    split = pieces(cut)
    for piece in split:
        if cut.materials or len(split) > 1:
            text.append(f"usemtl {_word(piece.label)}\n")
        corners = np.repeat(piece.used[piece.faces].reshape(-1) + 1, 3 if cut.uvs else 2)
        text.append(_lines(f"f {corner} {corner} {corner}\n", corners.reshape(len(piece.faces), -1)))
        if cut.materials:
            looks.append(_mtl(piece, path, files, notes))
    if looks:
        files[str(Path(path).with_suffix(".mtl"))] = "\n".join(looks).encode()
    files[path] = "".join(text).encode()
    _note(notes, "UV sets beyond the first", len(cut.uvs) > 1)
    for name in cut.channels:
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


def _left_out(cut: Cut, notes: Notes, *what: str) -> None:
    """Note what a format without materials leaves out."""
    found = {
        "colours": cut.colors is not None,
        "UVs": bool(cut.uvs),
        "materials": bool(cut.materials),
        "face materials": cut.face_materials is not None and not cut.materials,
        "digits beyond float32": cut.vertices.dtype == np.float64,
    }
    for name in what:
        _note(notes, name, found.get(name))
    if "channels" in what:
        for name in cut.channels:
            notes.add("channels", name)


def _ply(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(cut, notes, "materials")
    columns: list[tuple[str, NDArray[Any]]] = []

    def add(names: str | list[str], values: NDArray[Any]) -> None:
        names = names.split() if isinstance(names, str) else names
        columns.extend((name, values.reshape(len(values), -1)[:, k]) for k, name in enumerate(names))

    add("x y z", cut.vertices)
    add("nx ny nz", cut.normals)
    if cut.fine_colors is not None:
        add("red green blue alpha", cut.fine_colors)
    for number, uv in enumerate(cut.uvs):
        add("s t" if not number else f"s{number} t{number}", uv)
    for name, values in cut._vertex_channels.items():
        add(*_properties(name, values))
    vertices = np.rec.fromarrays([values.astype(values.dtype.newbyteorder("<")) for _, values in columns])
    faces = [
        np.full(len(cut.faces), 3, np.uint8),
        *(cut.faces[:, k].astype("<i4") for k in range(3)),
    ]
    head = ["ply", "format binary_little_endian 1.0", "comment nanite_rs", f"element vertex {len(vertices)}"]
    head += [f"property {_PLY[values.dtype.str[1:]]} {name}" for name, values in columns]
    head += [f"element face {len(cut.faces)}", "property list uchar int vertex_indices"]
    if cut.face_materials is not None:
        faces.append(cut.face_materials.astype("<i4"))
        head.append("property int material_index")
    for name, values in cut.face_channels.items():
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


def _stl(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(
        cut, notes, "colours", "UVs", "materials", "face materials", "channels", "digits beyond float32"
    )
    corners = cut.vertices[cut.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    rows = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("size", "<u2")])
    rows["normal"] = across / np.where(length > 0.0, length, 1.0)
    rows["corners"] = corners
    return {path: b"nanite_rs".ljust(80, b"\0") + struct.pack("<I", len(rows)) + rows.tobytes()}


def _off(cut: Cut, path: str, notes: Notes) -> dict[str, bytes]:
    _left_out(cut, notes, "colours", "UVs", "materials", "face materials", "channels")
    digits = _numbers(cut.vertices)
    text = f"OFF\n{len(cut.vertices)} {len(cut.faces)} 0\n"
    text += _lines(f"{digits} {digits} {digits}\n", cut.vertices) + _lines("3 %d %d %d\n", cut.faces)
    return {path: text.encode()}


def _by_trimesh(cut: Cut, path: str, ending: str, notes: Notes) -> dict[str, bytes]:
    try:
        content = cut.to_trimesh().export(file_type=ending)
    except ImportError as error:
        raise _advice.missing(path, error.name or "an optional package") from error
    _left_out(cut, notes, "UVs", "materials", "face materials", "channels")
    return {path: content.encode() if isinstance(content, str) else bytes(content)}


_WRITERS: Final = {"glb": _glb, "gltf": _gltf, "obj": _obj, "off": _off, "ply": _ply, "stl": _stl}
