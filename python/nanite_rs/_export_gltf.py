"""Surfaces and scenes as GLB and glTF."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs._asset import GLTF_SLOTS, LINES, MINIFICATION, POINTS, WRAPS, Notes, rigid
from nanite_rs._export_parts import COLORS, image_file, image_key, moved, near, pieces, textures
from nanite_rs.exceptions import FormatError
from nanite_rs.light import DirectionalLight, SpotLight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from nanite_rs._export_parts import Surface
    from nanite_rs.light import Light
    from nanite_rs.material import Material
    from nanite_rs.texture import Texture

_WRAP_NUMBERS: Final[dict[str, int]] = {wrap: number for number, wrap in WRAPS.items()}


class Document:
    """A document that is filled table by table, and the bytes that it refers to."""

    def __init__(self, notes: Notes, path: str) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "nanite_rs"}, "scene": 0}
        self.body = bytearray()
        self._notes, self._path = notes, path
        self._known: dict[Any, int] = {}
        # Where positions of meshes are about, if these have large numbers.
        self._origins: list[NDArray[np.float64] | None] = []
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

    # ------------------------------------------------------------------------------- meshes and nodes

    def mesh(self, surface: Surface) -> int:
        """Add a surface; return its number."""
        vertices, origin = near(surface.vertices)
        extra, colors = _channels(surface, self._notes), surface.fine_colors
        primitives = []
        for piece in pieces(surface):
            attributes = self._positions(vertices[piece.used])
            if piece.material.smooth:  # without normals faces are flat
                attributes["NORMAL"] = self.accessor(surface.normals[piece.used])
            if colors is not None:
                attributes["COLOR_0"] = self._colors(colors[piece.used])
            for number, uv in enumerate(surface.uvs):
                upright = uv[piece.used].astype(np.float64) * (1.0, -1.0) + (0.0, 1.0)
                attributes[f"TEXCOORD_{number}"] = self.accessor(upright.astype(np.float32))
            for name, values in extra.items():
                attributes[name] = self.accessor(values[piece.used])
            indices = self._indices(piece.faces, len(piece.used))
            material = self.material(piece.material, piece.label)
            primitives.append({"attributes": attributes, "indices": indices, "material": material})
        return self._mesh(primitives, origin)

    def strokes(
        self,
        positions: NDArray[np.floating[Any]],
        segments: NDArray[np.uint32] | None,
        colors: NDArray[Any] | None,
        look: Material,
    ) -> int:
        """Add points, or lines; return their number."""
        vertices, origin = near(positions)
        attributes = self._positions(vertices)
        if colors is not None:
            attributes["COLOR_0"] = self._colors(colors)
        primitive: dict[str, Any] = {"attributes": attributes, "mode": POINTS if segments is None else LINES}
        if segments is not None:
            primitive["indices"] = self._indices(segments, len(positions))
        primitive["material"] = self.material(look, look.name or "strokes")
        return self._mesh([primitive], origin)

    def _mesh(self, primitives: list[dict[str, Any]], origin: NDArray[np.float64] | None) -> int:
        self._origins.append(origin)
        return self.row("meshes", {"primitives": primitives})

    def place(self, number: int, pose: NDArray[np.float64], name: str = "") -> None:
        """Add a node of a mesh."""
        fields = {"mesh": number, **_placed(moved(pose, self._origins[number]))}
        self._node(fields | ({"name": name} if name else {}))

    def place_levels(self, numbers: Sequence[int], extras: Sequence[dict[str, Any]]) -> None:
        """Add a node of levels of detail, finest first, each with extras."""
        first, *coarser = (
            {"mesh": number, **_placed(moved(np.eye(4), self._origins[number])), "extras": own}
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

    def _positions(self, rows: NDArray[np.float32]) -> dict[str, int]:
        return {"POSITION": self.accessor(rows, min=rows.min(axis=0).tolist(), max=rows.max(axis=0).tolist())}

    def _colors(self, rows: NDArray[Any]) -> int:
        return self.accessor(rows, **({"normalized": True} if rows.dtype.kind == "u" else {}))

    def _indices(self, rows: NDArray[Any], count: int) -> int:
        return self.accessor(rows.reshape(-1).astype(np.uint16 if count < 65535 else np.uint32), target=34963)

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
        key = image_key(texture.image, slot)
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
        self.json["buffers"] = [{"byteLength": len(self.body), **buffer}]
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
