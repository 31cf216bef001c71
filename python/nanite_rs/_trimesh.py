"""Everything that trimesh reads, and its objects, as plain descriptions."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final
from zipfile import ZipFile

import numpy as np

from nanite_rs import _advice, _colors, _export_parts
from nanite_rs._asset import (
    GLTF_SLOTS,
    Asset,
    Notes,
    Part,
    Source,
    StrokePart,
    as_labels,
    fitted,
    has_area,
    named,
    rigid,
)
from nanite_rs._images import from_pillow
from nanite_rs.camera import PerspectiveCamera
from nanite_rs.exceptions import FileError, FormatError, MeshError, NaniteError
from nanite_rs.material import Material, default_material
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from collections.abc import Mapping

    import PIL.Image
    import trimesh
    from numpy.typing import NDArray

    from nanite_rs._export_parts import Surface
    from nanite_rs.io import File


# What trimesh needs for a format, which it does not know without.
_NEEDED: Final = {
    "3dxml": "lxml",
    "3mf": "lxml",
    "dae": "collada",
    "step": "cascadio",
    "stp": "cascadio",
    "xaml": "lxml",
    "zae": "collada",
}


def read(file: File, *, drop_bad_textures: bool) -> Asset:
    """Read a file by trimesh, unprocessed, so that vertices stay as they are stored."""
    import trimesh

    name, suffix, folder = file.name, file.format, file.folder
    if file.given is None and not os.path.isfile(file.name):
        file.raw()  # which says why
    known = sorted(trimesh.available_formats())
    if suffix not in known and suffix in _NEEDED:
        raise _advice.missing(name, _NEEDED[suffix])
    if suffix not in known:
        found = f"extension .{suffix} is unknown" if suffix else "the name has no extension"
        raise FormatError(f"{name}: {found}; trimesh reads {', '.join(known)}")
    data = file.data()
    resolver = None if folder is None else trimesh.resolvers.FilePathResolver(str(folder / "-"))
    try:
        loaded: Any = trimesh.load(BytesIO(data), file_type=suffix, resolver=resolver, process=False)
    except NaniteError:
        raise
    except ImportError as error:
        raise _advice.missing(name, error.name or "an optional package") from error
    except OSError as error:
        if error.errno is None:
            raise FormatError(f"{name}: cannot be read as .{suffix}: {error}") from error
        raise FileError(error.errno, error.strerror, name) from error
    except Exception as error:  # whatever a loader trips over in a damaged file
        message = f"{type(error).__name__}: {error}"
        raise FormatError(f"{name}: cannot be read as .{suffix}: {message}") from error
    _refuse_empty(name, loaded)
    asset = described(loaded, name, drop_bad_textures=drop_bad_textures)
    if suffix in ("dae", "zae"):
        upright = _collada_frame(data if suffix == "dae" else _packed_collada(data))
        asset.placed = [(node, mesh, upright @ pose) for node, mesh, pose in asset.placed]
        asset.cameras = [(camera, rigid(upright @ pose)) for camera, pose in asset.cameras]
    return asset


def _refuse_empty(name: str, loaded: Any) -> None:
    """Loaders return point clouds, paths or nothing where there is no triangle; say so with the file's name."""
    import trimesh

    if isinstance(loaded, trimesh.Scene):
        loaded = list(loaded.geometry.values())
    parts = loaded if isinstance(loaded, list) else [loaded]
    if not any(isinstance(part, trimesh.Trimesh) and len(part.faces) for part in parts):
        kinds = ", ".join(sorted({type(part).__name__ for part in parts}))
        raise MeshError(f"{name}: there are no triangles in it" + (f", only {kinds}" if kinds else ""))


def _packed_collada(data: bytes) -> bytes:
    """Return the document in a ZAE archive, which trimesh has read."""
    with ZipFile(BytesIO(data)) as archive:
        return next((archive.read(name) for name in archive.namelist() if name.lower().endswith(".dae")), b"")


# Object to world with +Y up, of what COLLADA calls up.
_UPRIGHT: Final = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "Y_UP": np.eye(3),
    "Z_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


def _collada_frame(data: bytes) -> NDArray[np.float64]:
    """Return what makes metres with +Y up of the unit and axis of a COLLADA file, which trimesh leaves alone."""
    head = data[: data.find(b"</asset>") + 1 or None]
    unit = re.search(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']\s*([0-9.eE+-]+)\s*[\"']", head)
    axis = re.search(rb"<up_axis>\s*(\w+)\s*</up_axis>", head)
    out = np.eye(4)
    out[:3, :3] = _UPRIGHT.get(axis[1].decode() if axis else "Y_UP", np.eye(3))
    try:
        scale = float(unit[1]) if unit else 1.0
    except ValueError:
        scale = 1.0
    if np.isfinite(scale) and scale > 0.0:
        out[:3, :3] *= scale
    return out


def described(
    mesh: trimesh.Scene | trimesh.Trimesh,
    name: str,
    *,
    drop_bad_textures: bool,
) -> Asset:
    """Describe a trimesh object."""
    import trimesh

    asset = Asset(name)
    looks = _Looks(asset, drop_bad_textures)
    if isinstance(mesh, trimesh.Trimesh):
        if looks.add("mesh", mesh):
            asset.placed.append(("mesh", 0, np.eye(4)))
        return asset
    numbers: dict[str, int] = {}
    for node in mesh.graph.nodes_geometry:
        transform, key = mesh.graph[node]
        geometry = mesh.geometry[key]
        if key not in numbers:
            number = len(asset.meshes)
            added = looks.add if isinstance(geometry, trimesh.Trimesh) else looks.add_strokes
            numbers[key] = number if added(key, geometry) else -1
        if numbers[key] >= 0:
            asset.placed.append((str(node), numbers[key], np.array(transform, np.float64)))
    if mesh.has_camera:
        yfov = float(np.radians(mesh.camera.fov[1]))
        pose = rigid(np.asarray(mesh.camera_transform, np.float64))
        asset.cameras.append((PerspectiveCamera(yfov, znear=float(mesh.camera.z_near)), pose))
    return asset


def stroke_of(geometry: trimesh.PointCloud | trimesh.path.Path3D, name: str) -> StrokePart | None:
    """Points or lines of trimesh; nothing where there are none."""
    import trimesh

    if isinstance(geometry, trimesh.PointCloud):
        positions, given = np.asarray(geometry.vertices), np.asarray(geometry.colors)
        if not len(positions):
            return None
        return StrokePart(name, positions, None, given[:, :3] if len(given) == len(positions) else None)
    runs: list[NDArray[np.float64]] = []
    painted: list[Any] = []
    of_all = getattr(geometry, "colors", None)
    for number, entity in enumerate(getattr(geometry, "entities", ())):
        run = np.asarray(entity.discrete(geometry.vertices), np.float64)
        if len(run) > 1 and run.shape[1] == 3:
            runs.append(run)
            painted.append(None if of_all is None else of_all[number])
    if not runs:
        return None
    starts = np.cumsum([0, *(len(run) for run in runs)])
    ends = [
        np.stack([np.arange(len(run) - 1), np.arange(1, len(run))], axis=1) + start
        for run, start in zip(runs, starts, strict=False)
    ]
    colors: NDArray[Any] | None = None
    if all(color is not None for color in painted):
        colors = np.repeat(np.asarray(painted, np.uint8)[:, :3], [len(run) for run in runs], axis=0)
    return StrokePart(name, np.concatenate(runs), np.concatenate(ends), colors)


class _Looks:
    """Meshes of trimesh with their materials; images that are the same object are read once."""

    def __init__(self, asset: Asset, drop: bool) -> None:
        self._asset, self._drop = asset, drop
        self._images: dict[int, tuple[PIL.Image.Image, Image | None]] = {}

    def add_strokes(self, name: str, geometry: trimesh.PointCloud | trimesh.path.Path3D) -> bool:
        """Add points or lines to the asset, unless there are none."""
        stroke = stroke_of(geometry, name)
        if stroke is None:
            self._asset.notes.add("points and lines of nothing", name)
            return False
        self._asset.strokes[len(self._asset.meshes)] = [stroke]
        self._asset.meshes.append([])
        return True

    def add(self, name: str, mesh: trimesh.Trimesh) -> bool:
        """Add a mesh to the asset, unless there is nothing to see of it."""
        if not has_area(np.asarray(mesh.vertices), np.asarray(mesh.faces)):
            self._asset.notes.add("surfaces without area", name)
            return False
        source = _single(mesh)
        self._asset.meshes.append([Part(name, source, self._material(name, mesh, source))])
        return True

    def _material(self, name: str, mesh: trimesh.Trimesh, source: Source) -> Material | list[Material]:
        visual = mesh.visual
        if source.colors is not None and getattr(visual, "kind", None) != "texture":
            return default_material(colored=True)
        found = getattr(visual, "material", None) if getattr(visual, "kind", None) == "texture" else None
        if found is None:
            return Material()
        several = getattr(found, "materials", None)
        if several is None:
            return self._one(found, name, source)
        looks = [self._one(material, name, source) for material in several]
        return looks if looks and source.face_materials is not None else (looks or [Material()])[0]

    def _one(self, found: Any, mesh: str, source: Source) -> Material:
        name = str(found.name or mesh)
        with named(self._asset.name, f"material {name!r}"):
            material = self._simple(found, name) if hasattr(found, "diffuse") else self._pbr(found, name)
        return fitted(material, name, len(source.uvs), self._asset.notes)

    def _simple(self, found: Any, name: str) -> Material:
        """As trimesh and pyrender turn a glossy material into a rough one."""
        glossiness = found.glossiness
        if glossiness is None:
            glossiness = found.kwargs.get("Ns", found.kwargs.get("ns", 1.0))
        glossiness = max(float(np.ravel(np.asarray(glossiness, np.float64))[0]), 0.0)
        return Material(
            name=str(found.name or ""),
            base_color=_color(found.diffuse, (0.8, 0.8, 0.8, 1.0)),
            metallic=0.0,
            roughness=float((2.0 / (glossiness + 2.0)) ** 0.25),
            base_color_texture=self._texture(found.image, name),
        )

    def _pbr(self, found: Any, name: str) -> Material:
        def factor(value: Any) -> float:
            return 1.0 if value is None else float(np.clip(value, 0.0, 1.0))

        mode = str(found.alphaMode or "OPAQUE").lower()
        textures: dict[str, Any] = {
            slot: self._texture(getattr(found, key, None), name) for slot, key in GLTF_SLOTS.items()
        }
        emissive = (
            np.zeros(3) if found.emissiveFactor is None else np.asarray(found.emissiveFactor, np.float64)
        )
        return Material(
            name=str(found.name or ""),
            base_color=_color(found.baseColorFactor, (1.0, 1.0, 1.0, 1.0)),
            metallic=factor(found.metallicFactor),
            roughness=factor(found.roughnessFactor),
            emissive=np.maximum(emissive[:3], 0.0),
            double_sided=bool(found.doubleSided),
            alpha_mode=mode if mode in ("opaque", "mask", "blend") else "opaque",  # type: ignore[arg-type]
            alpha_cutoff=0.5 if found.alphaCutoff is None or mode != "mask" else float(found.alphaCutoff),
            **textures,
        )

    def _texture(self, image: PIL.Image.Image | None, name: str) -> Texture | None:
        if image is None:
            return None
        if id(image) not in self._images:
            try:
                made = Image(from_pillow(image))
            except Exception as error:  # Pillow reads the file only now
                message = f"{self._asset.name}: material {name!r}: the image is damaged: {error}"
                if not self._drop:
                    raise FormatError(message) from error
                self._asset.notes.add("textures left out, as they cannot be read", message)
                made = None
            self._images[id(image)] = image, made
        known = self._images[id(image)][1]
        return None if known is None else Texture(known)


def _color(value: Any, default: tuple[float, ...]) -> tuple[float, ...]:
    """Three or four numbers as RGBA from 0 to 1; trimesh has them as floats or as bytes."""
    if value is None:
        return default
    array = np.asarray(value)
    array = array / 255.0 if array.dtype.kind in "iu" else array.astype(np.float64)
    return (*np.clip(array, 0.0, 1.0).tolist(), 1.0)[:4]


def _single(mesh: trimesh.Trimesh) -> Source:
    source = Source(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    # Normals that came with the file lie in the cache; asking for `vertex_normals` would compute missing ones.
    stored = mesh._cache.cache.get("vertex_normals")
    if stored is not None and np.shape(stored) == np.shape(source.vertices):
        source.normals = np.asarray(stored, np.float32)
    source.channels = _channels(mesh.vertex_attributes, len(mesh.vertices))
    source.face_channels = _channels(mesh.face_attributes, len(mesh.faces))
    source.face_channels.pop("face_materials", None)
    source.face_materials = _face_materials(mesh)
    visual = mesh.visual
    if visual is None or not visual.defined:
        return source
    if visual.kind == "vertex":
        source.colors = np.asarray(visual.vertex_colors, np.uint8)
    elif visual.kind == "face":
        # One colour per face: every face gets vertices of its own. Equal ones are welded again by the build.
        corners = source.faces.reshape(-1)
        source.vertices = source.vertices[corners]
        if source.normals is not None:
            source.normals = source.normals[corners]
        source.channels = {name: values[corners] for name, values in source.channels.items()}
        source.colors = np.repeat(np.asarray(visual.face_colors, np.uint8), 3, axis=0)
        source.faces = np.arange(len(corners)).reshape(-1, 3)
    elif visual.kind == "texture":
        uv, attributes = getattr(visual, "uv", None), getattr(visual, "vertex_attributes", {})
        if uv is not None and len(uv) == len(source.vertices):
            source.uvs = [np.asarray(uv, np.float32)]
        attribute = attributes.get("color")
        if attribute is not None and np.shape(attribute)[0] == len(source.vertices):
            source.colors = _colors.rgba(np.asarray(attribute))
    return source


def _channels(attributes: Mapping[Any, Any], count: int) -> dict[str, NDArray[Any]]:
    """The attributes that can be channels: a number or a row of numbers for each vertex or face."""
    channels = {}
    for name, values in attributes.items():
        array = np.asarray(values)
        rows = array.ndim in (1, 2) and len(array) == count
        if rows and array.size and array.dtype.kind in "fiub":
            channels[str(name)] = as_labels(str(name), array)
    return channels


def _face_materials(mesh: trimesh.Trimesh) -> NDArray[Any] | None:
    """Face materials of a texture with several materials, or the face attribute that `Cut.to_trimesh` makes."""
    found = getattr(mesh.visual, "face_materials", None)
    if found is None:
        found = mesh.face_attributes.get("face_materials")
    array = np.asarray([] if found is None else found)
    return array if array.shape == (len(mesh.faces),) and array.dtype.kind in "iu" else None


# ---------------------------------------------------------------------------------------------------- making


def made(cut: Surface, *, process: bool) -> trimesh.Trimesh:
    """Make a trimesh object of a surface, with its looks; what trimesh has no place for is named in a warning."""
    import trimesh

    notes = Notes()
    numbers = cut.face_materials
    of_faces = {"face_materials": numbers} if numbers is not None else {}
    of_faces |= dict(cut.face_channels)
    visual: Any = None
    if cut.materials and not _is_plain(cut):
        visual = _textured(cut, notes)
    elif cut.uvs:
        visual = trimesh.visual.TextureVisuals(uv=cut.uvs[0])
    elif cut.colors is not None:
        visual = trimesh.visual.ColorVisuals(vertex_colors=cut.colors)
    if cut.colors is not None and isinstance(visual, trimesh.visual.TextureVisuals):
        visual.vertex_attributes["color"] = cut.colors
    if len(cut.uvs) > 1:
        notes.add("UV sets beyond the first")
    if cut.fine_colors is not None and cut.fine_colors.dtype != np.uint8:
        notes.add("colours finer than 8 bits")
    mesh = trimesh.Trimesh(
        vertices=cut.vertices,
        faces=cut.faces,
        vertex_normals=cut.normals,
        vertex_attributes=cut._vertex_channels,
        face_attributes=of_faces,
        visual=visual,
        process=process,
    )
    notes.warn("to_trimesh")
    return mesh


def _is_plain(cut: Surface) -> bool:
    """Whether colours of vertices are all that there is to see: what a file of such colours was given."""
    white = replace(cut.materials[0], smooth=True, double_sided=False) == default_material(colored=True)
    return len(cut.materials) == 1 and white and cut.colors is not None and not cut.uvs


def _textured(cut: Surface, notes: Notes) -> trimesh.visual.TextureVisuals:
    """Materials and UVs; what textures do to UVs is done here, as trimesh knows no such thing."""
    import trimesh

    uv: Any = cut.uvs[0].copy() if cut.uvs else None
    images: dict[tuple[int, bool], PIL.Image.Image] = {}
    for piece in _export_parts.pieces(cut):
        found = dict(_export_parts.textures(piece.material))
        for first in list(found.values())[: uv is not None]:
            corners = np.column_stack([cut.uvs[first.uv_set][piece.used], np.ones(len(piece.used))])
            places = corners @ np.array(first._rows()).T
            uv[piece.used] = np.column_stack([places[:, 0], 1.0 - places[:, 1]])
    named = zip(cut.materials, _export_parts.labels(cut.materials), strict=True)
    looks = [_pbr(look, label, images, notes) for look, label in named]
    if len(looks) == 1:
        return trimesh.visual.TextureVisuals(uv=uv, material=looks[0])
    numbers = np.zeros(len(cut.faces), np.int32) if cut.face_materials is None else cut.face_materials
    rows = np.where((numbers < 0) | (numbers >= len(looks)), len(looks) - 1, numbers)
    several = trimesh.visual.material.MultiMaterial(looks)
    return trimesh.visual.TextureVisuals(uv=uv, material=several, face_materials=rows)


def _pbr(look: Material, name: str, images: dict[tuple[int, bool], PIL.Image.Image], notes: Notes) -> Any:
    """One material as trimesh has it."""
    import trimesh
    from PIL import Image as Pillow

    slots: dict[str, Any] = {}
    found = dict(_export_parts.textures(look))
    laid = [(texture.uv_set, texture._rows()) for texture in found.values()]
    for (slot, texture), own in zip(found.items(), laid, strict=True):
        if own != laid[0]:
            notes.add("textures that lie otherwise than the first one of their material", f"{name}: {slot}")
            continue
        if texture.wrap != ("repeat", "repeat") or texture.filter != "linear":
            notes.add("wrapping and filters of textures", name)
        key = _export_parts.image_key(texture.image, slot)
        if key not in images:
            pixels = _export_parts.integers(texture.image, key[1], notes)
            if pixels.dtype == np.uint16:
                notes.add("pixels beyond 8 bits", name)
                pixels = np.rint(pixels / 257.0).astype(np.uint8)
            images[key] = Pillow.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels)
        slots[GLTF_SLOTS[slot]] = images[key]
    if max(look.emissive) > 1.0:
        notes.add("light given off beyond 1", name)
    if (look.normal_scale, look.occlusion_strength) != (1.0, 1.0):
        notes.add("scales of normal and occlusion textures", name)
    return trimesh.visual.material.PBRMaterial(
        name=name,
        baseColorFactor=[*look.base_color, 1.0][:4],
        metallicFactor=look.metallic,
        roughnessFactor=look.roughness,
        emissiveFactor=np.minimum(look.emissive, 1.0) if max(look.emissive) > 0.0 else None,
        doubleSided=look.double_sided,
        alphaMode=look.alpha_mode.upper(),
        alphaCutoff=look.alpha_cutoff if look.alpha_mode == "mask" else None,
        **slots,
    )
