"""Surfaces and scenes as GLB and glTF."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core
from nanite_rs._asset import GLTF_SLOTS, LINES, MINIFICATION, POINTS, WRAPS, Notes, rigid
from nanite_rs._export_packing import Grid, Packing, texture_coordinates
from nanite_rs._export_parts import COLORS, image_file, image_key, near, pieces, textures, translation
from nanite_rs._export_textures import encoded_as
from nanite_rs.exceptions import FormatError
from nanite_rs.light import DirectionalLight, SpotLight

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from nanite_rs._export_packing import ImageFormat
    from nanite_rs._export_parts import Surface
    from nanite_rs.light import Light
    from nanite_rs.material import Material
    from nanite_rs.texture import Image, Texture

_MIME: Final = {"png": "image/png", "jpg": "image/jpeg", "webp": "image/webp", "ktx2": "image/ktx2"}
# Formats that textures refer to by extensions.
_SOURCES: Final = {"image/webp": "EXT_texture_webp", "image/ktx2": "KHR_texture_basisu"}
_WRAP_NUMBERS: Final[dict[str, int]] = {wrap: number for number, wrap in WRAPS.items()}


class Document:
    """A document that is filled table by table, and the bytes that it refers to."""

    def __init__(
        self,
        notes: Notes,
        path: str,
        packing: Packing | None = None,
        images: ImageFormat | None = None,
        outside: Callable[[Image, bytes, str], str | None] | None = None,
    ) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "nanite_rs"}, "scene": 0}
        self.body = bytearray()
        self._notes, self._path, self._packing = notes, path, packing
        self._images = images
        # What puts images elsewhere, and says where.
        self._outside = outside
        self._known: dict[Any, int] = {}
        # What takes positions of meshes, as they are stored, to where they are.
        self._frames: list[NDArray[np.float64]] = []
        self._extensions: set[str] = set()
        self._required: set[str] = set()
        # Bytes that compressed views have once they are decoded.
        self._decoded = 0

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
        return self._accessor(self._view(rows, target), rows.dtype, len(rows), width, **fields)

    def _view(self, rows: NDArray[Any], target: int, decoder: str | None = None) -> int:
        raw = rows.view(np.uint8).reshape(len(rows), -1)
        pad = -raw.shape[1] % 4 if target == 34962 else 0
        if pad:
            raw = np.concatenate([raw, np.zeros((len(raw), pad), np.uint8)], axis=1)
        if target == 34962 and self._packing is not None and self._packing.extension:
            return self._compressed(self._packing.rows(raw), raw.shape[1], len(raw), decoder, target)
        return self.view(raw.tobytes(), target=target, **({"byteStride": raw.shape[1]} if pad else {}))

    def _compressed(
        self, data: bytes, stride: int, count: int, decoder: str | None, target: int, mode: str = "ATTRIBUTES"
    ) -> int:
        """Add bytes of a codec."""
        name = str(self._packing and self._packing.extension)
        self._required.add(name)
        self.body += bytes(-len(self.body) % 4)
        self._decoded += -self._decoded % 4
        fields: dict[str, Any] = {
            "buffer": 0,
            "byteOffset": len(self.body),
            "byteLength": len(data),
            "byteStride": stride,
            "count": count,
            "mode": mode,
        }
        self.body += data
        view = {
            "buffer": 1,
            "byteOffset": self._decoded,
            "byteLength": stride * count,
            **({"byteStride": stride} if target == 34962 else {}),
            "target": target,
            "extensions": self.extension(name, fields | ({"filter": decoder} if decoder else {})),
        }
        self._decoded += stride * count
        return self.row("bufferViews", view)

    def _accessor(self, view: int, dtype: np.dtype[Any], count: int, width: int, **fields: Any) -> int:
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        fields |= {
            "bufferView": view,
            "componentType": kinds[dtype.str[1:]],
            "count": count,
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[width],
        }
        return self.row("accessors", fields)

    def extension(self, name: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return an extension for what has it."""
        self._extensions.add(name)
        return {name: fields}

    # ------------------------------------------------------------------------------- meshes and nodes

    def mesh(self, surface: Surface, grid: Grid | None = None) -> int:
        """Add a surface; return its number. Its positions are rounded to a grid where one is given."""
        if grid is None and self._packing is not None:
            grid = Grid.around(surface.vertices)
        positions: NDArray[Any]
        if grid is None:
            positions, frame = near(surface.vertices)
        elif self._packing is None:
            # As float32 has them without another rounding.
            positions = (grid.steps(surface.vertices) * grid.step).astype(np.float32)
            frame = translation(grid.origin)
        else:
            positions, frame = grid.steps(surface.vertices).astype(np.int16), grid.frame
        extra = _channels(surface, self._notes)
        primitives = []
        for piece in pieces(surface):
            used, faces = piece.used, piece.faces
            if self._packing is not None:
                ordered, order = _core.vertex_order(np.ascontiguousarray(faces), len(used))
                faces, used = ordered.astype(np.int64), used[order]
            attributes = self._attributes(surface, piece.material.smooth, used, positions, extra)
            indices = self._indices(faces, len(used))
            material = self.material(piece.material, piece.label)
            primitives.append({"attributes": attributes, "indices": indices, "material": material})
        return self._mesh(primitives, frame)

    def _attributes(
        self,
        surface: Surface,
        smooth: bool,
        used: NDArray[np.integer[Any]],
        positions: NDArray[Any],
        extra: dict[str, NDArray[Any]],
    ) -> dict[str, int]:
        """Add what vertices carry."""
        packing, colors = self._packing, surface.fine_colors
        attributes = self._positions(positions[used])
        if smooth and packing is None:  # without normals faces are flat
            attributes["NORMAL"] = self.accessor(surface.normals[used])
        elif smooth and packing is not None:
            rows, decoder = packing.normals(surface.normals[used])
            view = self._view(np.ascontiguousarray(rows), 34962, decoder)
            attributes["NORMAL"] = self._accessor(view, rows.dtype, len(rows), 3, normalized=True)
        if colors is not None:
            attributes["COLOR_0"] = self._colors(colors[used])
        for number, uv in enumerate(surface.uvs):
            upright = (uv[used].astype(np.float64) * (1.0, -1.0) + (0.0, 1.0)).astype(np.float32)
            rows = upright if packing is None else texture_coordinates(upright)
            whole = {"normalized": True} if rows.dtype.kind == "u" else {}
            attributes[f"TEXCOORD_{number}"] = self.accessor(rows, **whole)
        for name, values in extra.items():
            attributes[name] = self.accessor(values[used])
        return attributes

    def strokes(
        self,
        positions: NDArray[np.floating[Any]],
        segments: NDArray[np.uint32] | None,
        colors: NDArray[Any] | None,
        look: Material,
    ) -> int:
        """Add points, or lines; return their number."""
        vertices, frame = near(positions)
        attributes = self._positions(vertices)
        if colors is not None:
            attributes["COLOR_0"] = self._colors(colors)
        primitive: dict[str, Any] = {"attributes": attributes, "mode": POINTS if segments is None else LINES}
        if segments is not None:
            primitive["indices"] = self._indices(segments, len(positions))
        primitive["material"] = self.material(look, look.name or "strokes")
        return self._mesh([primitive], frame)

    def _mesh(self, primitives: list[dict[str, Any]], frame: NDArray[np.float64]) -> int:
        self._frames.append(frame)
        return self.row("meshes", {"primitives": primitives})

    def place(self, number: int, pose: NDArray[np.float64], name: str = "") -> None:
        """Add a node of a mesh."""
        fields = {"mesh": number, **_placed(pose @ self._frames[number])}
        self._node(fields | ({"name": name} if name else {}))

    def place_levels(self, numbers: Sequence[int], extras: Sequence[dict[str, Any]]) -> None:
        """Add a node of levels of detail, finest first, each with extras."""
        first, *coarser = (
            {"mesh": number, **_placed(self._frames[number]), "extras": own}
            for number, own in zip(numbers, extras, strict=True)
        )
        self._node(first)
        ids = [self.row("nodes", row) for row in coarser]
        first["extensions"] = self.extension("MSFT_lod", {"ids": ids})

    def shine(self, light: Light, pose: NDArray[np.float64]) -> None:
        """Add a node of a light."""
        name = "KHR_lights_punctual"
        table = self.json.setdefault("extensions", {}).setdefault(name, {"lights": []})["lights"]
        table.append(_light(light, self._notes))
        extension = self.extension(name, {"light": len(table) - 1})
        self._node({"extensions": extension, **_placed(rigid(pose))})

    def _node(self, fields: dict[str, Any]) -> None:
        scene = self.json.setdefault("scenes", [{"nodes": []}])[0]
        scene["nodes"].append(self.row("nodes", fields))

    def _positions(self, rows: NDArray[Any]) -> dict[str, int]:
        if rows.dtype.kind == "i":
            self.extension("KHR_mesh_quantization", {})
            self._required.add("KHR_mesh_quantization")
        return {"POSITION": self.accessor(rows, min=rows.min(axis=0).tolist(), max=rows.max(axis=0).tolist())}

    def _colors(self, rows: NDArray[Any]) -> int:
        return self.accessor(rows, **({"normalized": True} if rows.dtype.kind == "u" else {}))

    def _indices(self, rows: NDArray[Any], count: int) -> int:
        target, flat = 34963, rows.reshape(-1).astype(np.uint16 if count < 65535 else np.uint32)
        if self._packing is None or not self._packing.extension or rows.shape[1] != 3:
            return self.accessor(flat, target=target)
        data = _core.pack_faces(np.ascontiguousarray(rows), count)
        view = self._compressed(data, flat.itemsize, len(flat), None, target, "TRIANGLES")
        return self._accessor(view, flat.dtype, len(flat), 1)

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
        # Levels of a mesh have theirs in common.
        return self.row("materials", fields, (look, name))

    def _texture(self, texture: Texture, slot: str) -> dict[str, Any]:
        color = slot in COLORS
        # What colours may lose, normals may not.
        key = *image_key(texture.image, slot), self._images is not None and color
        if ("images", key) not in self._known:
            if self._images is None:
                data, ending = image_file(texture.image, color, self._notes)
            else:
                data, ending = encoded_as(self._images, texture.image, color, self._notes)
            kind = _MIME[ending]
            uri = None if self._outside is None else self._outside(texture.image, data, ending)
            place: dict[str, Any] = {"bufferView": self.view(data)} if uri is None else {"uri": uri}
            self.row("images", place | {"mimeType": kind}, key)
        sampler = {
            "magFilter": 9728 if texture.filter == "nearest" else 9729,
            "minFilter": MINIFICATION[texture.filter, texture.mipmaps],
            "wrapS": _WRAP_NUMBERS[texture.wrap[0]],
            "wrapT": _WRAP_NUMBERS[texture.wrap[1]],
        }
        source = {"source": self._known["images", key]}
        fields: dict[str, Any] = {"sampler": self.row("samplers", sampler, tuple(sampler.values()))}
        known = *source.values(), *fields.values()
        extension = _SOURCES.get(self.json["images"][source["source"]]["mimeType"])
        if extension is not None:
            fields["extensions"] = self.extension(extension, source)
            self._required.add(extension)
        else:
            fields |= source
        out: dict[str, Any] = {"index": self.row("textures", fields, known)}
        if texture.uv_set:
            out["texCoord"] = texture.uv_set
        transform = {
            "offset": list(texture.offset),
            "rotation": float(texture.rotation),
            "scale": list(texture.scale),
        }
        if transform != {"offset": [0.0, 0.0], "rotation": 0.0, "scale": [1.0, 1.0]}:
            out["extensions"] = self.extension("KHR_texture_transform", transform)
        return out

    # ---------------------------------------------------------------------------------------- files

    def files(self) -> dict[str, bytes]:
        """Return the files: one, or with the ending ``.gltf`` what it refers to beside it."""
        return (_glb if self._path.lower().endswith(".glb") else _gltf)(self, self._path)

    def finished(self, **buffer: Any) -> bytes:
        """Return the JSON, with the buffer that it refers to."""
        if self._extensions:
            self.json["extensionsUsed"] = sorted(self._extensions)
        if self._required:
            self.json["extensionsRequired"] = sorted(self._required)
        self.json["buffers"] = [{"byteLength": len(self.body), **buffer}]
        if self._decoded:
            fallback = self.extension(str(self._packing and self._packing.extension), {"fallback": True})
            self.json["buffers"].append({"byteLength": self._decoded, "extensions": fallback})
        return json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()


def _placed(pose: NDArray[np.float64]) -> dict[str, Any]:
    """Return what a node says of its place."""
    if not np.array_equal(pose[:3, :3], np.eye(3)):
        return {"matrix": pose.T.reshape(-1).tolist()}
    return {"translation": pose[:3, 3].tolist()} if pose[:3, 3].any() else {}


def _light(light: Light, notes: Notes) -> dict[str, Any]:
    """Return a light as KHR_lights_punctual has it."""
    name = re.sub("Light$", "", type(light).__name__).lower()
    fields: dict[str, Any] = {"type": name, "color": list(light._color()[0]), "intensity": light._color()[1]}
    if isinstance(light, DirectionalLight):
        size = light.angle
    else:
        size = light.radius
        if light.range is not None:
            fields["range"] = light.range
    if isinstance(light, SpotLight):
        fields["spot"] = {"innerConeAngle": light.innerConeAngle, "outerConeAngle": light.outerConeAngle}
    if size:
        notes.add("sizes of lights")
    return fields


def _channels(surface: Surface, notes: Notes) -> dict[str, NDArray[Any]]:
    """Channels as application-specific attributes: names begin with an underscore, integers have 16 bits."""
    out = {}
    for name in surface.channels:
        values = surface.channels[name]
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


def _glb(document: Document, path: str) -> dict[str, bytes]:
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


def _gltf(document: Document, path: str) -> dict[str, bytes]:
    from urllib.parse import quote

    body = Path(path).with_suffix(".bin")
    text = document.finished(uri=quote(body.name))
    return {str(body): bytes(document.body), path: text}
