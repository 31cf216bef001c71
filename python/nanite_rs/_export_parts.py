"""What files of other formats are made of: a surface, its pieces by look, and images."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from nanite_rs import _colors
from nanite_rs._asset import TEXTURES, Notes
from nanite_rs._images import JPEG, PNG
from nanite_rs.material import Material, default_material

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from nanite_rs.light import Light
    from nanite_rs.texture import Image, Texture

# Textures whose integers are sRGB.
COLORS: Final = ("base_color_texture", "emissive_texture")


class Surface(Protocol):
    """What is written: a `Cut`, or what has all that writers ask of one."""

    vertices: NDArray[np.float32] | NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    fine_colors: NDArray[Any] | None
    uvs: list[NDArray[np.float32]]
    materials: tuple[Material, ...]
    channels: Mapping[str, NDArray[Any]]

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """Colours of 8 bits."""

    @property
    def face_materials(self) -> NDArray[np.int32] | None:
        """Numbers of materials."""

    @property
    def face_channels(self) -> Mapping[str, NDArray[Any]]:
        """What faces carry, which `channels` has, too."""

    @property
    def _vertex_channels(self) -> Mapping[str, NDArray[Any]]:
        """Channels without those of faces."""


class Document(Protocol):
    """A file that holds meshes, their instances and lights."""

    def mesh(self, surface: Surface) -> int:
        """Add a surface; return its number."""

    def strokes(
        self,
        positions: NDArray[np.floating[Any]],
        segments: NDArray[np.uint32] | None,
        colors: NDArray[Any] | None,
        look: Material,
    ) -> int:
        """Add points, or lines; return their number."""

    def place(self, number: int, pose: NDArray[np.float64], name: str = "") -> None:
        """Add an instance of what has this number; the axes of its pose are at right angles."""

    def shine(self, light: Light, pose: NDArray[np.float64]) -> None:
        """Add a light."""

    def files(self) -> dict[str, bytes]:
        """Return the files by their paths."""


@dataclass
class Arrays:
    """A surface of arrays."""

    vertices: NDArray[np.float32] | NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    fine_colors: NDArray[Any] | None = None
    uvs: list[NDArray[np.float32]] = field(default_factory=list)
    face_materials: NDArray[np.int32] | None = None
    materials: tuple[Material, ...] = ()
    channels: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    face_channels: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """Colours of 8 bits."""
        return None if self.fine_colors is None else _colors.as_bytes(self.fine_colors)

    @property
    def _vertex_channels(self) -> Mapping[str, NDArray[Any]]:
        return {name: self.channels[name] for name in self.channels if name not in self.face_channels}

    @classmethod
    def of(cls, surface: Surface, materials: tuple[Material, ...]) -> Arrays:
        """A surface with other looks."""
        return cls(
            vertices=surface.vertices,
            faces=surface.faces,
            normals=surface.normals,
            fine_colors=surface.fine_colors,
            uvs=surface.uvs,
            face_materials=surface.face_materials,
            materials=materials,
            channels=surface.channels,
            face_channels=surface.face_channels,
        )


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


def rows_of_looks(surface: Surface) -> NDArray[np.int64]:
    """Return the look of each face, or its face material where there are no looks."""
    numbers = surface.face_materials
    rows = np.zeros(len(surface.faces), np.int64) if numbers is None else numbers.astype(np.int64)
    last = len(surface.materials) - 1
    # The last material stands for all further numbers, and for negative ones.
    return np.where((rows < 0) | (rows > last), last, rows) if surface.materials else rows


def pieces(surface: Surface) -> list[Piece]:
    """Split a surface by looks, or by face materials where it has no looks."""
    rows = rows_of_looks(surface)
    names = labels(surface.materials)
    out = []
    for number in np.unique(rows).tolist():
        used, faces = np.unique(surface.faces[rows == number], return_inverse=True)
        colored = surface.colors is not None
        material = surface.materials[number] if surface.materials else default_material(colored=colored)
        label = names[number] if names else f"material_{number}"
        out.append(Piece(number, label, material, used, faces.reshape(-1, 3)))
    return out


def textures(material: Material) -> Iterator[tuple[str, Texture]]:
    """Return the textures of a material with the names of their slots."""
    for slot in TEXTURES:
        texture = getattr(material, slot)
        if texture is not None:
            yield slot, texture


def near(vertices: NDArray[np.floating[Any]]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return positions as files have them, float32, and the pose that takes them to where they are."""
    if vertices.dtype == np.float32:
        return vertices.astype(np.float32, copy=False), np.eye(4)
    origin = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    return (vertices - origin).astype(np.float32), translation(origin)


def translation(origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose of what lies about an origin."""
    out = np.eye(4)
    out[:3, 3] = origin
    return out


def image_key(image: Image, slot: str) -> tuple[int, bool]:
    """Return by what files tell images apart: floats of colours are written otherwise than other floats."""
    return id(image), slot in COLORS and image._dtype.startswith("f")


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
        pixels = np.concatenate([_colors.to_srgb(pixels[..., :count]), pixels[..., count:]], axis=2)
    return np.rint(pixels * 65535.0).astype(np.uint16)


def image_file(image: Image, color: bool, notes: Notes) -> tuple[bytes, str]:
    """Return an image as the file that it came from, or as PNG, and its ending."""
    data = image.encoded()
    if data is not None and data.startswith((PNG, JPEG)):
        return data, "png" if data.startswith(PNG) else "jpg"
    return png(integers(image, color, notes)), "png"
