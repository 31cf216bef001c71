"""The description of a file, before anything is built: plain arrays, materials, transforms, lights and cameras."""

from __future__ import annotations

import re
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from nanite_rs._rig import Bend, Rig, Stance
    from nanite_rs.camera import Camera
    from nanite_rs.light import DirectionalLight, PointLight, SpotLight
    from nanite_rs.material import Material
    from nanite_rs.texture import Filter, Wrap

# glTF's modes of primitives; they are OpenGL's.
POINTS: Final = 0
LINES: Final = 1
LINE_LOOP: Final = 2
LINE_STRIP: Final = 3
TRIANGLES: Final = 4
STRIP: Final = 5
FAN: Final = 6

#: UV sets that a mesh can have.
UV_SETS: Final = 4

GLTF_SLOTS: Final = {
    "base_color_texture": "baseColorTexture",
    "metallic_roughness_texture": "metallicRoughnessTexture",
    "normal_texture": "normalTexture",
    "occlusion_texture": "occlusionTexture",
    "emissive_texture": "emissiveTexture",
}
"""What glTF and trimesh call the slots of a material."""
TEXTURES: Final = tuple(GLTF_SLOTS)
"""The slots of a material."""

# Numbers of OpenGL in samplers.
WRAPS: Final[dict[int, Wrap]] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
MINIFICATION: Final[dict[tuple[Filter, Filter | None], int]] = {
    ("nearest", None): 9728,
    ("linear", None): 9729,
    ("nearest", "nearest"): 9984,
    ("linear", "nearest"): 9985,
    ("nearest", "linear"): 9986,
    ("linear", "linear"): 9987,
}
"""By the filter inside a level, and that between levels."""
MIPMAPS: Final[dict[int, Filter | None]] = {number: levels for (_, levels), number in MINIFICATION.items()}
"""The filter between levels by its number."""
# Magnification has two of these numbers.
NEAREST: Final = MINIFICATION["nearest", None]
LINEAR: Final = MINIFICATION["linear", None]


# Faces that are checked together: the first block decides for most meshes.
_BLOCK: Final = 4096


@dataclass
class Source:
    """Arrays of a mesh as `NaniteMesh.from_arrays` takes them."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float32] | None = None
    colors: NDArray[Any] | None = None
    uvs: list[NDArray[np.float32]] = field(default_factory=list)
    channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    face_materials: NDArray[Any] | None = None
    face_channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    """What else faces carry, (M,) or (M, K) by name."""
    materials: tuple[Material, ...] = ()
    """The look of each number of the face materials, of which the last stands for all from there on."""

    def arrays(self) -> dict[str, Any]:
        """Keyword arguments of `NaniteMesh.from_arrays`."""
        return {
            "vertices": self.vertices,
            "faces": self.faces,
            "normals": self.normals,
            "colors": self.colors,
            "uvs": self.uvs,
            "channels": self.channels,
            "face_materials": self.face_materials,
            "face_channels": self.face_channels,
            "materials": self.materials,
        }


@dataclass
class Part:
    """A surface that is built by itself. Parts may share a source, which is then built once."""

    name: str
    """What errors call it."""
    source: Source
    material: Material | list[Material]
    """One, or one for each number of the source's face materials."""
    bend: Bend | None = None
    """What its shape follows, where that changes."""

    def bend_to(self, stance: Stance) -> None:
        """Give it the shape that it has then."""
        if self.bend is not None:
            vertices, self.source.normals = self.bend.at(stance)
            self.source.vertices = vertices


@dataclass
class StrokePart:
    """Points or lines. They are part of scenes, and of no mesh."""

    name: str
    """What errors call them."""
    positions: NDArray[np.floating]
    segments: NDArray[np.int64] | None
    """Ends of lines, as rows of positions; nothing for points."""
    colors: NDArray[Any] | None
    material: Material | None = None
    """None for that of points and lines that are given none."""


class Notes:
    """What was left out or drawn otherwise, said in one warning."""

    def __init__(self) -> None:
        self._found: dict[str, dict[str, None]] = {}

    def add(self, what: str, whose: str = "") -> None:
        """Note ``what``, once for each name of whom it happened to."""
        names = self._found.setdefault(what, {})
        if whose:
            names[whose] = None

    def merge(self, other: Notes) -> None:
        """Add what ``other`` has."""
        for what, names in other._found.items():
            self._found.setdefault(what, {}).update(names)

    def __str__(self) -> str:
        texts = []
        for what, names in sorted(self._found.items()):
            some = ", ".join(list(names)[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
            texts.append(f"{what} ({some})" if names else what)
        return "; ".join(texts)

    def warn(self, name: str) -> None:
        """Warn once, if there is anything to say, at the line that called this package."""
        if self._found:
            _advice.warn(f"{name}: not everything is kept: {self}", UserWarning)


@dataclass
class Asset:
    """The content of a file."""

    name: str
    meshes: list[list[Part]] = field(default_factory=list)
    placed: list[tuple[str, int, NDArray[np.float64]]] = field(default_factory=list)
    """Instances: the node's name, the number of the mesh, object to world."""
    strokes: dict[int, list[StrokePart]] = field(default_factory=dict)
    """Points and lines of a mesh, by its number."""
    lights: list[tuple[DirectionalLight | PointLight | SpotLight, NDArray[np.float64]]] = field(
        default_factory=list
    )
    cameras: list[tuple[Camera, NDArray[np.float64]]] = field(default_factory=list)
    notes: Notes = field(default_factory=Notes)
    rig: Rig | None = None
    """What moves, if anything does. Then the lists below say by which nodes."""
    nodes: list[tuple[int, NDArray[np.float64]] | None] = field(default_factory=list)
    """For each instance its node, and its place about that; nothing for what joints alone place."""
    light_nodes: list[int] = field(default_factory=list)
    camera_nodes: list[int] = field(default_factory=list)


# Names of numbers that count things, whatever their type: _BATCHID, _FEATURE_ID_0, object_id, label, segmentation.
_IDS: Final = re.compile(
    r"(.*_)?((batch|feature|object|instance|face|part|group)?ids?|index|labels?|class|classification|category"
    r"|segments?|segmentation)(_\d+)?",
    re.IGNORECASE,
)


def as_labels(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Make labels of whole floating-point numbers by the name of an id: formats without integers hold ids so."""
    if values.dtype.kind != "f" or not _IDS.fullmatch(name):
        return values
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    limits = np.iinfo(np.int32)
    fits = bool((whole == values).all()) and whole.min(initial=0) >= limits.min
    return whole.astype(np.int32) if fits and whole.max(initial=0) <= limits.max else values


@contextmanager
def named(name: str, what: str) -> Iterator[None]:
    """Say in errors where in which file the fault is."""
    try:
        yield
    except ArgumentError as error:
        raise type(error)(f"{name}: {what}: {error}") from error


def triangles(order: NDArray[np.int64], mode: int) -> NDArray[np.int64] | None:
    """Rows of three out of the indices of a list, strip or fan of triangles; nothing for points and lines."""
    if mode == TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if mode not in (STRIP, FAN):
        return None
    if len(order) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == FAN:
        first = np.full(len(order) - 2, order[0])
        return np.stack([first, order[1:-1], order[2:]], axis=1)
    faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    # Every other triangle of a strip is reversed.
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def segments(order: NDArray[np.int64], mode: int) -> NDArray[np.int64] | None:
    """Rows of two out of the indices of a list, loop or strip of lines; nothing for others."""
    if mode == LINES:
        return order[: len(order) // 2 * 2].reshape(-1, 2)
    if mode not in (LINE_LOOP, LINE_STRIP):
        return None
    if len(order) < 2:
        return np.zeros((0, 2), np.int64)
    after = np.roll(order, -1) if mode == LINE_LOOP else order[1:]
    return np.stack([order[: len(after)], after], axis=1)


def has_area(vertices: NDArray[np.floating], faces: NDArray[np.int64]) -> bool:
    """Whether any face has three different corners: the others are dropped by the build, which needs one."""
    # The build raises the error for rows that do not exist.
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        return True
    vertices = np.asarray(vertices)
    for first in range(0, len(faces), _BLOCK):
        # As they are: far from the origin float32 would see no difference, where the build does.
        a, b, c = (vertices[faces[first : first + _BLOCK, k]] for k in range(3))
        if ((a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)).any():
            return True
    return False


def fitted(material: Material, name: str, uv_sets: int, notes: Notes) -> Material:
    """Leave out textures that the surface has no UVs for."""
    lost: dict[str, Any] = {
        slot: None
        for slot in TEXTURES
        if (texture := getattr(material, slot)) is not None and texture.uv_set >= uv_sets
    }
    if not lost:
        return material
    notes.add("textures left out, as surfaces have no such UVs", name)
    return replace(material, **lost)


def rigid(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out scale and shear: cameras and lights have none."""
    out, (right, up, back) = np.eye(4), pose[:3, :3].T
    out[:3, 3] = pose[:3, 3]

    def unit(v: NDArray[np.float64], otherwise: tuple[float, float, float]) -> NDArray[np.float64]:
        length = float(np.linalg.norm(v))
        return v / length if length > 0.0 else np.array(otherwise)

    back = unit(back, (0.0, 0.0, 1.0))
    side = right if np.linalg.norm(np.cross(up, back)) == 0.0 else np.cross(up, back)
    side = unit(side - back * np.dot(side, back), (1.0, 0.0, 0.0))
    out[:3, 0], out[:3, 1], out[:3, 2] = side, np.cross(back, side), back
    return out
