"""glTF files made to measure: a document that is filled row by row and written as text or binary."""

from __future__ import annotations

import base64
import io
import json
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
QUAD_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
QUAD_FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)


class Document:
    """A document with one buffer."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.body = bytearray()

    def row(self, kind: str, **fields: Any) -> int:
        """Add a row to a table; its number is returned."""
        rows = self.json.setdefault(kind, [])
        rows.append(fields)
        return len(rows) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        """Add a buffer view."""
        self.body += bytes(-len(self.body) % 4)
        start = len(self.body)
        self.body += data
        return self.row("bufferViews", buffer=0, byteOffset=start, byteLength=len(data), **fields)

    def accessor(
        self,
        array: np.ndarray,
        *,
        normalized: bool = False,
        stride: int = 0,
        before: int = 0,
        sparse: tuple[np.ndarray, np.ndarray] | None = None,
        stored: bool = True,
    ) -> int:
        """Add an accessor: rows ``stride`` bytes apart after ``before`` bytes, some of them given as sparse."""
        array = np.atleast_2d(array.T).T
        fields: dict[str, Any] = {
            "componentType": COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": TYPES[array.shape[1]],
        }
        if normalized:
            fields["normalized"] = True
        if stored:
            rows = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), -1)
            if stride:
                gap = np.full((len(array), stride - rows.shape[1]), 0xEE, np.uint8)
                rows = np.hstack([rows, gap])
            data = b"\xdd" * before + rows.tobytes()
            fields["bufferView"] = self.view(data, **({"byteStride": stride} if stride else {}))
            if before:
                fields["byteOffset"] = before
        if sparse is not None:
            places, values = sparse
            fields["sparse"] = {
                "count": len(places),
                "indices": {
                    "bufferView": self.view(places.tobytes()),
                    "componentType": COMPONENTS[places.dtype.name],
                },
                "values": {"bufferView": self.view(np.ascontiguousarray(values, array.dtype).tobytes())},
            }
        return self.row("accessors", **fields)

    def mesh(self, *primitives: dict[str, Any], **fields: Any) -> int:
        """Add a mesh with a node of its own; the node's number is returned."""
        return self.row("nodes", mesh=self.row("meshes", primitives=list(primitives)), **fields)

    def quad(self, **fields: Any) -> dict[str, Any]:
        """Return a primitive: the unit square with its UVs, image upright."""
        attributes = {"POSITION": self.accessor(QUAD), "TEXCOORD_0": self.accessor(QUAD_UV)}
        return {"attributes": attributes, "indices": self.accessor(QUAD_FACES), **fields}

    def image(self, pixels: np.ndarray, kind: str = "PNG") -> int:
        """Add an image that lies in the buffer."""
        return self.row("images", bufferView=self.view(png(pixels, kind)), mimeType=f"image/{kind.lower()}")

    def texture(self, pixels: np.ndarray, **fields: Any) -> int:
        """Add a texture with an image of its own."""
        return self.row("textures", source=self.image(pixels), **fields)

    def glb(self) -> bytes:
        """The document as binary."""
        self.json["buffers"] = [{"byteLength": len(self.body)}, *self.json.get("buffers", [])[1:]]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        body = bytes(self.body) + bytes(-len(self.body) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def save(self, path: Path, *, inline: bool = False) -> Path:
        """Write it as ``.glb``, or as ``.gltf`` with a file beside it or a data URI."""
        if path.suffix == ".glb":
            path.write_bytes(self.glb())
            return path
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.body).decode()
        if not inline:
            uri = "the%20buffer.bin"
            (path.parent / "the buffer.bin").write_bytes(self.body)
        self.json["buffers"] = [{"byteLength": len(self.body), "uri": uri}]
        path.write_text(json.dumps(self.json))
        return path


def png(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    """An image file."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels).save(out, kind)
    return out.getvalue()
