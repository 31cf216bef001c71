"""Loading scenes from files: glTF, PLY, STL, OBJ and OFF by readers of our own, other formats by trimesh."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs import _checks, _colors, _trimesh, io
from nanite_rs._asset import Asset, Notes, Part, StrokePart, named, rigid
from nanite_rs._flatten import settle
from nanite_rs.camera import Camera, PerspectiveCamera
from nanite_rs.exceptions import ArgumentError, InternalError, MeshError
from nanite_rs.io import read_asset
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, chosen, creased, pays
from nanite_rs.scene import LightNode, MeshNode, Scene
from nanite_rs.skinned_mesh import SkinnedMesh
from nanite_rs.strokes import Lines, Points
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    import trimesh
    from numpy.typing import NDArray

    from nanite_rs._progress import Progress
    from nanite_rs._rig import Animation, Bend, Rig
    from nanite_rs.material import Look
    from nanite_rs.options import VirtualName

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
    animations: tuple[Animation, ...] = ()
    """What the file has to play; `set_time` does."""
    _motion: Motion | None = field(default=None, repr=False, compare=False)

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

    def set_time(self, time: float, animation: int | str = 0) -> None:
        """Put instances, joints, morph targets, lights and `cameras` where an animation has them at a time.

        What the animation does not move is as it was in the file. Frames that were rendered before keep what they
        show.

        Parameters
        ----------
        time : float
            Seconds. Before the first and after the last key that one counts; ``t % animation.duration`` repeats.
        animation : int or str
            Its number in `animations`, or its name.

        Raises
        ------
        ArgumentError
            If there is no such animation, or the time is not finite.
        StaleHandleError
            If an instance or a light that moves was removed from the scene.

        Examples
        --------
        >>> loaded = nrs.load_scene("walk.glb")  # doctest: +SKIP
        >>> with nrs.Renderer(640, 480) as renderer:  # doctest: +SKIP
        ...     frames = []
        ...     for step in range(50):
        ...         loaded.set_time(step / 25.0)
        ...         frames.append(renderer.render(*loaded))
        >>> nrs.save_animation("walk.gif", frames, fps=25)  # doctest: +SKIP
        """
        time = _checks.number(time, "time")
        if not np.isfinite(time):
            raise ArgumentError(f"time: must be finite, not {time}")
        names = [own.name for own in self.animations]
        known = names.index(animation) if animation in names else animation
        if isinstance(known, bool) or not isinstance(known, int | np.integer):
            raise ArgumentError(f"animation: there is no {animation!r} among {names}")
        if self._motion is None or not 0 <= known < len(names):
            raise ArgumentError(f"animation: there is no number {known} of {len(names)}")
        self._motion.play(self, self.animations[known], time)

    def __iter__(self) -> Iterator[Any]:
        """Scene, the file's first camera or else that of `view`, and its pose."""
        camera, pose = self.cameras[0] if self.cameras else self.view()
        return iter((self.scene, camera, pose))

    def __repr__(self) -> str:
        count = sum(len(own) for own in self.instances.values())
        meshes = {id(node.mesh): node.mesh for own in self.instances.values() for node in own}.values()
        virtual = sum(isinstance(mesh, NaniteMesh | SkinnedMesh) for mesh in meshes)
        return (
            f"<LoadedScene: {count:,} instances of {len(meshes):,} meshes, {virtual:,} virtual,"
            f" {len(self.lights)} lights, {len(self.cameras)} cameras>"
        )


def load_scene(
    source: io.Readable | trimesh.Scene | trimesh.Trimesh | trimesh.PointCloud | trimesh.path.Path3D,
    *,
    format: str | None = None,
    scene: Scene | None = None,
    options: BuildOptions | None = None,
    virtual: VirtualName = "auto",
    bad_textures: Literal["raise", "drop"] = "raise",
    progress: Progress = None,
) -> LoadedScene:
    """Load a scene with its materials, textures, lights and cameras.

    glTF and GLB are read as glTF 2.0 defines them: nodes, each primitive built once whatever the number of its
    instances, normals or flat faces where there are none, all UV sets, vertex colours (left out where all are
    white), metallic-roughness materials with their textures, samplers and ``KHR_texture_transform``, lights and
    cameras; also ``KHR_mesh_quantization``, ``EXT_mesh_gpu_instancing``, ``KHR_materials_unlit``,
    ``_emissive_strength`` and ``_pbrSpecularGlossiness``, Draco (with DracoPy) and meshopt (with meshoptimizer).
    Morph targets are applied by their weights at rest, and the centre of ``CESIUM_RTC`` is added. PLY, STL, OFF,
    and OBJ with its MTL files are read by their definitions: instances are named after objects and solids, and
    whatever vertices and faces carry is kept by its name. Everything else is read by trimesh; COLLADA comes in
    metres with +Y up, whatever its unit and axis.

    What has no counterpart here is left out or changed, and a single warning says so: textures go whose UVs the
    surface does not have, nodes flattened to nothing go, as do the finer looks (clearcoat, sheen …), and
    transmission is blended. Points are drawn a few pixels wide and lines one, in their colours: those of glTF, and
    of PLY files without faces.

    Of a glTF camera the height of the view counts, ``yfov`` or ``ymag``, and its width follows from the picture, as
    in web viewers: nothing is stretched where the picture has another aspect than the camera. STL files have
    creases where faces meet at more than 30 degrees, see ``BuildOptions.crease_angle``.

    Parameters
    ----------
    source : path, binary file, bytes, trimesh.Scene, Trimesh, PointCloud or Path3D
        A file, gzipped or not, an open one or the content of one, as in `NaniteMesh.from_file`; or what trimesh
        made of one.
    format : str, optional
        What the content is, such as ``"glb"``, instead of the ending of the name.
    scene : Scene, optional
        The scene to add to; by default a new one. As files have no ambient light, and many no light at all, set
        its `Scene.ambient_light` or add lights to see something.
    options : BuildOptions, optional
        How meshes are built: all of them, where options are given and ``virtual`` does not say otherwise.
    virtual : {"auto", "always", "never"}
        Which meshes are built as a `NaniteMesh`, with levels of detail; the others become a `TriangleMesh` and are
        there at once. With ``"auto"`` those whose instances have 20,000 triangles or more together, and those that
        carry what a `TriangleMesh` cannot: channels, face channels and creases. What joints bend is a `SkinnedMesh`
        then; what morph targets bend is never built. The representation of what is
        returned says how many.
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
        There is nothing to draw, or a mesh cannot be built.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=3)
    >>> clay = trimesh.visual.material.PBRMaterial(metallicFactor=0.0)
    >>> ball.visual = trimesh.visual.TextureVisuals(material=clay)
    >>> _ = ball.export("ball.glb")
    >>> loaded = nrs.load_scene("ball.glb")
    >>> loaded
    <LoadedScene: 1 instances of 1 meshes, 0 virtual, 0 lights, 0 cameras>
    >>> loaded.scene.ambient_light = (0.5, 0.5, 0.5)
    >>> with nrs.Renderer(64, 48) as renderer:
    ...     frame = renderer.render(*loaded)
    >>> bool((frame.depth > 0).any())
    True
    """
    import trimesh

    if bad_textures not in ("raise", "drop"):
        raise ArgumentError(f"bad_textures: must be 'raise' or 'drop', not {bad_textures!r}")
    virtual = chosen(virtual, options)
    drop = bad_textures == "drop"
    if isinstance(source, trimesh.PointCloud | trimesh.path.Path3D):
        source = trimesh.Scene([source])
    if isinstance(source, trimesh.Scene | trimesh.Trimesh):
        asset = _trimesh.described(source, "trimesh scene", drop_bad_textures=drop)
    else:
        file = io.given_file(source, format, "source")
        if "." + file.format == io.NANITE_SUFFIX:
            target = Scene() if scene is None else scene
            node = target.add(NaniteMesh.from_file(file))
            return LoadedScene(target, {Path(file.name).stem: [node]}, [], [])
        asset = read_asset(file, drop_bad_textures=drop)
        options = creased(options, None, file.format)
    loaded = _build(asset, scene, Making(virtual, options, progress))
    asset.notes.warn(asset.name)
    return loaded


# ------------------------------------------------------------------------------------------------ building


Built: TypeAlias = NaniteMesh | SkinnedMesh | TriangleMesh

WEIGHTS: Final = "weights of joints"
"""The channel of what follows joints."""


@dataclass(frozen=True)
class Making:
    """How meshes are made."""

    virtual: VirtualName
    options: BuildOptions | None
    progress: Progress
    rests: dict[tuple[str, int], NaniteMesh] = field(default_factory=dict)
    """Meshes at rest, by the names of their parts and how many joints they have: nodes share them."""

    @property
    def rebakes(self) -> bool:
        """Whether levels may have images of their own."""
        return self.options is not None and self.options.rebake != "never"

    def look(self, part: Part, mesh: Built) -> Look:
        """The look of an instance: that of the part, and those of levels with images of their own."""
        rebaked = self.rebakes and isinstance(mesh, NaniteMesh) and mesh.report.rebaked
        return mesh.materials if rebaked else part.material

    def mesh(self, part: Part, instances: int, notes: Notes) -> Built:
        """The mesh of a part that so many instances show."""
        source = part.source
        arrays = source.arrays()
        arrays.pop("materials")  # the instance has them
        if arrays["colors"] is not None and _colors.is_white(arrays["colors"]):
            arrays["colors"] = None
        creases = (
            source.normals is None and self.options is not None and self.options.crease_angle is not None
        )
        carries = bool(source.channels or source.face_channels) or creases
        builds = pays(self.virtual, len(source.faces) * instances) or (self.virtual == "auto" and carries)
        if builds and part.bend is None:
            looks = part.material if self.rebakes else None
            return NaniteMesh.from_arrays(
                **arrays, materials=looks, options=self.options, progress=self.progress
            )
        if builds and part.bend is not None and part.bend.follows_joints:
            return self._skinned(part.name, arrays, part.bend)
        if carries:
            notes.add("channels and creases, which ordinary meshes have not", part.name)
        return TriangleMesh(**{name: value for name, value in arrays.items() if "channels" not in name})

    def _skinned(self, name: str, arrays: dict[str, Any], bend: Bend) -> SkinnedMesh:
        """A mesh with levels of detail that follows joints, as it is bound to them."""
        skin, joints, weights = bend.skin, bend.joints, bend.weights
        if skin is None or joints is None or weights is None:
            raise InternalError("nothing to follow")
        key = name, len(skin.joints)
        if key not in self.rests:
            rows = SkinnedMesh.joint_weights(joints, weights, joint_count=len(skin.joints))
            arrays = {**arrays, "vertices": bend.vertices, "normals": bend.normals}
            arrays["channels"] = {**(arrays["channels"] or {}), WEIGHTS: rows}
            # Levels of what moves show the images of the source.
            how = None if self.options is None else replace(self.options, rebake="never")
            self.rests[key] = NaniteMesh.from_arrays(**arrays, options=how, progress=self.progress)
        return SkinnedMesh(self.rests[key], channel=WEIGHTS)


@dataclass
class Motion:
    """What of a scene follows the nodes of a file."""

    rig: Rig
    light_nodes: list[int]
    camera_nodes: list[int]
    placed: list[tuple[MeshNode, int, NDArray[np.float64]]] = field(default_factory=list)
    """Instances that move as a whole, their nodes, and their places about these."""
    bent: list[tuple[SkinnedMesh | TriangleMesh, Bend]] = field(default_factory=list)
    hidden: set[MeshNode] = field(default_factory=set)
    """Instances that are flattened to nothing now, and would be seen otherwise."""

    def note(
        self,
        node: MeshNode,
        mesh: Built | Points | Lines,
        bend: Bend | None,
        follow: tuple[int, NDArray[np.float64]] | None,
        *,
        hidden: bool,
    ) -> None:
        """Take note of an instance, of what bends it and the node that it follows, and whether that is flat."""
        if follow is not None:
            self.placed.append((node, *follow))
        known = any(own is mesh for own, _ in self.bent)
        if bend is not None and isinstance(mesh, SkinnedMesh | TriangleMesh) and not known:
            self.bent.append((mesh, bend))
            if isinstance(mesh, SkinnedMesh):
                mesh.pose(bend.matrices(self.rig.stance()))
        if hidden:
            self._hide(node)

    def _hide(self, node: MeshNode) -> None:
        if node.visible:
            node.visible = False
            self.hidden.add(node)

    def play(self, loaded: LoadedScene, animation: Animation, time: float) -> None:
        """Put everything where it is at a time."""
        stance = self.rig.stance(animation, time)
        for mesh, bend in self.bent:
            if isinstance(mesh, SkinnedMesh):
                mesh.pose(bend.matrices(stance))
                continue
            vertices, normals = bend.at(stance)
            mesh.update(vertices, normals="recompute" if normals is None else normals)
        for node, number, place in self.placed:
            pose = stance.nodes[number] @ place
            if not _is_invertible(pose):
                self._hide(node)
                continue
            node.pose = pose
            if node in self.hidden:
                self.hidden.discard(node)
                node.visible = True
        for light, number in zip(loaded.lights, self.light_nodes, strict=True):
            light.pose = rigid(stance.nodes[number])
        for k, number in enumerate(self.camera_nodes):
            loaded.cameras[k] = loaded.cameras[k][0], rigid(stance.nodes[number])


def _build(asset: Asset, scene: Scene | None, making: Making) -> LoadedScene:
    """Build everything and add it; where that fails, take out again what was added."""
    rig = asset.rig
    loaded = LoadedScene(
        Scene() if scene is None else scene,
        {},
        [],
        list(asset.cameras),
        () if rig is None else tuple(rig.animations),
        None if rig is None else Motion(rig, asset.light_nodes, asset.camera_nodes),
    )
    # Files may have alpha that counts for nothing.
    said, loaded.scene._said = loaded.scene._said, True
    try:
        _add_meshes(asset, loaded, making)
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
    finally:
        loaded.scene._said = said
    return loaded


def _add_meshes(asset: Asset, loaded: LoadedScene, making: Making) -> None:
    made: dict[tuple[int, int], Built] = {}
    drawn: dict[int, Points | Lines] = {}
    instances = Counter(id(part.source) for _, number, _ in asset.placed for part in asset.meshes[number])
    follows = asset.nodes or [None] * len(asset.placed)
    motion = loaded._motion
    moved = set() if asset.rig is None else asset.rig.moved_by(asset.rig.animations)
    for (name, number, pose), follow in zip(asset.placed, follows, strict=True):
        parts, strokes = asset.meshes[number], asset.strokes.get(number, [])
        if not (parts or strokes):
            continue
        moves = follow is not None and follow[0] in moved
        if not (moves or _is_invertible(pose)):
            asset.notes.add("nodes flattened to nothing", name)
            continue
        own = loaded.instances.setdefault(name, [])
        for part in parts:
            with named(asset.name, part.name):
                key = id(part.source), id(part.material) if making.rebakes else 0
                mesh = made.get(key)
                if mesh is None:
                    settle(part.source, asset.notes)
                    mesh = made[key] = making.mesh(part, instances[id(part.source)], asset.notes)
                flat = not _is_invertible(pose)
                node = loaded.scene.add(mesh, pose=None if flat else pose, material=making.look(part, mesh))
                own.append(node)
                if motion is not None:
                    motion.note(node, mesh, part.bend, follow if moves else None, hidden=flat)
        for stroke in strokes:
            with named(asset.name, stroke.name):
                shape = drawn.get(id(stroke))
                if shape is None:
                    shape = drawn[id(stroke)] = _stroked(stroke)
                flat = not _is_invertible(pose)
                look = stroke.material
                node = loaded.scene.add(shape, pose=None if flat else pose, material=look)
                own.append(node)
                if motion is not None:
                    motion.note(node, shape, None, follow if moves else None, hidden=flat)


def _stroked(part: StrokePart) -> Points | Lines:
    if part.segments is None:
        return Points(part.positions, colors=part.colors)
    return Lines(part.positions, part.segments, colors=part.colors)


def _is_invertible(pose: NDArray[np.float64]) -> bool:
    """As `Scene.add` asks for it."""
    linear = pose[:3, :3]
    least = 1e-12 * float(np.prod(np.linalg.norm(linear, axis=0)))
    return abs(float(np.linalg.det(linear))) > least and bool(np.isfinite(np.linalg.inv(linear)).all())
