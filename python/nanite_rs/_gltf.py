"""glTF 2.0 as plain descriptions: nodes, primitives, materials, textures, lights and cameras.

What trimesh drops is the reason to read it here: samplers, UV sets by slot, KHR_texture_transform, lights, cameras,
instances that share a mesh.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors
from nanite_rs._accessors import Document
from nanite_rs._asset import (
    LINE_LOOP,
    LINE_STRIP,
    LINEAR,
    LINES,
    MINIFICATION,
    MIPMAPS,
    NEAREST,
    POINTS,
    UV_SETS,
    WRAPS,
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
    segments,
    triangles,
)
from nanite_rs._rig import MIRROR, REST, Animation, Bend, Rig, Skin, Track, placed
from nanite_rs.camera import Camera, OrthographicCamera, PerspectiveCamera
from nanite_rs.exceptions import ArgumentError, FileError, FormatError, NaniteError
from nanite_rs.light import DirectionalLight, PointLight, SpotLight
from nanite_rs.material import Material
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray


# Extensions that a file may require: those that are read, and those that only refine a look.
_KNOWN: Final = (
    "CESIUM_RTC",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_avif",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "MSFT_texture_dds",
)
_LOOKS: Final = "KHR_materials_"
# These extensions only add attributes, which are read, and metadata.
_SAID_BY: Final = ("EXT_mesh_features",)
_READ_LOOKS: Final = (
    "unlit",
    "emissive_strength",
    "pbrSpecularGlossiness",
    "variants",
    "transmission",
    "ior",
    "volume",
)

_NEAREST: Final = [number for (own, _), number in MINIFICATION.items() if own == "nearest"]

# Extensions that name the image of a texture, in the order in which they are tried.
_IMAGES: Final = ("EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds", "KHR_texture_basisu")


# Attributes that are read, and those of skins, for which there is a note. Tangents follow from UVs.
_READ: Final = re.compile(r"POSITION|NORMAL|TANGENT|COLOR_0|TEXCOORD_[0-3]|JOINTS_\d+|WEIGHTS_\d+|_.*")


def read(name: str, data: bytes, folder: Path | None, *, drop_bad_textures: bool) -> Asset:
    """Read a glTF file, or raise an error that says what is wrong with it."""
    document = Document(name, data, folder)
    try:
        return _Reader(document, drop_bad_textures).asset()
    except (NaniteError, MemoryError):
        raise
    except Exception as error:  # whatever else a damaged file makes us trip over
        raise FormatError(f"{name}: damaged glTF: {type(error).__name__}: {error}") from error


def primitives(
    document: Document, notes: Notes
) -> Iterator[tuple[str, dict[str, Any], NDArray[np.float64], Callable[[int], Material]]]:
    """Yield all primitives of the default scene where they stand, with what errors call them.

    The last returns what a primitive looks like with so many UV sets.
    """
    reader = _Reader(document, True)
    for what, row, pose in reader.placed():
        yield what, row, pose, partial(reader.look, row)
    notes.merge(reader._notes)


class _Reader:
    """One pass over a document. Images, textures, materials and sources that are referred to again are shared."""

    def __init__(self, document: Document, drop_bad_textures: bool) -> None:
        self._document, self._drop = document, drop_bad_textures
        self._notes = Notes()
        self._images: dict[int, Image | None] = {}
        self._materials: dict[int | None, Material] = {}
        self._sources: dict[str, Source | None] = {}
        self._meshes: dict[tuple[int, tuple[float, ...]], int] = {}
        self._skins: dict[int, Skin] = {}
        self._asset = Asset(document.name, notes=self._notes)

    def asset(self) -> Asset:
        """Read the default scene."""
        document = self._document
        self.check_extensions()
        rows = document.listed(document.json, "animations")
        animations = [self._animation(number) for number in range(len(rows))]
        self._morphing = {
            track.node for own in animations for track in own._tracks if track.path == "weights"
        }
        names: set[str] = set()
        for index, node, pose in self._nodes():
            name = _unique(str(node.get("name") or f"node_{index}"), names)
            if "mesh" in node:
                self._mesh(name, index, node, pose)
            if "camera" in node:
                self._camera(document.whole(node, "camera"), pose)
                self._asset.camera_nodes.append(index)
            light = document.extension(node, "KHR_lights_punctual")
            if light is not None:
                with named(document.name, "light"):
                    self._asset.lights.append((self._light(light), rigid(pose)))
                self._asset.light_nodes.append(index)
        bent = [part for parts in self._asset.meshes for part in parts if part.bend is not None]
        if animations or bent:
            self._asset.rig = rig = self._rig(animations)
            at_rest = rig.stance()
            for part in bent:
                part.bend_to(at_rest)
        return self._asset

    def placed(self) -> Iterator[tuple[str, dict[str, Any], NDArray[np.float64]]]:
        """Yield all primitives where they stand, with what errors call them; what bends them is refused."""
        document = self._document
        self.check_extensions()
        for index, node, pose in self._nodes():
            if "mesh" not in node:
                continue
            number = document.whole(node, "mesh")
            mesh = document.entry("meshes", number)
            if "skin" in node or self._weights(node if "weights" in node else mesh):
                document.fail(f"nodes[{index}]: skins and morph targets are read in memory alone")
            for instance in self._instances(node):
                for k in range(len(document.listed(mesh, "primitives"))):
                    row = document.entry("primitives", k, mesh)
                    yield f"meshes[{number}], primitive {k}", row, pose @ instance

    def check_extensions(self) -> None:
        """Refuse what cannot be read without its extensions, and note the others."""
        document = self._document
        strange = sorted(
            name
            for name in document.required
            if name not in _KNOWN and not name.startswith((_LOOKS, "KHR_xmp"))
        )
        if strange:
            document.fail(f"it requires {', '.join(strange)}, which cannot be read")
        for name in map(str, document.listed(document.json, "extensionsUsed")):
            if name not in (*_KNOWN, *_SAID_BY) and not name.startswith((_LOOKS, "KHR_xmp")):
                self._notes.add("extensions", name)

    # ----------------------------------------------------------------------------------------- nodes

    def _nodes(self) -> Iterator[tuple[int, dict[str, Any], NDArray[np.float64]]]:
        """Each node of the scene with its object-to-world matrix, parents first, at any depth."""
        document = self._document
        rows = document.listed(document.json, "nodes")
        scenes = document.listed(document.json, "scenes")
        if scenes:
            scene = document.entry("scenes", document.json.get("scene", 0))
            for number, other in enumerate(scenes):
                if other is not scene and isinstance(other, dict) and other.get("nodes"):
                    self._notes.add("scenes besides the default one", str(other.get("name") or number))
            roots = document.listed(scene, "nodes")
        else:
            children = {child for row in rows if isinstance(row, dict) for child in row.get("children", [])}
            roots = [index for index in range(len(rows)) if index not in children]
        seen: set[int] = set()
        first = self._first()
        waiting = [(root, first) for root in reversed(roots)]
        while waiting:
            index, above = waiting.pop()
            node = document.entry("nodes", index)
            if index in seen:
                document.fail(f"nodes[{index}] is a child of two nodes, or below itself")
            seen.add(index)
            pose = above @ self._pose(node)
            if not np.isfinite(pose).all():
                document.fail(f"nodes[{index}]: its matrix is not finite")
            yield index, node, pose
            waiting.extend((child, pose) for child in reversed(document.listed(node, "children")))

    def _first(self) -> NDArray[np.float64]:
        """What is above all roots."""
        first = np.eye(4)
        centre = self._document.extension(self._document.json, "CESIUM_RTC")
        if centre is not None:
            # Positions are relative to it, so that float32 will do.
            first[:3, 3] = self._document.numbers(centre, "center", (0.0, 0.0, 0.0))
        return first

    def _pose(self, node: dict[str, Any]) -> NDArray[np.float64]:
        document = self._document
        if "matrix" in node:
            matrix = document.numbers(node, "matrix", (0.0,) * 16).reshape(4, 4).T.copy()
            if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-6):
                document.fail(f"matrix: its last row is {matrix[3].tolist()}, expected 0 0 0 1")
            matrix[3] = 0.0, 0.0, 0.0, 1.0
            return matrix
        return placed(*(document.numbers(node, path, rest) for path, rest in REST.items()))

    def _mesh(self, name: str, number: int, node: dict[str, Any], pose: NDArray[np.float64]) -> None:
        document, index = self._document, self._document.whole(node, "mesh")
        row = document.entry("meshes", index)
        label = f"meshes[{index}]" + (f" {row['name']!r:.60}" if row.get("name") else "")
        primitives = [
            (document.entry("primitives", k, row), f"{label}, primitive {k}")
            for k in range(len(document.listed(row, "primitives")))
        ]
        weights = self._weights(node if "weights" in node else row)
        for own, what in primitives:
            if len(weights) > len(document.listed(own, "targets")):
                self._notes.add("weights of morph targets that are missing", what)
        skinned = "skin" in node
        if skinned or number in self._morphing:
            skin = self._skin(document.whole(node, "skin")) if skinned else None
            bent = [self._bent(row, number, skin, what) for row, what in primitives]
            mesh = self._add_mesh(bent, primitives, weights)
            if skinned:
                # Joints alone say where it is, but the node which way its faces wind.
                bends = [part.bend for part in bent if part is not None and part.bend is not None]
                mirrors = bool(np.linalg.det(pose[:3, :3]) < 0)
                mirrored = mirrors and all(bend.joints is not None for bend in bends)
                for bend in bends:
                    bend.mirrored = mirrored
                self._asset.placed.append((name, mesh, MIRROR if mirrored else np.eye(4)))
                self._asset.nodes.append(None)
                return
        else:
            key = index, weights
            if key not in self._meshes:
                parts = [self._part(row, weights, what) for row, what in primitives]
                self._meshes[key] = self._add_mesh(parts, primitives, weights)
            mesh = self._meshes[key]
        for instance in self._instances(node):
            self._asset.placed.append((name, mesh, pose @ instance))
            self._asset.nodes.append((number, instance))

    def _add_mesh(
        self,
        parts: list[Part | None],
        primitives: list[tuple[dict[str, Any], str]],
        weights: tuple[float, ...],
    ) -> int:
        """Add what there is of a mesh, and return its number."""
        mesh = len(self._asset.meshes)
        self._asset.meshes.append([part for part in parts if part is not None])
        strokes = [self._stroke(row, weights, what) for row, what in primitives]
        if any(strokes):
            self._asset.strokes[mesh] = [stroke for stroke in strokes if stroke is not None]
        return mesh

    def _weights(self, holder: dict[str, Any]) -> tuple[float, ...]:
        """How far each morph target is applied at rest; nothing where none is."""
        values = self._document.listed(holder, "weights")
        weights = self._document.numbers(holder, "weights", (0.0,) * len(values))
        return tuple(weights.tolist()) if weights.any() else ()

    def _instances(self, node: dict[str, Any]) -> Iterator[NDArray[np.float64]]:
        """Matrices of EXT_mesh_gpu_instancing, or one that does nothing."""
        document = self._document
        found = document.extension(node, "EXT_mesh_gpu_instancing")
        if found is None:
            yield np.eye(4)
            return
        attributes = document.member(found, "attributes")
        kinds = {"TRANSLATION": (0.0, 0.0, 0.0), "ROTATION": (0.0, 0.0, 0.0, 1.0), "SCALE": (1.0, 1.0, 1.0)}
        arrays = {
            kind: document.floats(document.whole(attributes, kind)).astype(np.float64)
            for kind in kinds
            if kind in attributes
        }
        for name in attributes:
            if name not in kinds:
                self._notes.add("attributes of instances", name)
        counts = {len(array) for array in arrays.values()}
        if len(counts) != 1 or any(a.shape[1] != len(kinds[kind]) for kind, a in arrays.items()):
            document.fail("EXT_mesh_gpu_instancing: its attributes do not fit each other")
        for row in range(counts.pop()):
            yield placed(
                *(arrays[kind][row] if kind in arrays else np.array(rest) for kind, rest in kinds.items())
            )

    # ---------------------------------------------------------------------------------------- motion

    def _rig(self, animations: list[Animation]) -> Rig:
        """All nodes, those outside of the scene included: joints may be there."""
        document = self._document
        rows = document.listed(document.json, "nodes")
        parents = [-1] * len(rows)
        for index in range(len(rows)):
            for child in document.listed(document.entry("nodes", index), "children"):
                document.entry("nodes", child)
                parents[child] = index
        order: list[int] = []
        waiting = [index for index, parent in enumerate(parents) if parent < 0]
        while waiting:
            index = waiting.pop()
            order.append(index)
            if len(order) > len(rows):
                document.fail("nodes: some are children of two others")
            waiting.extend(document.listed(document.entry("nodes", index), "children"))
        if len(order) < len(rows):
            document.fail("nodes: some are below themselves")
        local = {path: np.tile(np.array(rest), (len(rows), 1)) for path, rest in REST.items()}
        matrices, weights = {}, {}
        for index in range(len(rows)):
            node = document.entry("nodes", index)
            if "matrix" in node:
                matrices[index] = self._pose(node)
            for path, rest in REST.items():
                local[path][index] = document.numbers(node, path, rest)
            if "mesh" in node:
                mesh = document.entry("meshes", document.whole(node, "mesh"))
                weights[index] = np.array(self._weights(node if "weights" in node else mesh))
        return Rig(self._first(), parents, order, local, matrices, weights, animations)

    def _skin(self, index: int) -> Skin:
        if index not in self._skins:
            document, what = self._document, f"skins[{index}]"
            row = document.entry("skins", index)
            joints = document.listed(row, "joints")
            for joint in joints:
                document.entry("nodes", joint)
            inverse = np.tile(np.eye(4), (len(joints), 1, 1))
            if "inverseBindMatrices" in row:
                stored = document.floats(document.whole(row, "inverseBindMatrices")).astype(np.float64)
                if stored.shape[1] != 16 or len(stored) < len(joints):
                    document.fail(f"{what}: its inverse bind matrices do not fit its {len(joints)} joints")
                inverse = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
            if not joints:
                document.fail(f"{what}: it has no joints")
            self._skins[index] = Skin(np.array(joints, np.int64), inverse)
        return self._skins[index]

    def _animation(self, number: int) -> Animation:
        document, what = self._document, f"animations[{number}]"
        row = document.entry("animations", number)
        name = str(row.get("name") or number)
        tracks = []
        for channel in range(len(document.listed(row, "channels"))):
            own = document.entry("channels", channel, row)
            target = document.member(own, "target")
            path = target.get("path")
            if path not in (*REST, "weights") or "node" not in target:
                self._notes.add("animated properties", f"{name}: {path!s:.40}")
                continue
            sampler = document.entry("samplers", document.whole(own, "sampler"), row)
            node = document.whole(target, "node")
            tracks.append(self._track(node, path, sampler, f"{what}, channel {channel}"))
        duration = max((float(track.times[-1]) for track in tracks), default=0.0)
        return Animation(name, duration, tuple(tracks))

    def _track(self, node: int, path: Any, sampler: dict[str, Any], what: str) -> Track:
        document = self._document
        kind: Any = sampler.get("interpolation", "LINEAR")
        if kind not in ("STEP", "LINEAR", "CUBICSPLINE"):
            document.fail(f"{what}: the interpolation {kind!r:.40} is unknown")
        times = document.floats(document.whole(sampler, "input")).astype(np.float64)[:, 0]
        index = document.whole(sampler, "output")
        # Integers are of a fixed point, whether or not the accessor says so: numbers here are from -1 to 1.
        values = document.floats(index, always=path in ("rotation", "weights")).astype(np.float64)
        each = 3 if kind == "CUBICSPLINE" else 1
        width = len(REST[path]) if path in REST else self._targets_of(node)
        if not len(times) or (np.diff(times) <= 0).any() or not np.isfinite(times).all():
            document.fail(f"{what}: its times do not rise")
        if values.size != len(times) * each * width:
            document.fail(f"{what}: {values.size} numbers of {path} for {len(times)} keys of {width}")
        if not np.isfinite(values).all():
            document.fail(f"{what}: its keys are not finite")
        values = values.reshape(len(times), 3, width) if each == 3 else values.reshape(len(times), width)
        document.entry("nodes", node)
        return Track(node, path, times, values, kind)

    def _targets_of(self, node: int) -> int:
        """Morph targets of the mesh of a node."""
        document = self._document
        mesh = document.entry("meshes", document.whole(document.entry("nodes", node), "mesh"))
        return max(
            (
                len(document.listed(document.entry("primitives", k, mesh), "targets"))
                for k in range(len(document.listed(mesh, "primitives")))
            ),
            default=0,
        )

    def _bent(self, row: dict[str, Any], node: int, skin: Skin | None, what: str) -> Part | None:
        """A surface with what bends it."""
        part = self._part(row, (), what, own=True)
        if part is None:
            return None
        document, source = self._document, part.source
        vertices = np.ascontiguousarray(source.vertices, np.float32)
        count = len(vertices)
        targets = []
        for target in document.listed(row, "targets"):
            changes = {}
            for name in ("POSITION", "NORMAL"):
                if name in target:
                    changes[name] = document.floats(document.whole(target, name))
                    if changes[name].shape != (count, 3):
                        document.fail(
                            f"{what}: a morph target has {name} of shape {changes[name].shape} for {(count, 3)}"
                        )
            targets.append(changes)
        bend = Bend(node, vertices, source.normals, targets)
        attributes = document.member(row, "attributes")
        sets = [k for k in range(len(attributes)) if {f"JOINTS_{k}", f"WEIGHTS_{k}"} <= attributes.keys()]
        if skin is not None and sets:
            joints = [document.accessor(document.whole(attributes, f"JOINTS_{k}")) for k in sets]
            weights = [document.floats(document.whole(attributes, f"WEIGHTS_{k}"), always=True) for k in sets]
            if any(len(array) != count for array in (*joints, *weights)):
                document.fail(f"{what}: its joints and weights are not as many as its {count} vertices")
            if any(array.dtype.kind != "u" for array in joints):
                document.fail(f"{what}: its joints are no unsigned numbers")
            bend.skin = skin
            bend.joints = np.ascontiguousarray(np.concatenate(joints, axis=1), np.uint32)
            bend.weights = np.ascontiguousarray(np.concatenate(weights, axis=1), np.float32)
            if bend.joints.shape != bend.weights.shape:
                document.fail(f"{what}: it has other joints than weights")
            if bend.joints.size and int(bend.joints.max()) >= len(skin.joints):
                document.fail(
                    f"{what}: joint {bend.joints.max()} is beyond the {len(skin.joints)} of its skin"
                )
        elif skin is not None:
            self._notes.add("skins without joints and weights", what)
        part.bend = bend
        return part

    # ---------------------------------------------------------------------------------------- shapes

    def _part(
        self, row: dict[str, Any], weights: tuple[float, ...], what: str, *, own: bool = False
    ) -> Part | None:
        """A primitive; with ``own`` its arrays are shared with no other."""
        source = self._arrays(row, weights, what) if own else self._source(row, weights, what)
        if source is None:
            return None
        material = self.look(row, len(source.uvs))
        if source.normals is None:
            material = replace(material, smooth=False)  # as glTF wants it
        return Part(what, source, material)

    def look(self, row: dict[str, Any], uv_sets: int) -> Material:
        """The material of a primitive with so many UV sets."""
        index = self._document.whole(row, "material") if "material" in row else None
        return fitted(self._material(index), self._name_of(index), uv_sets, self._notes)

    def _source(self, row: dict[str, Any], weights: tuple[float, ...], what: str) -> Source | None:
        """Arrays of a primitive; primitives that differ only in their material share them."""
        keys = ("attributes", "indices", "mode", "targets", "extensions")
        key = json.dumps([weights, *(row.get(key) for key in keys)], sort_keys=True)
        if key not in self._sources:
            self._sources[key] = self._arrays(row, weights, what)
        return self._sources[key]

    def _arrays(self, row: dict[str, Any], weights: tuple[float, ...], what: str) -> Source | None:
        document = self._document
        attributes = document.member(row, "attributes")
        if "POSITION" not in attributes:
            self._notes.add("primitives without positions")
            return None
        packed = document.extension(row, "KHR_draco_mesh_compression")
        decoded = document.draco(packed, attributes, what) if packed is not None else None
        faces, unpacked = decoded if decoded is not None else (None, {})
        rows = self._vertices(row, weights, unpacked, what)
        vertices = rows.numbers("POSITION", (3,))
        faces = self._faces(row, len(vertices), what) if faces is None else faces
        if faces is None:
            return None
        if not has_area(vertices, faces):
            self._notes.add("surfaces without area")
            return None
        source = Source(vertices, faces)  # type: ignore[arg-type]  # float32 will do
        if "NORMAL" in attributes:
            source.normals = rows.numbers("NORMAL", (3,))
        source.uvs = rows.uvs()
        source.channels = rows.channels(self._notes)
        if "COLOR_0" in attributes:
            source.colors = _colors.rgba(rows.numbers("COLOR_0", (3, 4)))
        for name in attributes:
            if not _READ.fullmatch(name):
                self._notes.add("attributes of vertices", name)
        return source

    def _stroke(self, row: dict[str, Any], weights: tuple[float, ...], what: str) -> StrokePart | None:
        """A primitive of points or lines; nothing of others."""
        document, mode = self._document, self._document.whole(row, "mode", 4)
        attributes = document.member(row, "attributes")
        if mode not in (POINTS, LINES, LINE_LOOP, LINE_STRIP) or "POSITION" not in attributes:
            return None
        rows = self._vertices(row, weights, {}, what)
        positions = rows.numbers("POSITION", (3,))
        colors = None
        if "COLOR_0" in attributes:
            painted = _colors.rgba(rows.numbers("COLOR_0", (3, 4)))
            colors = painted[:, :3]
            if not _colors.is_white(painted[:, 3]):
                self._notes.add("alpha of points and lines", what)
        order = self._order(row, len(positions), what)
        ends = segments(order, mode)
        if ends is None and "indices" in row:
            positions, colors = positions[order], None if colors is None else colors[order]
        if not len(positions if ends is None else ends):
            self._notes.add("points and lines of nothing", what)
            return None
        return StrokePart(what, positions, ends, colors, self.look(row, 0))

    def _vertices(
        self,
        row: dict[str, Any],
        weights: tuple[float, ...],
        unpacked: dict[str, NDArray[Any]],
        what: str,
    ) -> _Vertices:
        """The vertices of a primitive, moved by its targets as far as these count."""
        document = self._document
        targets = document.listed(row, "targets")
        moved = [(weight, target) for weight, target in zip(weights, targets, strict=False) if weight]
        return _Vertices(document, document.member(row, "attributes"), unpacked, moved, what)

    def _order(self, row: dict[str, Any], count: int, what: str) -> NDArray[np.int64]:
        """The vertices of a primitive in their order."""
        document = self._document
        order = document.indices(document.whole(row, "indices")) if "indices" in row else np.arange(count)
        if len(order) and order.max() >= count:
            document.fail(f"{what}: index {order.max()} is beyond the {count} vertices")
        return order

    def _faces(self, row: dict[str, Any], count: int, what: str) -> NDArray[np.int64] | None:
        """Rows of three indices; nothing for points and lines."""
        return triangles(self._order(row, count, what), self._document.whole(row, "mode", 4))

    # ----------------------------------------------------------------------------------------- looks

    def _name_of(self, index: int | None) -> str:
        if index is None:
            return "default material"
        return str(self._document.entry("materials", index).get("name") or f"materials[{index}]")

    def _material(self, index: int | None) -> Material:
        if index not in self._materials:
            row = {} if index is None else self._document.entry("materials", index)
            self._materials[index] = self._read_material(row, self._name_of(index))
        return self._materials[index]

    def _read_material(self, row: dict[str, Any], name: str) -> Material:
        document = self._document
        rough = document.member(row, "pbrMetallicRoughness")
        color = _unit(document.numbers(rough, "baseColorFactor", (1.0, 1.0, 1.0, 1.0)))
        metallic = float(_unit(document.number(rough, "metallicFactor", 1.0)))
        roughness = float(_unit(document.number(rough, "roughnessFactor", 1.0)))
        painted = self._texture(rough, "baseColorTexture", name)
        rough_texture = self._texture(rough, "metallicRoughnessTexture", name)
        glossy = document.extension(row, "KHR_materials_pbrSpecularGlossiness")
        if glossy is not None:
            painted, rough_texture = self._texture(glossy, "diffuseTexture", name), None
            color, metallic, roughness = self._from_glossy(glossy, painted is not None, name)
        emissive = np.maximum(document.numbers(row, "emissiveFactor", (0.0, 0.0, 0.0)), 0.0)
        strong = document.extension(row, "KHR_materials_emissive_strength") or {}
        emissive *= max(document.number(strong, "emissiveStrength", 1.0), 0.0)
        emissive_texture = self._texture(row, "emissiveTexture", name)
        normal, occlusion = document.member(row, "normalTexture"), document.member(row, "occlusionTexture")
        mode = row.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            document.fail(f"material {name!r:.60}: alphaMode {mode!r:.40} is unknown")
        for extension in document.member(row, "extensions"):
            if extension.removeprefix(_LOOKS) not in _READ_LOOKS:
                self._notes.add(extension, name)
        if mode != "MASK":
            through = self._transmitted(row, color, name)
            if through is not None:
                color, mode = through, "BLEND"
        with named(document.name, f"material {name!r:.60}"):
            return Material(
                name=str(row.get("name") or ""),
                base_color=color,
                metallic=metallic,
                roughness=roughness,
                emissive=emissive,
                double_sided=row.get("doubleSided", False) is True,
                unlit=document.extension(row, "KHR_materials_unlit") is not None,
                base_color_texture=painted,
                metallic_roughness_texture=rough_texture,
                normal_texture=self._texture({"": normal}, "", name) if normal else None,
                occlusion_texture=self._texture({"": occlusion}, "", name) if occlusion else None,
                emissive_texture=emissive_texture,
                normal_scale=document.number(normal, "scale", 1.0),
                occlusion_strength=float(_unit(document.number(occlusion, "strength", 1.0))),
                alpha_mode=mode.lower(),
                alpha_cutoff=document.number(row, "alphaCutoff", 0.5) if mode == "MASK" else 0.5,
            )

    def _transmitted(
        self, row: dict[str, Any], color: NDArray[np.float64], name: str
    ) -> NDArray[np.float64] | None:
        """Base colour and alpha of what lets light through, as far as blending can show it; nothing of others.

        KHR_materials_transmission, _ior and _volume, as if the surface were thin: nothing is bent or blurred. What
        is not reflected at right angles, not absorbed and not scattered shows what is behind.
        """
        document = self._document
        transmission = document.extension(row, "KHR_materials_transmission")
        ior = document.extension(row, "KHR_materials_ior")
        if transmission is None:
            if ior is not None and document.number(ior, "ior", 1.5) != 1.5:
                self._notes.add("KHR_materials_ior", name)
            return None
        part = float(_unit(document.number(transmission, "transmissionFactor", 0.0)))
        if part == 0.0:
            return None
        index = max(document.number(ior or {}, "ior", 1.5), 1.0)
        color = color.copy()
        volume = document.extension(row, "KHR_materials_volume")
        if volume is not None:
            thickness = max(document.number(volume, "thicknessFactor", 0.0), 0.0)
            # Without a distance nothing is absorbed.
            distance = document.number(volume, "attenuationDistance", 0.0)
            tint = _unit(document.numbers(volume, "attenuationColor", (1.0, 1.0, 1.0)))
            color[:3] *= tint ** (thickness / distance if distance > 0.0 else 0.0)
        through = part * (1.0 - ((index - 1.0) / (index + 1.0)) ** 2) * float(color[:3].mean())
        color[3] *= 1.0 - through
        self._notes.add("transmission, drawn as thin blended surfaces", name)
        return color

    def _from_glossy(
        self, row: dict[str, Any], textured: bool, name: str
    ) -> tuple[NDArray[np.float64], float, float]:
        """Base colour, metallic and roughness that look like specular and glossiness.

        Solved as in Khronos' converter: what reflects more than 4 % does so because it is partly metal.
        """
        document = self._document
        diffuse = _unit(document.numbers(row, "diffuseFactor", (1.0, 1.0, 1.0, 1.0)))
        specular = _unit(document.numbers(row, "specularFactor", (1.0, 1.0, 1.0)))
        roughness = 1.0 - float(_unit(document.number(row, "glossinessFactor", 1.0)))
        if "specularGlossinessTexture" in row:
            self._notes.add("textures of specular colour and glossiness", name)
            return diffuse, 0.0, max(roughness, 0.5)
        rest = 1.0 - float(specular.max())
        bright = [
            float(np.sqrt(np.dot((0.299, 0.587, 0.114), color**2))) for color in (diffuse[:3], specular)
        ]
        metallic = 0.0
        if bright[1] > 0.04:
            b = bright[0] * rest / 0.96 + bright[1] - 0.08
            metallic = float(np.clip((np.sqrt(b * b - 0.16 * (0.04 - bright[1])) - b) / 0.08, 0.0, 1.0))
        if textured:
            return diffuse, metallic, roughness
        spread = diffuse[:3] * rest / 0.96 / max(1.0 - metallic, 1e-4)
        mirrored = (specular - 0.04 * (1.0 - metallic)) / max(metallic, 1e-4)
        color = spread + (mirrored - spread) * metallic**2
        return np.append(_unit(color), diffuse[3]), metallic, roughness

    def _texture(self, holder: dict[str, Any], key: str, name: str) -> Texture | None:
        """Return the texture that a material refers to as ``key``."""
        if key not in holder:
            return None
        document = self._document
        info = document.member(holder, key)
        row = document.entry("textures", info.get("index"))
        image = self._image_of(row, document.whole(info, "index"))
        if image is None:
            return None
        moved = document.extension(info, "KHR_texture_transform") or {}
        sets = document.whole(moved, "texCoord", document.whole(info, "texCoord", 0))
        if sets > 7:
            self._notes.add("textures left out, as surfaces have no such UVs", name)
            return None
        sampler = document.entry("samplers", row["sampler"]) if "sampler" in row else {}
        least, most = sampler.get("minFilter"), sampler.get("magFilter")
        for what, value, known in (
            ("minFilter", least, MIPMAPS),
            ("magFilter", most, (NEAREST, LINEAR)),
            ("wrapS", sampler.get("wrapS", 10497), WRAPS),
            ("wrapT", sampler.get("wrapT", 10497), WRAPS),
        ):
            if value is not None and value not in known:
                document.fail(f"samplers[{row['sampler']}]: {what} {value!r:.40} is unknown")
        # `Texture` has one filter; the one for magnification is seen most.
        near = most if most is not None else NEAREST if least in _NEAREST else LINEAR
        return Texture(
            image,
            uv_set=sets,
            wrap=(WRAPS[sampler.get("wrapS", 10497)], WRAPS[sampler.get("wrapT", 10497)]),
            filter="nearest" if near == NEAREST else "linear",
            mipmaps="linear" if least is None else MIPMAPS[least],
            offset=tuple(document.numbers(moved, "offset", (0.0, 0.0)).tolist()),
            rotation=document.number(moved, "rotation", 0.0),
            scale=tuple(document.numbers(moved, "scale", (1.0, 1.0)).tolist()),
        )

    def _image_of(self, row: dict[str, Any], number: int) -> Image | None:
        """Return the image of a texture: the plain one, or that of an extension where there is no other."""
        document = self._document
        sources = [row["source"]] if "source" in row else []
        for name in _IMAGES:
            extension = document.extension(row, name)
            if extension is not None and "source" in extension:
                sources.append(extension["source"])
        if not sources:
            self._refuse(FormatError(f"{document.name}: textures[{number}] has no image"))
            return None
        document.entry("images", sources[0])
        index = int(sources[0])
        if index not in self._images:
            self._images[index] = None
            try:
                self._images[index] = self._read_image(document.entry("images", index), f"images[{index}]")
            except (FileError, FormatError) as error:
                self._refuse(error)
        return self._images[index]

    def _refuse(self, error: NaniteError) -> None:
        if not self._drop:
            raise _advice.advised(error, _advice.WITHOUT_TEXTURE) from None
        self._notes.add("textures left out, as they cannot be read", str(error))

    def _read_image(self, row: dict[str, Any], what: str) -> Image:
        document = self._document
        if "bufferView" in row:
            data, name = bytes(document.view(document.whole(row, "bufferView"))), row.get("name")
        else:
            data, name = document.uri(row.get("uri"), what), str(row.get("uri"))
            name = row.get("name") if name[:5].lower() == "data:" else name
        return Image._read(data, f"{document.name}: {what}" + (f" {name!r:.80}" if name else ""))

    # --------------------------------------------------------------------------- lights and cameras

    def _light(self, found: dict[str, Any]) -> DirectionalLight | PointLight | SpotLight:
        document = self._document
        table = document.extension(document.json, "KHR_lights_punctual") or {}
        row = document.entry("lights", found.get("light"), table)
        color = np.maximum(document.numbers(row, "color", (1.0, 1.0, 1.0)), 0.0)
        strength = max(document.number(row, "intensity", 1.0), 0.0)
        reach = document.number(row, "range") if "range" in row else None
        if reach is not None and reach <= 0.0:
            reach = None
        kind = row.get("type")
        if kind == "directional":
            return DirectionalLight(color, strength)
        if kind == "point":
            return PointLight(color, strength, reach)
        if kind != "spot":
            document.fail(f"lights: the type {kind!r:.40} is unknown")
        spot = document.member(row, "spot")
        outer = min(max(document.number(spot, "outerConeAngle", np.pi / 4.0), 1e-3), np.pi / 2.0)
        inner = min(max(document.number(spot, "innerConeAngle", 0.0), 0.0), 0.999 * outer)
        return SpotLight(color, strength, reach, inner, outer)

    def _camera(self, index: int, pose: NDArray[np.float64]) -> None:
        document = self._document
        row = document.entry("cameras", index)
        kind = row.get("type")
        if kind not in ("perspective", "orthographic"):
            document.fail(f"cameras[{index}]: the type {kind!r:.40} is unknown")
        lens = document.member(row, str(kind))
        near, far = document.number(lens, "znear"), None
        if lens.get("zfar"):
            far = document.number(lens, "zfar")
        camera: Camera
        try:
            # As viewers have it, the height of the view is the file's and the width the picture's: nothing is
            # stretched, whatever the picture's aspect.
            if kind == "perspective":
                camera = PerspectiveCamera(document.number(lens, "yfov"), near, far)
            else:
                # glTF allows a near plane at 0, where float32 depth has no step.
                near = max(near, 1e-6 * (far or 1.0))
                camera = OrthographicCamera(None, abs(document.number(lens, "ymag")), near, far)
        except ArgumentError as error:
            document.fail(f"cameras[{index}]: {error}")
        self._asset.cameras.append((camera, rigid(pose)))


class _Vertices:
    """The attributes of a primitive's vertices, moved by its morph targets."""

    def __init__(
        self,
        document: Document,
        attributes: dict[str, Any],
        unpacked: dict[str, NDArray[Any]],
        moved: list[tuple[float, dict[str, Any]]],
        what: str,
    ) -> None:
        self._document, self._attributes, self._unpacked = document, attributes, unpacked
        self._moved, self._what = moved, what
        self._count: int | None = None

    def _fitting(self, name: str, array: NDArray[Any], widths: tuple[int, ...]) -> None:
        if array.shape[1] not in widths:
            wanted = " or ".join(str(width) for width in widths)
            self._document.fail(
                f"{self._what}: {name} has {array.shape[1]} numbers a vertex, expected {wanted}"
            )
        # The first that is asked for are positions.
        self._count = len(array) if self._count is None else self._count
        if len(array) != self._count:
            self._document.fail(f"{self._what}: {len(array)} of {name} for {self._count} vertices")

    def numbers(self, name: str, widths: tuple[int, ...]) -> NDArray[np.float32]:
        """Return an attribute as float32."""
        document = self._document
        index, stored = document.whole(self._attributes, name), self._unpacked.get(name)
        array = document.floats(index, stored, always=name.startswith("COLOR_"))
        self._fitting(name, array, widths)
        for weight, target in self._moved:
            if name in target:
                change = document.floats(document.whole(target, name))
                if change.shape != array.shape:
                    document.fail(
                        f"{self._what}: a morph target has {name} of shape {change.shape} for {array.shape}"
                    )
                array = array + np.float32(weight) * change
        return array

    def uvs(self) -> list[NDArray[np.float32]]:
        """Return the UV sets, v up. Those that are missing are zero: others keep their numbers."""
        known = [number for number in range(UV_SETS) if f"TEXCOORD_{number}" in self._attributes]
        sets = []
        for number in range(max(known, default=-1) + 1):
            uv = np.zeros((self._count or 0, 2))
            if number in known:
                uv = self.numbers(f"TEXCOORD_{number}", (2,)).astype(np.float64)
            uv[:, 1] = 1.0 - uv[:, 1]
            sets.append(uv.astype(np.float32))
        return sets

    def channels(self, notes: Notes) -> dict[str, NDArray[Any]]:
        """Return what applications added, under its own names."""
        document, found = self._document, {}
        for name in (name for name in self._attributes if name.startswith("_")):
            index = document.whole(self._attributes, name)
            if str(document.entry("accessors", index).get("type")).startswith("MAT"):
                notes.add("attributes of vertices", name)
                continue
            array = self._unpacked.get(name)
            array = document.accessor(index) if array is None else array
            if document.entry("accessors", index).get("normalized") is True:
                array = document.floats(index, array)
            self._fitting(name, array, (1, 2, 3, 4))
            found[name] = as_labels(name, array[:, 0] if array.shape[1] == 1 else array)
        return found


def _unit(values: Any) -> Any:
    return np.clip(values, 0.0, 1.0)


def _unique(name: str, taken: set[str]) -> str:
    """Return ``name``, or with a number behind it where another node has that."""
    found, number = name, 1
    while found in taken:
        found, number = f"{name}_{number}", number + 1
    taken.add(found)
    return found
