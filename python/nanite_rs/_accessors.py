"""The binary data of glTF files: containers, buffer views and their compression, accessors.

glTF 2.0, sections 3.6 and 4.4, and the extensions KHR_mesh_quantization, KHR_draco_mesh_compression,
EXT_meshopt_compression and its successor KHR_meshopt_compression.
"""

from __future__ import annotations

import base64
import binascii
import errno
import json
import os
import re
from typing import TYPE_CHECKING, Any, Final, NoReturn
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from nanite_rs import _advice
from nanite_rs._images import read_bytes
from nanite_rs.exceptions import FormatError, MissingFileError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

#: What numbers of accessors are stored as.
TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
#: Numbers of an element.
WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MESHOPT: Final = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_FILTERS: Final = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
_STRIDES: Final = {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,)}
_SCHEME: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")

# Most numbers of an accessor without stored data: a few bytes of JSON could ask for any amount of memory.
_MOST_ZEROS: Final = 1 << 27


class Document:
    """A glTF file: its JSON, and the bytes that it refers to, read when they are first asked for."""

    def __init__(self, name: str, content_of_file: bytes | memoryview, folder: Path | None) -> None:
        self.name, self.folder = name, folder
        self._body: bytes | memoryview | None = None
        data = bytes(self._unpack(content_of_file) if content_of_file[:4] == b"glTF" else content_of_file)
        try:
            content = json.loads(data)
        except (ValueError, RecursionError) as error:
            if data.lstrip()[:1] != b"{":
                self.fail(f"it is no glTF: it begins with {data[:8]!r}" if data else "it is empty")
            self.fail(f"its JSON is damaged: {error}")
        if not isinstance(content, dict):
            self.fail("its JSON is no object")
        self.json: dict[str, Any] = content
        version = str(self.member(content, "asset").get("version", ""))
        if not version.startswith("2."):
            self.fail(f"asset.version: expected 2.0, found {version!r}")
        self.required = {str(name) for name in self.listed(content, "extensionsRequired")}
        self._buffers: dict[int, bytes | memoryview] = {}
        self._views: dict[int, memoryview] = {}

    def _unpack(self, data: bytes | memoryview) -> bytes | memoryview:
        """Split a GLB into its chunks; return its JSON."""
        version, length = int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")
        if version != 2:
            self.fail(f"expected version 2 of GLB, found {version}")
        if length > len(data):
            self.fail(f"it is cut off: {length} bytes are announced, {len(data)} there")
        at, chunks = 12, []
        while at + 8 <= length:
            size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
            if at + 8 + size > length:
                self.fail(f"the chunk at byte {at} ends {at + 8 + size - length} bytes after the file")
            chunks.append((kind, at + 8, size))
            at += 8 + size
        if not chunks or chunks[0][0] != b"JSON":
            self.fail("its first chunk is not JSON")
        if len(chunks) > 1 and chunks[1][0] == b"BIN\0":
            _, start, size = chunks[1]
            self._body = data[start : start + size]
        _, start, size = chunks[0]
        return data[start : start + size]

    # ------------------------------------------------------------------------------------------ JSON

    def fail(self, message: str) -> NoReturn:
        """Raise FormatError with the file's name."""
        raise FormatError(f"{self.name}: {message}")

    def member(self, holder: dict[str, Any], key: str) -> dict[str, Any]:
        """Return the object called ``key``; an empty one where it is missing."""
        value = holder.get(key, {})
        if not isinstance(value, dict):
            self.fail(f"{key}: expected an object, found {value!r:.40}")
        return value

    def listed(self, holder: dict[str, Any], key: str) -> list[Any]:
        """Return the array called ``key``; an empty one where it is missing."""
        value = holder.get(key, [])
        if not isinstance(value, list):
            self.fail(f"{key}: expected an array, found {value!r:.40}")
        return value

    def extension(self, holder: dict[str, Any], name: str) -> dict[str, Any] | None:
        """Return the extension of an object, if it has it."""
        extensions = self.member(holder, "extensions")
        return self.member(extensions, name) if name in extensions else None

    def whole(self, holder: dict[str, Any], key: str, default: int | None = None) -> int:
        """Return the number called ``key``, whole and not negative."""
        value = holder.get(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            self.fail(f"{key}: expected a whole number, found {value!r:.40}")
        return value

    def number(self, holder: dict[str, Any], key: str, default: float | None = None) -> float:
        """Return the finite number called ``key``."""
        value = holder.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(float(value)):
            self.fail(f"{key}: expected a number, found {value!r:.40}")
        return float(value)

    def numbers(self, holder: dict[str, Any], key: str, default: tuple[float, ...]) -> NDArray[np.float64]:
        """Return as many finite numbers as ``default`` has."""
        value = holder.get(key, default)
        try:
            array = np.asarray(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.zeros(0)
        if array.shape != (len(default),) or not np.isfinite(array).all():
            self.fail(f"{key}: expected {len(default)} numbers, found {value!r:.60}")
        return array

    def entry(self, kind: str, index: object, holder: dict[str, Any] | None = None) -> dict[str, Any]:
        """Return a row of one of the document's tables."""
        rows = self.listed(self.json if holder is None else holder, kind)
        if isinstance(index, float) and index.is_integer():
            index = int(index)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(rows):
            self.fail(f"{kind}[{index!r:.40}]: there are {len(rows)}")
        row = rows[index]
        if not isinstance(row, dict):
            self.fail(f"{kind}[{index}]: expected an object, found {row!r:.40}")
        return row

    # ----------------------------------------------------------------------------------------- bytes

    def uri(self, uri: object, what: str) -> Any:
        """Return what a URI has in it, or the content of the file beside this one that it names, as bytes."""
        if not isinstance(uri, str):
            self.fail(f"{what}: expected a URI, found {uri!r:.40}")
        if uri[:5].lower() == "data:":
            head, comma, body = uri.partition(",")
            if not comma:
                self.fail(f"{what}: the data URI has no data")
            if not head.lower().endswith(";base64"):
                return unquote_to_bytes(body)
            try:
                return base64.b64decode(unquote(body))
            except (binascii.Error, ValueError) as error:
                self.fail(f"{what}: the data URI is damaged: {error}")
        if _SCHEME.match(uri):
            self.fail(f"{what}: {uri:.80} is not fetched; only files beside this one are read")
        if self.folder is None:
            raise MissingFileError(
                errno.ENOENT,
                f"{what} lies in a file of its own, and nothing says in which folder; give the path",
                f"{self.name}: {uri:.80}",
            )
        return self.content(beside(self.folder, unquote(uri), uri), f"{self.name}: {what}")

    def content(self, path: Path, what: str) -> Any:
        """Return the content of a file beside this one, as bytes."""
        return read_bytes(path, what)

    def buffer(self, index: int) -> bytes | memoryview:
        """Return the content of a buffer."""
        known = self._buffers.get(index)
        if known is not None:
            return known
        row, what = self.entry("buffers", index), f"buffers[{index}]"
        data: bytes | memoryview
        if "uri" in row:
            data = self.uri(row["uri"], what)
        elif index == 0 and self._body is not None:
            data = self._body
        else:
            self.fail(f"{what}: it has no URI, and there is no binary chunk for it")
        length = self.whole(row, "byteLength")
        if len(data) < length:
            self.fail(f"{what}: it should have {length} bytes, but there are {len(data)}")
        self._buffers[index] = data
        return data

    def view(self, index: int) -> memoryview:
        """Return the bytes of a buffer view, decompressed."""
        known = self._views.get(index)
        if known is None:
            row, what = self.entry("bufferViews", index), f"bufferViews[{index}]"
            known = self._decompressed(row, what)
            self._views[index] = known = self._slice(row, what) if known is None else known
        return known

    def _slice(self, part: dict[str, Any], what: str) -> memoryview:
        index = self.whole(part, "buffer")
        buffer = self.buffer(index)
        start, length = self.whole(part, "byteOffset", 0), self.whole(part, "byteLength")
        if start + length > len(buffer):
            self.fail(
                f"{what}: it ends at byte {start + length} of buffers[{index}], which has {len(buffer)}"
            )
        return memoryview(buffer)[start : start + length]

    def _decompressed(self, row: dict[str, Any], what: str) -> memoryview | None:
        """Decompress a buffer view by meshoptimizer; None where it is not compressed, or a fallback serves."""
        name = next((name for name in _MESHOPT if self.extension(row, name) is not None), None)
        if name is None:
            return None
        try:
            import meshoptimizer
        except ImportError as error:
            if name not in self.required:
                return None  # there is another form of the data
            raise _advice.missing(self.name, "meshoptimizer") from error
        packed = self.extension(row, name) or {}
        count, stride = self.whole(packed, "count"), self.whole(packed, "byteStride")
        mode, kind = packed.get("mode"), packed.get("filter", "NONE")
        if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
            self.fail(f"{what}: {name} has the unknown mode {mode!r:.40}")
        if kind not in _FILTERS:
            self.fail(f"{what}: {name} has the unknown filter {kind!r:.40}")
        if kind == "COLOR":
            self.fail(f"{what}: the filter COLOR of {name} is not decoded")
        if stride not in _STRIDES.get(kind, range(4, 257, 4) if mode == "ATTRIBUTES" else (2, 4)):
            self.fail(f"{what}: byteStride {stride} cannot be of {name}")
        # The decoder trusts its caller.
        if mode == "TRIANGLES" and count % 3:
            self.fail(f"{what}: {count} indices are no triangles")
        # Every byte of the code stands for at most some thousands of bytes.
        data = np.frombuffer(self._slice(packed, what), np.uint8)
        if count * stride > 65536 * (len(data) + 1):
            self.fail(f"{what}: {count} rows of {stride} bytes cannot lie in {len(data)} bytes")
        try:
            if mode == "ATTRIBUTES":
                out = meshoptimizer.decode_vertex_buffer(count, stride, data).view(np.uint8).reshape(-1)
                decode = {
                    "OCTAHEDRAL": meshoptimizer.decode_filter_oct,
                    "QUATERNION": meshoptimizer.decode_filter_quat,
                    "EXPONENTIAL": meshoptimizer.decode_filter_exp,
                }.get(kind)
                out = out if decode is None else decode(out, count, stride)
            else:
                decode = (
                    meshoptimizer.decode_index_buffer
                    if mode == "TRIANGLES"
                    else meshoptimizer.decode_index_sequence
                )
                # Decoded to 4 bytes each, whatever the file has: the package has room for no other size.
                out = decode(count, 4, data).astype({2: "<u2", 4: "<u4"}[stride])
        except (RuntimeError, ValueError, KeyError) as error:
            self.fail(f"{what}: what {name} compressed is damaged: {error}")
        return memoryview(np.ascontiguousarray(out).view(np.uint8).tobytes())

    # ------------------------------------------------------------------------------------- accessors

    def accessor(self, index: int) -> NDArray[Any]:
        """Return (count, width) numbers as they are stored, sparse ones filled in."""
        row, what = self.entry("accessors", index), f"accessors[{index}]"
        count = self.whole(row, "count")
        kind, width = self._kind(row, what), WIDTHS.get(str(row.get("type")))
        if width is None:
            self.fail(f"{what}: its type {row.get('type')!r:.40} has no use here")
        if "bufferView" in row:
            array = self._rows(row, what, count, width, kind)
        else:
            if count * width > _MOST_ZEROS:
                self.fail(f"{what}: {count} elements of which nothing is stored")
            array = np.zeros((count, width), kind)
        if "sparse" not in row:
            return array
        sparse = self.member(row, "sparse")
        changed = self.whole(sparse, "count")
        places = self.member(sparse, "indices")
        at = self._rows(places, f"{what}.sparse.indices", changed, 1, self._kind(places, what))[:, 0]
        if at.dtype.kind != "u":
            self.fail(f"{what}.sparse.indices: their type is {at.dtype}, expected an unsigned one")
        if changed and int(at.max()) >= count:
            self.fail(f"{what}.sparse.indices: {at.max()} is beyond the {count} elements")
        values = self._rows(self.member(sparse, "values"), f"{what}.sparse.values", changed, width, kind)
        array = array.copy()
        array[at] = values
        return array

    def _kind(self, row: dict[str, Any], what: str) -> np.dtype[Any]:
        kind = TYPES.get(self.whole(row, "componentType"))
        if kind is None:
            self.fail(f"{what}: componentType {row.get('componentType')!r:.40} is unknown")
        return np.dtype(kind)

    def _rows(
        self, row: dict[str, Any], what: str, count: int, width: int, kind: np.dtype[Any]
    ) -> NDArray[Any]:
        """Return rows of numbers out of a buffer view, without copying them."""
        index, start = self.whole(row, "bufferView"), self.whole(row, "byteOffset", 0)
        view, size = self.view(index), width * kind.itemsize
        holder = self.entry("bufferViews", index)
        packed = next((p for p in (self.extension(holder, name) for name in _MESHOPT) if p), {})
        stride = max(size, self.whole(holder, "byteStride", 0) or self.whole(packed, "byteStride", 0))
        end = start + stride * (count - 1) + size if count else 0
        if end > len(view):
            self.fail(f"{what}: it ends at byte {end} of bufferViews[{index}], which has {len(view)}")
        if count == 0:
            return np.zeros((0, width), kind)
        return np.ndarray((count, width), kind, view, start, (stride, kind.itemsize))

    def floats(
        self, index: int, array: NDArray[Any] | None = None, *, always: bool = False
    ) -> NDArray[np.float32]:
        """Return an accessor as float32; ``array`` is its content if that lies elsewhere.

        With ``always`` integers are of a fixed point though the accessor does not say so: as colours they can mean
        nothing else.
        """
        row = self.entry("accessors", index)
        array = self.accessor(index) if array is None else array
        if array.dtype.kind == "f" or not (always or row.get("normalized") is True):
            return np.ascontiguousarray(array, np.float32)
        return np.maximum(array / float(np.iinfo(array.dtype).max), -1.0).astype(np.float32)

    def indices(self, index: int) -> NDArray[np.int64]:
        """Return an accessor as a row of whole numbers."""
        array = self.accessor(index)
        if array.dtype.kind != "u" or array.shape[1] != 1:
            self.fail(f"accessors[{index}]: indices must be unsigned numbers, one each")
        return array[:, 0].astype(np.int64)

    def draco(
        self, packed: dict[str, Any], attributes: dict[str, Any], what: str
    ) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]] | None:
        """Return faces and attributes out of KHR_draco_mesh_compression; nothing where it need not be used."""
        try:
            import DracoPy
        except ImportError as error:
            if "KHR_draco_mesh_compression" not in self.required:
                return None
            raise _advice.missing(self.name, "DracoPy") from error
        data = bytes(self.view(self.whole(packed, "bufferView")))
        try:
            decoded = DracoPy.decode(data)
            faces = np.asarray(decoded.faces, np.int64).reshape(-1, 3)
            stored = {part["unique_id"]: np.asarray(part["data"]) for part in decoded.attributes}
        except Exception as error:  # DracoPy's own types, and what it trips over
            self.fail(f"{what}: what Draco compressed is damaged: {error}")
        names = self.member(packed, "attributes")
        missing = [name for name, ident in names.items() if ident not in stored]
        if missing:
            self.fail(f"{what}: {', '.join(missing)} are not in what Draco compressed")
        rows = {name: stored[ident].reshape(len(stored[ident]), -1) for name, ident in names.items()}
        return faces, {
            name: self._of_accessor(array, attributes.get(name), f"{what}: {name}")
            for name, array in rows.items()
        }

    def _of_accessor(self, array: NDArray[Any], index: object, what: str) -> NDArray[Any]:
        """Give what Draco decoded the type of its accessor: the decoder's integers may be wider."""
        row = self.entry("accessors", index)
        kind, width = self._kind(row, what), WIDTHS.get(str(row.get("type")))
        if array.shape[1] != width:
            self.fail(f"{what}: Draco has {array.shape[1]} numbers a vertex, the accessor {width}")
        if kind.kind in "iu":
            limits = np.iinfo(kind)
            if array.dtype.kind == "u" and kind.kind == "i":
                array = array.view(f"i{array.dtype.itemsize}")
            whole = np.rint(array)
            if len(whole) and (whole.min() < limits.min or whole.max() > limits.max):
                self.fail(f"{what}: what Draco holds does not fit {kind}, the type of the accessor")
            array = whole
        return array.astype(kind)


def beside(folder: Path, *names: str) -> Path:
    """Return the file of a folder that is there under one of the names, also as Windows would write it."""
    forms = [form for name in names for form in (name, name.replace("\\", "/")) if "\0" not in form]
    # Unlike pathlib, os.path answers False for names that cannot exist.
    found = (folder / form for form in forms if os.path.isfile(folder / form))
    return next(found, folder / names[0].replace("\\", "/"))
