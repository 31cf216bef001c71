"""Scenes: many instances of meshes, points and lines, lights, ambient light, environment and background.

Poses are 4×4 object-to-world matrices (float64), rows first, right-handed. Adding, moving, hiding and removing
one instance costs the same in a scene of one as in a scene of a million.
"""

from __future__ import annotations

import copy
import sys
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload
from weakref import WeakKeyDictionary

import numpy as np

from nanite_rs import _advice, _checks, _core, _export_scene
from nanite_rs._geometry import Moving
from nanite_rs.assembly import Assembly, poses_of
from nanite_rs.exceptions import ArgumentError, DtypeError, StaleHandleError, UsageWarning
from nanite_rs.light import DirectionalLight, Environment, Light, PointLight, SpotLight
from nanite_rs.material import Look, Material, several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.skinned_mesh import SkinnedMesh
from nanite_rs.strokes import Lines, Points
from nanite_rs.swaying_mesh import SwayingMesh
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Mapping

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs import io
    from nanite_rs._checks import Color, Rgb
    from nanite_rs._export_packing import Compression, ImageFormat
    from nanite_rs._progress import Progress
    from nanite_rs.report import TilesReport

__all__ = ["LightNode", "MeshNode", "Scene"]

Handle: TypeAlias = tuple[int, int]
Shown: TypeAlias = NaniteMesh | SkinnedMesh | SwayingMesh | TriangleMesh | Points | Lines | Assembly
"""What an instance may be of."""


def _no_item(item: object) -> DtypeError:
    error = DtypeError(f"item: expected a mesh, points, lines or a light, not {_advice.name_of_type(item)}")
    return _advice.advised(error, _advice.for_item(item))


def _advised(error: ArgumentError, pose: ArrayLike | None) -> ArgumentError:
    """Say what to do about an instance that was refused."""
    message = str(error)
    if message.startswith("pose"):
        return _advice.advised(error, _advice.for_pose(pose))
    if "wants UV set" in message:
        return _advice.advised(error, "give the mesh uvs= when it is built")
    return error


def _shown(item: object) -> Shown | None:
    """A mesh, points or lines as they are, or those of trimesh, which need not be there."""
    if isinstance(item, NaniteMesh | SkinnedMesh | SwayingMesh | TriangleMesh | Points | Lines | Assembly):
        return item
    module = sys.modules.get("trimesh")
    if module is None:
        return None
    if isinstance(item, module.Trimesh):
        return TriangleMesh.from_trimesh(item)
    if isinstance(item, module.PointCloud):
        return Points.from_trimesh(item)
    if isinstance(item, module.path.Path3D):
        return Lines.from_trimesh(item)
    return None


def _pose(pose: ArrayLike | None) -> ArrayLike:
    return np.eye(4) if pose is None else pose


class _Node:
    """An entry of a scene: valid until it is removed."""

    __slots__ = ("_handle", "_scene")

    def __init__(self, scene: Scene, handle: Handle) -> None:
        self._scene, self._handle = scene, handle

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self) or not isinstance(other, _Node):
            return NotImplemented
        return self._scene is other._scene and self._handle == other._handle

    def __hash__(self) -> int:
        return hash((id(self._scene), self._handle))

    @property
    def scene(self) -> Scene:
        """The scene it belongs, or belonged, to."""
        return self._scene

    def __copy__(self) -> _Node:
        """Return the node itself: there is one of it in its scene."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the scene."""
        return _node, (type(self), self._scene, self._handle[0])


def _node(kind: type[MeshNode | LightNode], scene: Scene, number: int) -> MeshNode | LightNode:
    """Find the entry of a scene that came out of a pickle or a copy."""
    nodes: list[MeshNode | LightNode] = [*(scene.instances if kind is MeshNode else scene.lights)]
    for node in nodes:
        if node._handle[0] == number:
            return node
    raise StaleHandleError(f"stale handle: entry {number} was removed from the scene before it was copied")


class MeshNode(_Node):
    """An instance of a mesh in a scene; made by `Scene.add`.

    Every use after the instance was removed raises `StaleHandleError`.
    """

    __slots__ = ("_mesh",)

    def __init__(self, scene: Scene, handle: Handle, mesh: Shown) -> None:
        super().__init__(scene, handle)
        self._mesh = mesh

    @property
    def mesh(self) -> Any:
        """The mesh, points or lines, shared by all instances: what was added."""
        return self._mesh

    @property
    def instance_id(self) -> int:
        """The number that ``frame.instance_id`` shows for it; given away again after removal."""
        return self._handle[0]

    @property
    def pose(self) -> NDArray[np.float64]:
        """Object-to-world matrix, a (4, 4) float64 copy; assign to move the instance.

        Any invertible affine matrix will do, mirrors and shears included.
        """
        return self._scene._core.pose(self._handle)

    @pose.setter
    def pose(self, pose: ArrayLike) -> None:
        self._scene._core.set_pose(self._handle, pose)

    @property
    def visible(self) -> bool:
        """False hides the instance; assign to change it."""
        return self._scene._core.visible(self._handle)

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._scene._core.set_visible(self._handle, bool(visible))

    @property
    def casts_shadows(self) -> bool:
        """False where it is in no light's way; assign to change it. Counts with ``render(shadows=True)``.

        Of what is alpha-tested, what is left casts shadows; back faces do as fronts do.
        """
        return self._scene._core.shadows(self._handle)[0]

    @casts_shadows.setter
    def casts_shadows(self, casts: bool) -> None:
        self._scene._core.set_shadows(self._handle, bool(casts), self.receives_shadows)

    @property
    def receives_shadows(self) -> bool:
        """False where no shadow falls on it; assign to change it."""
        return self._scene._core.shadows(self._handle)[1]

    @receives_shadows.setter
    def receives_shadows(self, receives: bool) -> None:
        self._scene._core.set_shadows(self._handle, self.casts_shadows, bool(receives))

    @property
    def material(self) -> Look:
        """The look: a material, or those of the mesh's ``face_materials`` by number; assign to change it.

        Empty for an assembly, whose parts have their own.
        """
        self._scene._core.pose(self._handle)  # stale handles raise
        return self._scene._shown[self._handle][1]

    @material.setter
    def material(self, material: Look) -> None:
        if isinstance(self._mesh, Assembly):
            raise _no_look()
        self._scene._core.set_material(self._handle, self._mesh._looks(material))
        self._scene._look_for_alpha(material)
        self._scene._shown[self._handle] = self._mesh, material

    def remove(self) -> None:
        """Remove the instance from its scene."""
        self._scene._core.remove(self._handle)
        mesh, _ = self._scene._shown.pop(self._handle)
        if isinstance(mesh, Moving):
            self._scene._moving[mesh].discard(self._handle)

    def __repr__(self) -> str:
        try:
            x, y, z = self.pose[:3, 3]
        except StaleHandleError:
            return "<MeshNode, removed>"
        hidden = "" if self.visible else ", hidden"
        return (
            f"<MeshNode {self.instance_id}: {len(self._mesh):,} {self._mesh._ELEMENTS} at "
            f"({x:g}, {y:g}, {z:g}){hidden}>"
        )


def _no_look() -> ArgumentError:
    return ArgumentError("material: the parts of an assembly have their own; give them with the parts")


def _corners(node: MeshNode) -> NDArray[np.float64]:
    """Corners of the box around an instance's mesh in the world, (8, 3)."""
    low, high = node.mesh.bounds
    box = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    pose = node.pose
    corners: NDArray[np.float64] = box @ pose[:3, :3].T + pose[:3, 3]
    return corners


class LightNode(_Node):
    """A light in a scene; made by `Scene.add`.

    Every use after the light was removed raises `StaleHandleError`.
    """

    __slots__ = ()

    @property
    def light(self) -> Light:
        """The light; assign to change it."""
        self._scene._core.light_visible(self._handle)  # stale handles raise
        return self._scene._shining[self._handle]

    @light.setter
    def light(self, light: Light) -> None:
        if not isinstance(light, DirectionalLight | PointLight | SpotLight):
            raise DtypeError(f"light: expected a light, not {_advice.name_of_type(light)}")
        self._scene._core.set_light(self._handle, light._raw(), self.pose)
        self._scene._shining[self._handle] = light

    @property
    def visible(self) -> bool:
        """False switches the light off; assign to change it."""
        return self._scene._core.light_visible(self._handle)

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._scene._core.set_light_visible(self._handle, bool(visible))

    @property
    def pose(self) -> NDArray[np.float64]:
        """Light-to-world matrix, a (4, 4) float64 copy; assign to move the light."""
        return self._scene._core.light_pose(self._handle)

    @pose.setter
    def pose(self, pose: ArrayLike) -> None:
        self._scene._core.set_light(self._handle, self.light._raw(), pose)

    def remove(self) -> None:
        """Remove the light from its scene."""
        self._scene._core.remove_light(self._handle)
        del self._scene._shining[self._handle]

    def __repr__(self) -> str:
        try:
            x, y, z = self.pose[:3, 3]
        except StaleHandleError:
            return "<LightNode, removed>"
        hidden = "" if self.visible else ", off"
        return f"<LightNode {type(self.light).__name__} at ({x:g}, {y:g}, {z:g}){hidden}>"


class Scene(_advice.Teaching):
    """Instances of meshes, lights, ambient light, an environment and a background.

    There is no default light: without lights and ambient light surfaces are black, as in pyrender.

    Parameters
    ----------
    ambient_light : three floats
        Constant light on every surface, linear RGB.
    bg_color : three floats
        Colour of pixels that nothing covers, 0 to 1, written as it is (not gamma-encoded).
    environment : Environment, optional
        The environment map.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
    >>> scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    >>> node = scene.add(mesh, pose=np.eye(4))
    >>> sun = scene.add(nrs.DirectionalLight(intensity=3.0))
    >>> node.visible = False
    >>> node.remove()
    >>> node.pose
    Traceback (most recent call last):
    ...
    nanite_rs.exceptions.StaleHandleError: stale handle: instance 0 (generation 0) was removed from the scene
    """

    __slots__ = ("__weakref__", "_core", "_environment", "_moving", "_said", "_shining", "_shown")

    def __init__(
        self,
        *,
        ambient_light: Color = (0.0, 0.0, 0.0),
        bg_color: Color = (1.0, 1.0, 1.0),
        environment: Environment | None = None,
    ) -> None:
        self._core = _core.Scene()
        # Mesh and material of each instance. Not its node, which refers to the scene.
        self._shown: dict[Handle, tuple[Shown, Look]] = {}
        # The instances of each mesh that may change its shape.
        self._moving: WeakKeyDictionary[Moving, set[Handle]] = WeakKeyDictionary()
        self._shining: dict[Handle, Light] = {}
        # Whether there was a warning of alpha that counts for nothing.
        self._said = False
        self.ambient_light = ambient_light
        self.bg_color = bg_color
        self.environment = environment

    @overload
    def add(self, item: Light, *, pose: ArrayLike | None = None) -> LightNode: ...
    @overload
    def add(
        self,
        item: Shown | trimesh.Trimesh | trimesh.PointCloud | trimesh.path.Path3D,
        *,
        pose: ArrayLike | None = None,
        material: Look | None = None,
    ) -> MeshNode: ...
    @_advice.teaches(
        **dict.fromkeys(("transform", "matrix"), "give pose="), otherwise="give scene.add(item, pose=pose)"
    )
    def add(
        self,
        item: Shown | trimesh.Trimesh | trimesh.PointCloud | trimesh.path.Path3D | Light,
        *,
        pose: ArrayLike | None = None,
        material: Look | None = None,
    ) -> MeshNode | LightNode:
        """Add an instance of a mesh, of an assembly, of points or of lines, or a light.

        Parameters
        ----------
        item : NaniteMesh, SkinnedMesh, SwayingMesh, TriangleMesh, Assembly, Points, Lines or a light
            What to add. It is shared, not copied. Of a `trimesh.Trimesh` a `TriangleMesh` is made, of a
            `trimesh.PointCloud` `Points`, of a `trimesh.path.Path3D` `Lines`.
        pose : (4, 4) array, optional
            Object-to-world matrix; the identity when not given. For all but lights any invertible affine matrix.
        material : Material or sequence of Material, optional
            The look of a mesh instance: one material for all of it, or one for each number of the mesh's
            ``face_materials``, of which the last stands for all numbers from there on. Without it those that the
            mesh has (`NaniteMesh.materials`), or as pyrender has it: ``Material()``, with a base colour of white
            where the mesh has colours.

        Returns
        -------
        MeshNode or LightNode
            Moves, hides, changes and removes what was added.

        Raises
        ------
        ArgumentError
            If the pose is not finite, not affine or not invertible, a factor is out of range, or a texture wants a
            UV set that the mesh has not.
        DtypeError
            If ``item`` is something else.

        Warns
        -----
        UsageWarning
            The first time that an opaque material has alpha below 1: it is drawn opaque.
        """
        mesh = _shown(item)
        if isinstance(mesh, Assembly):
            if material is not None and material != ():
                raise _no_look()
            try:
                handle = self._core.add_assembly(mesh._core, _pose(pose))
            except ArgumentError as error:
                raise _advised(error, pose) from None
            self._shown[handle] = mesh, ()
            return MeshNode(self, handle, mesh)
        if mesh is not None:
            if material is None:
                material = mesh._default_look()
            self._look_for_alpha(material)
            try:
                handle = self._core.add_mesh(mesh._core, _pose(pose), mesh._looks(material))
            except ArgumentError as error:
                raise _advised(error, pose) from None
            self._shown[handle] = mesh, material
            if isinstance(mesh, Moving):
                self._moving.setdefault(mesh, set()).add(handle)
                mesh._scenes.add(self)
            return MeshNode(self, handle, mesh)
        if isinstance(item, DirectionalLight | PointLight | SpotLight):
            if material is not None:
                raise ArgumentError("material: a light has none")
            handle = self._core.add_light(item._raw(), _pose(pose))
            self._shining[handle] = item
            return LightNode(self, handle)
        raise _no_item(item)

    def add_many(
        self,
        item: Shown | trimesh.Trimesh | trimesh.PointCloud | trimesh.path.Path3D,
        poses: ArrayLike,
        *,
        material: Look | None = None,
    ) -> list[MeshNode]:
        """Add an instance at each of many poses, in one call: a hundred thousand take a fraction of a second.

        Parameters
        ----------
        item : NaniteMesh, SkinnedMesh, SwayingMesh, TriangleMesh, Assembly, Points or Lines
            What to add, as for `add`. Of what is made of a mesh of trimesh there is one.
        poses : (N, 4, 4) array
            Object-to-world matrices.
        material : Material or sequence of Material, optional
            The look of all instances, as for `add`.

        Returns
        -------
        list of MeshNode
            In the order of the poses.

        Raises
        ------
        ArgumentError, DtypeError
            As in `add`; the message names the pose. Nothing is added then.

        Examples
        --------
        >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
        >>> poses = np.tile(np.eye(4), (1_000, 1, 1))
        >>> poses[:, 0, 3] = 3.0 * np.arange(1_000)
        >>> nodes = scene.add_many(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80)), poses)
        >>> len(nodes) == len(scene) == 1_000
        True
        """
        mesh = _shown(item)
        if mesh is None:
            raise _no_item(item)
        array = poses_of(poses, "poses")
        if isinstance(mesh, Assembly):
            if material is not None and material != ():
                raise _no_look()
            look: Look = ()
            handles = self._core.add_assemblies(mesh._core, array)
        else:
            look = mesh._default_look() if material is None else material
            self._look_for_alpha(look)
            try:
                handles = self._core.add_meshes(mesh._core, array, mesh._looks(look))
            except ArgumentError as error:
                raise _advised(error, None) from None
        self._shown.update(dict.fromkeys(handles, (mesh, look)))
        if isinstance(mesh, Moving):
            self._moving.setdefault(mesh, set()).update(handles)
            mesh._scenes.add(self)
        return [MeshNode(self, handle, mesh) for handle in handles]

    def _look_for_alpha(self, material: Look) -> None:
        """Say once that an opaque material has alpha, which says nothing there."""
        if self._said:
            return
        for number, one in enumerate(several(material, "material")):
            if one._ignores_alpha():
                self._said = True
                which = "" if isinstance(material, Material) else f"[{number}]"
                _advice.warn(
                    f"material{which}: alpha {one.base_color[3]:g} counts for nothing: its alpha_mode is 'opaque'; "
                    "'blend' shows what is behind it",
                    UsageWarning,
                )
                return

    def clear(self) -> None:
        """Remove all instances and lights. Ambient light, environment and background stay, as in pyrender.

        Examples
        --------
        >>> scene = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
        >>> sun = scene.add(nrs.DirectionalLight())
        >>> scene.clear()
        >>> scene.lights, len(scene)
        ([], 0)
        """
        nodes: list[MeshNode | LightNode] = [*self.instances, *self.lights]
        for node in nodes:
            node.remove()

    @property
    def lights(self) -> list[LightNode]:
        """The lights, those switched off included, in the order in which they were added.

        Examples
        --------
        >>> scene = nrs.Scene()
        >>> sun = scene.add(nrs.DirectionalLight(intensity=3.0))
        >>> scene.lights == [sun]
        True
        """
        return [LightNode(self, handle) for handle in self._shining]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all that was added; instances and lights keep their numbers, and their meshes are shared."""
        kept = self.ambient_light, self.bg_color, self.environment
        shown = [
            (*self._shown[n._handle], n.pose, (n.visible, n.casts_shadows, n.receives_shadows), n._handle[0])
            for n in self.instances
        ]
        shining = [(n.light, n.pose, (n.visible,), n._handle[0]) for n in self.lights]
        return Scene, (), (kept, shown, shining)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Add everything."""
        (self.ambient_light, self.bg_color, self.environment), shown, shining = state
        self._said = True  # said before
        tables: tuple[tuple[Any, dict[Handle, Any]], ...] = (
            (shown, self._shown),
            (shining, self._shining),
        )
        for entries, own in tables:
            # Numbers are given in order: removed entries in between are added and removed again.
            known = {entry[-1]: entry for entry in entries}
            nodes: dict[int, Any] = {}
            for number in range(max(known, default=-1) + 1):
                item, *look, pose, flags, _ = known.get(number, entries[0])
                node: Any = self.add(item, pose=pose, material=look[0] if look else None)
                nodes[number] = node
                for name, flag in zip(("visible", "casts_shadows", "receives_shadows"), flags, strict=False):
                    setattr(node, name, flag)
            for number in nodes.keys() - known.keys():
                nodes[number].remove()
            order = [nodes[number]._handle for number in known]
            own.update([(handle, own.pop(handle)) for handle in order])

    def __copy__(self) -> Scene:
        """Return a scene of its own with the same meshes, looks and lights."""
        other = Scene()
        other.__setstate__(self.__reduce__()[2])
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Scene:
        """Return the same, with meshes of its own where their vertices may move."""
        memo[id(self)] = other = Scene()
        kept, shown, shining = self.__reduce__()[2]
        other.__setstate__((kept, [(copy.deepcopy(mesh, memo), *rest) for mesh, *rest in shown], shining))
        return other

    def remove(self, node: MeshNode | LightNode) -> None:
        """Remove ``node``, which `add` returned. Raises `StaleHandleError` when it was removed before."""
        if node.scene is not self:
            raise ArgumentError("node: belongs to another scene; node.remove() removes it from its own")
        node.remove()

    @property
    def instances(self) -> list[MeshNode]:
        """The instances of meshes, hidden ones included, in the order in which they were added.

        Examples
        --------
        >>> scene = nrs.Scene()
        >>> node = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20)))
        >>> scene.instances == [node]
        True
        """
        return [MeshNode(self, handle, mesh) for handle, (mesh, _) in self._shown.items()]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """A box around the boxes of all instances, (2, 3) float64; all zero where there are none."""
        corners = [_corners(node) for node in self.instances]
        if not corners:
            return np.zeros((2, 3))
        joined = np.concatenate(corners)
        return np.stack([joined.min(axis=0), joined.max(axis=0)])

    def export(
        self,
        path: io.PathLike,
        *,
        error: float | None = None,
        target_reduction: float | None = None,
        compression: Compression | None = None,
    ) -> None:
        """Write what is visible as a file that other programs read, in the format of its ending.

        ``.glb`` and ``.gltf`` hold nodes where the instances are, each mesh once for its instances, their
        materials with textures, points, lines, and lights (``KHR_lights_punctual``); poses that skew are
        applied to vertices. USD holds the same but for lights. Other formats, as in `Cut.export`, hold all
        meshes where they stand as one surface, with the materials of all. What a format cannot hold is named in
        a warning.

        Parameters
        ----------
        path : path
            The file. It is replaced in one step or not at all.
        error : float, optional
            Distance, in units of the world, that surfaces may have from their sources: each mesh is cut for it, as
            its instances are scaled. By default meshes have all their detail.
        target_reduction : float, optional
            The part of the faces of each mesh that is left out, 0 to 1, instead.
        compression : {None, "quantized", "meshopt", "meshopt-khr"}
            How glTF is made smaller, as for `Cut.export`.

        Raises
        ------
        FormatError
            The ending is unknown.
        FileError
            The file cannot be written.
        DependencyError
            An optional package is missing.
        ArgumentError
            Nothing is visible, ``compression`` is unknown, or both a distance and a part are given.

        Examples
        --------
        >>> scene = nrs.Scene()
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
        >>> for x in range(3):
        ...     pose = np.eye(4)
        ...     pose[0, 3] = 3 * x
        ...     node = scene.add(mesh, pose=pose)
        >>> scene.export("balls.glb", error=0.01)
        >>> len(nrs.load_scene("balls.glb").scene)
        3
        """
        _export_scene.export(self, _checks.path_of(path), error, target_reduction, compression)

    def to_3dtiles(
        self,
        folder: io.PathLike,
        *,
        triangles: int = 30_000,
        compression: Compression | None = "meshopt",
        images: ImageFormat | None = None,
        skirts: bool = True,
        pixel_error: float = 16.0,
        up: Literal["y", "z"] | None = None,
        preview: bool = False,
        workers: int | None = None,
        overwrite: bool = False,
        storage_options: Mapping[str, Any] | None = None,
        progress: Progress = None,
    ) -> TilesReport:
        """Write what is visible as 3D Tiles 1.1, as `NaniteMesh.to_3dtiles` does.

        The contents of a mesh are written once; each instance is a tile with its pose that has them. Lights, points
        and lines are left out, with a warning.

        Parameters
        ----------
        folder : path or URL
            Where the files go; it is made if need be.
        triangles, compression, images, skirts, pixel_error, preview, workers, overwrite, storage_options, progress
            As for `NaniteMesh.to_3dtiles`.
        up : {"y", "z"}, optional
            Which axis of the world points up: y by default, as in glTF.

        Returns
        -------
        TilesReport
            The path of ``tileset.json``, and how much was written.

        Raises
        ------
        ArgumentError, DtypeError, FileError
            As for `NaniteMesh.to_3dtiles`; or the scene shows no mesh.

        Examples
        --------
        >>> scene = nrs.Scene()
        >>> node = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000)))
        >>> scene.to_3dtiles("balls").tiles
        1
        """
        from nanite_rs._tiles import of_mesh, of_scene

        how = of_mesh.how(triangles, compression, images, skirts, pixel_error, preview, workers)
        return of_scene.export(self, folder, how, up, storage_options, overwrite, progress)

    @property
    def ambient_light(self) -> Rgb:
        """Constant light on every surface, linear RGB; assign to change it."""
        return self._core.ambient_light

    @ambient_light.setter
    def ambient_light(self, color: Color) -> None:
        self._core.set_ambient_light(_checks.bright(color, "ambient_light"))

    @property
    def bg_color(self) -> Rgb:
        """Colour of pixels that nothing covers; assign to change it."""
        return self._core.bg_color

    @bg_color.setter
    def bg_color(self, color: Color) -> None:
        self._core.set_bg_color(_checks.bright(color, "bg_color"))

    @property
    def environment(self) -> Environment | None:
        """The environment map; assign to change it, or ``None`` for none.

        Assigning raises `ArgumentError` where the map is not twice as wide as high, where its light is negative or
        brighter than 1e18, and where intensity or rotation are out of range.
        """
        return self._environment

    @environment.setter
    def environment(self, environment: Environment | None) -> None:
        if not (environment is None or isinstance(environment, Environment)):
            raise DtypeError(f"environment: expected an Environment, not {type(environment).__name__}")
        self._core.set_environment(None if environment is None else environment._raw())
        self._environment = environment

    def __len__(self) -> int:
        """Return the number of mesh instances."""
        return self._core.instance_count

    def __repr__(self) -> str:
        return f"<Scene: {len(self):,} instances, {self._core.light_count} lights>"
