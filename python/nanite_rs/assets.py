"""Whole scenes out of files: glTF, PLY, STL, OBJ, OFF as they are defined, all else as trimesh reads it."""

from __future__ import annotations

import gzip
import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from nanite_rs import io
from nanite_rs._asset import Asset, Part, fitted, has_area, named
from nanite_rs._images import from_pillow, read_bytes
from nanite_rs.camera import Camera, PerspectiveCamera
from nanite_rs.exceptions import ArgumentError, DtypeError, FormatError, MeshError
from nanite_rs.material import Material
from nanite_rs.mesh import BuildOptions, NaniteMesh
from nanite_rs.scene import LightNode, MeshNode, Scene
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from collections.abc import Iterator

    import PIL.Image
    import trimesh
    from numpy.typing import NDArray

    from nanite_rs._progress import Progress

__all__ = ["LoadedScene", "load_scene"]


@dataclass(frozen=True)
class LoadedScene:
    """What `load_scene` made. It unpacks into what `Renderer.render` takes: scene, camera and pose."""

    scene: Scene
    """The instances and lights."""
    instances: dict[str, list[MeshNode]]
    """For each node with a mesh, by its name, the instances that were made of it; their ``instance_id`` is what
    frames show. Nodes of the same name have a number behind it."""
    lights: list[LightNode]
    """The lights that came with the file."""
    cameras: list[tuple[Camera, NDArray[np.float64]]]
    """The cameras that came with the file, each with its camera-to-world matrix."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """A box around the boxes of all instances, (2, 3); all zero where there are none."""
        return self.scene.bounds

    def view(
        self, direction: tuple[float, float, float] = (0.5, 0.4, 1.0), *, yfov: float = 0.8
    ) -> tuple[PerspectiveCamera, NDArray[np.float64]]:
        """Return a camera and its pose from which everything is seen, +Y up, in pictures wider than high.

        Parameters
        ----------
        direction : three floats
            From the middle of everything towards the camera.
        yfov : float
            Vertical field of view, radians.
        """
        low, high = self.bounds
        back = np.asarray(direction, np.float64)
        back = back / np.linalg.norm(back)
        right = np.cross((0.0, 1.0, 0.0) if abs(back[1]) < 0.999 else (0.0, 0.0, -1.0), back)
        right /= np.linalg.norm(right)
        radius = max(float(np.linalg.norm(high - low)) / 2.0, 1e-6)
        away = radius / np.sin(yfov / 2.0)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
        pose[:3, 3] = (low + high) / 2.0 + back * away
        return PerspectiveCamera(yfov, znear=max(away - radius, away * 0.01) * 0.5), pose

    def __iter__(self) -> Iterator[Any]:
        """Scene, the file's first camera or else that of `view`, and its pose."""
        camera, pose = self.cameras[0] if self.cameras else self.view()
        return iter((self.scene, camera, pose))

    def __repr__(self) -> str:
        count = sum(len(own) for own in self.instances.values())
        meshes = len({id(node.mesh) for own in self.instances.values() for node in own})
        return (
            f"<LoadedScene: {count:,} instances of {meshes:,} meshes,"
            f" {len(self.lights)} lights, {len(self.cameras)} cameras>"
        )


def load_scene(
    source: str | os.PathLike[str] | trimesh.Scene | trimesh.Trimesh,
    *,
    scene: Scene | None = None,
    options: BuildOptions | None = None,
    bad_textures: Literal["raise", "drop"] = "raise",
    progress: Progress = None,
) -> LoadedScene:
    """Load a scene with its materials, textures, lights and cameras.

    glTF and GLB are read as glTF 2.0 defines them: nodes, each primitive built once whatever the number of its
    instances, normals or flat faces where there are none, all UV sets, vertex colours (left out where all are
    white), metallic-roughness materials with their textures, samplers and ``KHR_texture_transform``, lights and
    cameras; also ``KHR_mesh_quantization``, ``EXT_mesh_gpu_instancing``, ``KHR_materials_unlit``,
    ``_emissive_strength`` and ``_pbrSpecularGlossiness``, Draco (with DracoPy) and meshopt (with meshoptimizer).
    PLY, STL, OFF, and OBJ with its MTL files are read by their definitions: instances are named after objects and
    solids, and whatever vertices and faces carry is kept by its name. Everything else is read by trimesh.

    What has no counterpart here is left out or changed, and a single warning says so: transparency is drawn as
    holes, textures go whose UVs the surface does not have, nodes flattened to nothing go, as do points and lines,
    skins, morph targets and the finer looks (clearcoat, sheen, transmission …). Animations are not played.

    Parameters
    ----------
    source : path, trimesh.Scene or trimesh.Trimesh
        A file, gzipped or not, or what trimesh made of one.
    scene : Scene, optional
        The scene to add to; by default a new one. As files have no ambient light, and many no light at all, set
        its `Scene.ambient_light` or add lights to see something.
    options : BuildOptions, optional
        How meshes are built.
    bad_textures : {"raise", "drop"}
        Whether a texture that is missing, damaged or of an unknown format is an error, or left out with the
        warning.
    progress : bool or callable, optional
        As in `NaniteMesh.from_arrays`, for each mesh.

    Returns
    -------
    LoadedScene
        The scene, its instances by node, and the cameras.

    Raises
    ------
    MissingFileError, FileError
        The file, or one that it refers to, cannot be read.
    FormatError
        The file or one that it refers to is damaged, or of an unknown format; the message says where.
    DependencyError
        The file needs an optional package, such as DracoPy; the message names it.
    MeshError
        There are no triangles, or a mesh cannot be built.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=3)
    >>> clay = trimesh.visual.material.PBRMaterial(metallicFactor=0.0)
    >>> ball.visual = trimesh.visual.TextureVisuals(material=clay)
    >>> _ = ball.export("ball.glb")
    >>> loaded = nrs.load_scene("ball.glb")
    >>> loaded
    <LoadedScene: 1 instances of 1 meshes, 0 lights, 0 cameras>
    >>> loaded.scene.ambient_light = (0.5, 0.5, 0.5)
    >>> with nrs.Renderer(64, 48) as renderer:
    ...     frame = renderer.render(*loaded)
    >>> bool((frame.depth > 0).any())
    True
    """
    import trimesh

    if bad_textures not in ("raise", "drop"):
        raise ArgumentError(f"bad_textures: must be 'raise' or 'drop', not {bad_textures!r}")
    if isinstance(source, trimesh.Scene | trimesh.Trimesh):
        asset = _from_trimesh(source, "trimesh scene", {}, drop_bad_textures=bad_textures == "drop")
    elif not isinstance(source, str | os.PathLike):
        raise DtypeError(f"source: expected a path or a trimesh object, not {type(source).__name__}")
    else:
        path = Path(source)
        if path.name.lower().endswith(io.NANITE_SUFFIX):
            target = Scene() if scene is None else scene
            node = target.add(NaniteMesh.open(path))
            return LoadedScene(target, {path.stem: [node]}, [], [])
        asset = read_asset(path, drop_bad_textures=bad_textures == "drop")
    loaded = _build(asset, scene, options, progress)
    asset.notes.warn(asset.name, stacklevel=2)
    return loaded


def read_asset(path: Path, *, drop_bad_textures: bool = False) -> Asset:
    """Read a file, building nothing."""
    suffix, packed = io.ending(path)
    if suffix in io.GLTF:
        from nanite_rs import _gltf

        return _gltf.read(
            str(path), _unpacked(path, packed), path.parent, drop_bad_textures=drop_bad_textures
        )
    if suffix in io.READERS:
        reader = import_module(f"nanite_rs.{io.READERS[suffix]}")
        asset: Asset = reader.read(
            str(path), _unpacked(path, packed), path.parent, drop_bad_textures=drop_bad_textures
        )
        return asset
    return _from_trimesh(io.load(path), str(path), {}, drop_bad_textures=drop_bad_textures)


def _unpacked(path: Path, packed: bool) -> bytes:
    content = read_bytes(path)
    if not packed:
        return content
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, ValueError) as error:
        raise FormatError(f"{path}: cannot be unpacked: {error}") from None


# ------------------------------------------------------------------------------------------------ building


def _build(
    asset: Asset, scene: Scene | None, options: BuildOptions | None, progress: Progress
) -> LoadedScene:
    """Build everything and add it; where that fails, take out again what was added."""
    loaded = LoadedScene(Scene() if scene is None else scene, {}, [], list(asset.cameras))
    try:
        _add_meshes(asset, loaded, options, progress)
        for light, pose in asset.lights:
            with named(asset.name, "light"):
                loaded.lights.append(loaded.scene.add(light, pose=pose))
        if not loaded.instances and not loaded.lights and not loaded.cameras:
            raise MeshError(f"{asset.name}: there are no triangles in it")
    except BaseException:
        for light_node in loaded.lights:
            light_node.remove()
        for node in (node for own in loaded.instances.values() for node in own):
            node.remove()
        raise
    return loaded


def _add_meshes(asset: Asset, loaded: LoadedScene, options: BuildOptions | None, progress: Progress) -> None:
    built: dict[int, NaniteMesh] = {}
    for name, number, pose in asset.placed:
        parts = asset.meshes[number]
        if not parts:
            continue
        if not _is_invertible(pose):
            asset.notes.add("nodes flattened to nothing", name)
            continue
        own = loaded.instances.setdefault(name, [])
        for part in parts:
            with named(asset.name, part.name):
                mesh = built.get(id(part.source))
                if mesh is None:
                    mesh = built[id(part.source)] = _mesh(part, options, progress)
                own.append(loaded.scene.add(mesh, pose=pose, material=part.material))


def _mesh(part: Part, options: BuildOptions | None, progress: Progress) -> NaniteMesh:
    arrays = part.source.arrays()
    if arrays["colors"] is not None and (arrays["colors"] == 255).all():
        arrays["colors"] = None
    return NaniteMesh.from_arrays(**arrays, options=options, progress=progress)


def _is_invertible(pose: NDArray[np.float64]) -> bool:
    """As `Scene.add` asks for it."""
    linear = pose[:3, :3]
    least = 1e-12 * float(np.prod(np.linalg.norm(linear, axis=0)))
    return abs(float(np.linalg.det(linear))) > least and bool(np.isfinite(np.linalg.inv(linear)).all())


# ------------------------------------------------------------------------------------------------- trimesh


def _from_trimesh(
    mesh: trimesh.Scene | trimesh.Trimesh,
    name: str,
    materials: dict[str, Material],
    *,
    drop_bad_textures: bool,
) -> Asset:
    """Describe a trimesh object. Materials given by name go before its own."""
    import trimesh

    asset = Asset(name)
    looks = _Looks(asset, materials, drop_bad_textures)
    if isinstance(mesh, trimesh.Trimesh):
        if looks.add("mesh", mesh):
            asset.placed.append(("mesh", 0, np.eye(4)))
        return asset
    numbers: dict[str, int] = {}
    for node in mesh.graph.nodes_geometry:
        transform, key = mesh.graph[node]
        geometry = mesh.geometry[key]
        if not isinstance(geometry, trimesh.Trimesh):
            asset.notes.add("points and lines")
            continue
        if key not in numbers:
            number = len(asset.meshes)
            numbers[key] = number if looks.add(key, geometry) else -1
        if numbers[key] >= 0:
            asset.placed.append((str(node), numbers[key], np.array(transform, np.float64)))
    if mesh.has_camera:
        from nanite_rs._gltf import rigid

        yfov = float(np.radians(mesh.camera.fov[1]))
        pose = rigid(np.asarray(mesh.camera_transform, np.float64))
        asset.cameras.append((PerspectiveCamera(yfov, znear=float(mesh.camera.z_near)), pose))
    return asset


class _Looks:
    """Meshes of trimesh with their materials; images that are the same object are read once."""

    def __init__(self, asset: Asset, materials: dict[str, Material], drop: bool) -> None:
        self._asset, self._materials, self._drop = asset, materials, drop
        self._images: dict[int, tuple[PIL.Image.Image, Image | None]] = {}

    def add(self, name: str, mesh: trimesh.Trimesh) -> bool:
        """Add a mesh to the asset, unless there is nothing to see of it."""
        if not has_area(np.asarray(mesh.vertices), np.asarray(mesh.faces)):
            self._asset.notes.add("surfaces without area", name)
            return False
        source = io._single(mesh)
        self._asset.meshes.append([Part(name, source, self._material(name, mesh, source))])
        return True

    def _material(self, name: str, mesh: trimesh.Trimesh, source: io.Source) -> Material | list[Material]:
        visual = mesh.visual
        if source.colors is not None and getattr(visual, "kind", None) != "texture":
            return Material(base_color=(1.0, 1.0, 1.0))
        found = getattr(visual, "material", None) if getattr(visual, "kind", None) == "texture" else None
        if found is None:
            return Material()
        several = getattr(found, "materials", None)
        if several is None:
            source.face_materials = None
            return self._one(found, name, source)
        looks = [self._one(material, name, source) for material in several]
        return looks if looks and source.face_materials is not None else (looks or [Material()])[0]

    def _one(self, found: Any, mesh: str, source: io.Source) -> Material:
        name = str(found.name or mesh)
        material = self._materials.get(name)
        if material is None:
            with named(self._asset.name, f"material {name!r}"):
                material = self._simple(found, name) if hasattr(found, "diffuse") else self._pbr(found, name)
        if material.alpha_mode == "blend" and name not in self._materials:
            what = "transparency, drawn as holes where alpha is below one half"
            self._asset.notes.add(what, name)
        return fitted(material, name, len(source.uvs), self._asset.notes)

    def _simple(self, found: Any, name: str) -> Material:
        """As trimesh and pyrender turn a glossy material into a rough one."""
        glossiness = found.glossiness
        if glossiness is None:
            glossiness = found.kwargs.get("Ns", found.kwargs.get("ns", 1.0))
        glossiness = max(float(np.ravel(np.asarray(glossiness, np.float64))[0]), 0.0)
        return Material(
            base_color=_color(found.diffuse, (0.8, 0.8, 0.8, 1.0)),
            roughness=float((2.0 / (glossiness + 2.0)) ** 0.25),
            base_color_texture=self._texture(found.image, name),
        )

    def _pbr(self, found: Any, name: str) -> Material:
        def factor(value: Any) -> float:
            return 1.0 if value is None else float(np.clip(value, 0.0, 1.0))

        mode = str(found.alphaMode or "OPAQUE").lower()
        textures: dict[str, Any] = {
            slot: self._texture(getattr(found, key, None), name)
            for slot, key in (
                ("base_color_texture", "baseColorTexture"),
                ("metallic_roughness_texture", "metallicRoughnessTexture"),
                ("normal_texture", "normalTexture"),
                ("occlusion_texture", "occlusionTexture"),
                ("emissive_texture", "emissiveTexture"),
            )
        }
        emissive = (
            np.zeros(3) if found.emissiveFactor is None else np.asarray(found.emissiveFactor, np.float64)
        )
        return Material(
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
