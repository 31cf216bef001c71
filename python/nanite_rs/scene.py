"""Scenes: many instances of many meshes, lights, ambient light, environment and background.

Poses are 4×4 object-to-world matrices (float64), rows first, right-handed. Adding, moving, hiding and removing
one instance costs the same in a scene of one as in a scene of a million.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args, overload

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs.exceptions import ArgumentError, DtypeError, StaleHandleError, UsageWarning
from nanite_rs.mesh import NaniteMesh
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "DirectionalLight",
    "Environment",
    "LightNode",
    "Material",
    "MeshNode",
    "PointLight",
    "Scene",
    "SpotLight",
]

Color: TypeAlias = "Sequence[float] | NDArray[Any]"
Rgb: TypeAlias = tuple[float, float, float]
Handle: TypeAlias = tuple[int, int]
RawLight: TypeAlias = tuple[str, Rgb, float, float | None, tuple[float, float] | None]


def _rgb(value: Color, name: str) -> Rgb:
    """Three floats; a fourth (alpha) is accepted and ignored, as pyrender's users are used to give it."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise DtypeError(f"{name}: expected three numbers, not {value!r}") from None
    if array.shape not in {(3,), (4,)}:
        raise ArgumentError(f"{name}: expected three numbers, found shape {array.shape}")
    return float(array[0]), float(array[1]), float(array[2])


def _bright(value: Color, name: str) -> Rgb:
    """The same of what may exceed 1."""
    rgb = _rgb(value, name)
    if _advice.is_of_bytes(rgb):
        _advice.warn(f"{name}: {rgb} looks like 0 to 255; colours are 0 to 1: divide by 255", UsageWarning)
    return rgb


AlphaMode: TypeAlias = Literal["opaque", "mask", "blend"]


@_advice.teaching
@dataclass(frozen=True)
class Material:
    """A metallic-roughness material as in glTF: factors, linear, and textures that multiply them.

    An instance has one for its whole mesh, or one for each number of the mesh's ``face_materials``; another one can
    be assigned at any time without building anything anew. A scene without textures pays nothing for them.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the material is made.

    Examples
    --------
    >>> clay = nrs.Material(base_color=(0.7, 0.65, 0.6), metallic=0.1, roughness=0.5)
    >>> bricks = nrs.Texture(np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8))
    >>> wall = nrs.Material(base_color=(1, 1, 1), base_color_texture=bricks)
    """

    base_color: Color = (0.8, 0.8, 0.8)
    """Linear RGB, 0 to 1; a fourth number is alpha."""
    metallic: float = 0.0
    """0 dielectric to 1 metal."""
    roughness: float = 0.6
    """Perceptual roughness, 0 to 1; below 0.04 it is shaded as 0.04."""
    emissive: Color = (0.0, 0.0, 0.0)
    """Light given off, linear RGB; ``shading="pyrender"`` multiplies by it twice, as pyrender does."""
    double_sided: bool = False
    """Draw back faces too."""
    smooth: bool = True
    """Shade with interpolated vertex normals; otherwise every face is flat."""
    base_color_texture: Texture | None = None
    """Times the base colour, and its alpha times alpha; sRGB."""
    metallic_roughness_texture: Texture | None = None
    """Roughness in green, metallic in blue, times the factors."""
    normal_texture: Texture | None = None
    """Normals in tangent space, 0 to 1 for -1 to 1: +X along u, +Y along v, +Z off the surface. Tangents follow
    from the UVs."""
    occlusion_texture: Texture | None = None
    """In red, how much of the light from everywhere arrives."""
    emissive_texture: Texture | None = None
    """Times the light given off; sRGB."""
    normal_scale: float = 1.0
    """Times X and Y of the normal texture."""
    occlusion_strength: float = 1.0
    """0 for no occlusion to 1 for all that the texture says."""
    alpha_mode: AlphaMode = "opaque"
    """What alpha does: nothing; surfaces have holes where it is below the cutoff; or transparency, which is drawn
    as such holes."""
    alpha_cutoff: float = 0.5
    """Where alpha is below it, there is a hole."""

    def __post_init__(self) -> None:
        base = np.asarray(self.base_color, np.float64) if np.ndim(self.base_color) == 1 else None
        alpha = (float(base[3]),) if base is not None and base.shape == (4,) and base[3] != 1.0 else ()
        color = _rgb(self.base_color, "base_color")
        try:
            for one in color:
                _checks.unit(one, "base_color")
        except ArgumentError as error:
            raise _advice.advised(error, "divide colours of 0 to 255 by 255") from None
        for one in alpha:
            _checks.unit(one, "alpha")
        object.__setattr__(self, "base_color", color + alpha)
        object.__setattr__(self, "emissive", _bright(self.emissive, "emissive"))
        for one in self.emissive:
            _checks.not_negative(one, "emissive")
        for name, check in _NUMBERS.items():
            object.__setattr__(self, name, check(getattr(self, name), name))
        _checks.choice(self.alpha_mode, "alpha_mode", get_args(AlphaMode))
        for name in _SLOTS:
            texture = getattr(self, name)
            if not (texture is None or isinstance(texture, Texture)):
                wrong = DtypeError(f"{name}: expected a Texture, not {type(texture).__name__}")
                raise _advice.advised(wrong, _advice.for_texture(texture))

    def _raw(self) -> dict[str, Any]:
        textures = [getattr(self, name) for name in _SLOTS]
        return {
            "base_color": (*_rgb(self.base_color, "base_color"), *self.base_color[3:], 1.0)[:4],
            "metallic": self.metallic,
            "roughness": self.roughness,
            "emissive": _rgb(self.emissive, "emissive"),
            "double_sided": bool(self.double_sided),
            "smooth": bool(self.smooth),
            "normal_scale": self.normal_scale,
            "occlusion_strength": self.occlusion_strength,
            "alpha_cutoff": None if self.alpha_mode == "opaque" else self.alpha_cutoff,
            "textures": [
                None if texture is None else texture._raw(name in _COLORS)
                for name, texture in zip(_SLOTS, textures, strict=True)
            ],
        }


_NUMBERS = {
    "metallic": _checks.unit,
    "roughness": _checks.unit,
    "normal_scale": _checks.finite,
    "occlusion_strength": _checks.unit,
    "alpha_cutoff": _checks.finite,
}
_SLOTS = (
    "base_color_texture",
    "metallic_roughness_texture",
    "normal_texture",
    "occlusion_texture",
    "emissive_texture",
)
_COLORS = ("base_color_texture", "emissive_texture")


class _Shining(ABC):
    """Base of the lights: parameters are checked when one is made."""

    def __post_init__(self) -> None:
        _bright(vars(self)["color"], "color")
        try:
            _core.check_light(self._raw())
        except ArgumentError as error:
            name = str(error).partition(":")[0]
            angle = vars(self)[name] if name.endswith("Angle") else 0.0
            more = f"give degrees as np.radians({angle:g})" if angle > np.pi else ""
            raise _advice.advised(error, more) from None

    @abstractmethod
    def _raw(self) -> RawLight:
        """As Rust takes it."""

    def _color(self) -> tuple[Rgb, float]:
        return _rgb(vars(self)["color"], "color"), _checks.number(vars(self)["intensity"], "intensity")

    def _range(self) -> float | None:
        reach = vars(self)["range"]
        return None if reach is None else _checks.number(reach, "range")


@_advice.teaching
@dataclass(frozen=True)
class DirectionalLight(_Shining):
    """Light along the −Z of its pose, the same everywhere.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> light = nrs.DirectionalLight(color=(1.0, 1.0, 1.0), intensity=3.0)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Lux."""

    def _raw(self) -> RawLight:
        return "directional", *self._color(), None, None


@_advice.teaching
@dataclass(frozen=True)
class PointLight(_Shining):
    """Light from the origin of its pose, falling off with the square of the distance.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> light = nrs.PointLight(intensity=20.0)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Candela."""
    range: float | None = None
    """Distance at which the light has smoothly ended (glTF's window); ``None`` never. pyrender ignores it."""

    def _raw(self) -> RawLight:
        return "point", *self._color(), self._range(), None


@_advice.teaching
@dataclass(frozen=True)
class SpotLight(_Shining):
    """Light from the origin of its pose along its −Z, within a cone; otherwise as a `PointLight`.

    From the inner to the outer angle it falls off with the square of what is left of the cosine, as glTF's
    ``KHR_lights_punctual`` and pyrender have it.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> lamp = nrs.SpotLight(intensity=20.0, innerConeAngle=0.2, outerConeAngle=0.4)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Candela."""
    range: float | None = None
    """Distance at which the light has smoothly ended (glTF's window); ``None`` never. pyrender ignores it."""
    innerConeAngle: float = 0.0  # noqa: N815  pyrender's and glTF's name
    """Angle from the axis, radians, up to which nothing is lost; below the outer one."""
    outerConeAngle: float = float(np.pi / 4.0)  # noqa: N815
    """Angle from the axis, radians, from which on there is no light; above 0, at most π/2."""

    def _raw(self) -> RawLight:
        inner = _checks.number(self.innerConeAngle, "innerConeAngle")
        outer = _checks.number(self.outerConeAngle, "outerConeAngle")
        return "spot", *self._color(), self._range(), (inner, outer)


Light: TypeAlias = DirectionalLight | PointLight | SpotLight


@_advice.teaching
@dataclass(frozen=True)
class Environment:
    """Light from all around, as an equirectangular map of it: ``shading="gltf"`` alone knows it.

    Rows go from +Y down to −Y. The middle of the map is +X; to its right follow +Z, then, at both edges, −X, then
    −Z. What surfaces of each roughness see of it is worked out once for an `Image`, when an environment of it is
    first given to a scene; others of the same image with another intensity or rotation cost nothing.

    Examples
    --------
    >>> sky = np.linspace([0.5, 0.7, 1.0], [0.2, 0.15, 0.1], 32)[:, None] * np.ones((1, 64, 1))
    >>> scene = nrs.Scene(environment=nrs.Environment(sky, intensity=0.8, background=True))
    """

    image: Image
    """The map, twice as wide as high: linear light that may exceed 1 where it holds floats, else sRGB. A path is
    read by `Image.open`, an array makes one."""
    intensity: float = field(default=1.0, kw_only=True)
    """Times its light."""
    rotation: float = field(default=0.0, kw_only=True)
    """Turns it about +Y, radians, counter-clockwise as seen from above: by π/2, what was at +X is at −Z."""
    background: bool = field(default=False, kw_only=True)
    """Show it where nothing is in front of it, in place of ``Scene.bg_color``; as sharp as 512 rows are."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", Image._of(self.image))
        for name, value in (("intensity", self.intensity), ("rotation", self.rotation)):
            if not isinstance(value, int | float | np.integer | np.floating):
                raise DtypeError(f"{name}: expected a number, not {value!r}")
            object.__setattr__(self, name, float(value))
        if math.tau < abs(self.rotation) <= 360.0 and self.rotation.is_integer():
            _advice.warn(
                f"rotation: {self.rotation:g} looks like degrees; it is in radians: np.radians({self.rotation:g})",
                UsageWarning,
            )

    def _raw(self) -> tuple[_core.EnvironmentMap, float, float, bool]:
        return self.image._environment(), self.intensity, self.rotation, bool(self.background)


def _no_item(item: object) -> DtypeError:
    error = DtypeError(f"item: expected a NaniteMesh or a light, not {_advice.name_of_type(item)}")
    return _advice.advised(error, _advice.for_item(item))


def _advised(error: ArgumentError, pose: ArrayLike | None) -> ArgumentError:
    """Say what to do about an instance that was refused."""
    message = str(error)
    if message.startswith("pose"):
        return _advice.advised(error, _advice.for_pose(pose))
    if "wants UV set" in message:
        return _advice.advised(error, "give the mesh uvs= when it is built")
    return error


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


Look: TypeAlias = "Material | Sequence[Material]"


def _raw(material: Look) -> list[dict[str, Any]]:
    if isinstance(material, Texture):
        raise DtypeError(
            "material: expected a Material, not Texture; give Material(base_color_texture=texture)"
        )
    materials = [material] if isinstance(material, Material) else list(material)
    if not materials:
        raise ArgumentError("material: expected one at least, found an empty sequence")
    for number, one in enumerate(materials):
        if not isinstance(one, Material):
            raise DtypeError(
                f"material: expected a Material, not {type(one).__name__}, as number {number}; "
                "a colour goes into Material(base_color=...)"
            )
    return [one._raw() for one in materials]


class MeshNode(_Node):
    """An instance of a mesh in a scene; made by `Scene.add`.

    Every use after the instance was removed raises `StaleHandleError`.
    """

    __slots__ = ("_mesh",)

    def __init__(self, scene: Scene, handle: Handle, mesh: NaniteMesh) -> None:
        super().__init__(scene, handle)
        self._mesh = mesh

    @property
    def mesh(self) -> NaniteMesh:
        """The mesh, shared by all its instances."""
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
    def material(self) -> Look:
        """The look: a material, or those of the mesh's ``face_materials`` by number; assign to change it."""
        self._scene._core.pose(self._handle)  # stale handles raise
        return self._scene._shown[self._handle][1]

    @material.setter
    def material(self, material: Look) -> None:
        self._scene._core.set_material(self._handle, _raw(material))
        self._scene._shown[self._handle] = self._mesh, material

    def remove(self) -> None:
        """Remove the instance from its scene."""
        self._scene._core.remove(self._handle)
        del self._scene._shown[self._handle]

    def __repr__(self) -> str:
        try:
            x, y, z = self.pose[:3, 3]
        except StaleHandleError:
            return "<MeshNode, removed>"
        hidden = "" if self.visible else ", hidden"
        return (
            f"<MeshNode {self.instance_id}: {len(self._mesh):,} triangles at ({x:g}, {y:g}, {z:g}){hidden}>"
        )


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

    __slots__ = ("_light",)

    def __init__(self, scene: Scene, handle: Handle, light: Light) -> None:
        super().__init__(scene, handle)
        self._light = light

    @property
    def light(self) -> Light:
        """The light; assign to change it."""
        return self._light

    @light.setter
    def light(self, light: Light) -> None:
        self._scene._core.set_light(self._handle, light._raw(), self.pose)
        self._light = light

    @property
    def pose(self) -> NDArray[np.float64]:
        """Light-to-world matrix, a (4, 4) float64 copy; assign to move the light."""
        return self._scene._core.light_pose(self._handle)

    @pose.setter
    def pose(self, pose: ArrayLike) -> None:
        self._scene._core.set_light(self._handle, self._light._raw(), pose)

    def remove(self) -> None:
        """Remove the light from its scene."""
        self._scene._core.remove_light(self._handle)

    def __repr__(self) -> str:
        try:
            x, y, z = self.pose[:3, 3]
        except StaleHandleError:
            return "<LightNode, removed>"
        return f"<LightNode {type(self._light).__name__} at ({x:g}, {y:g}, {z:g})>"


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
        Light from all around, by a map.

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

    __slots__ = ("__weakref__", "_core", "_environment", "_shown")

    def __init__(
        self,
        *,
        ambient_light: Color = (0.0, 0.0, 0.0),
        bg_color: Color = (1.0, 1.0, 1.0),
        environment: Environment | None = None,
    ) -> None:
        self._core = _core.Scene()
        # Mesh and look of each instance. Not its node, which refers to the scene.
        self._shown: dict[Handle, tuple[NaniteMesh, Look]] = {}
        self.ambient_light = ambient_light
        self.bg_color = bg_color
        self.environment = environment

    @overload
    def add(
        self, item: NaniteMesh, *, pose: ArrayLike | None = None, material: Look | None = None
    ) -> MeshNode: ...
    @overload
    def add(self, item: Light, *, pose: ArrayLike | None = None) -> LightNode: ...
    @_advice.teaches(
        **dict.fromkeys(("transform", "matrix"), "give pose="), otherwise="give scene.add(item, pose=pose)"
    )
    def add(
        self,
        item: NaniteMesh | Light,
        *,
        pose: ArrayLike | None = None,
        material: Look | None = None,
    ) -> MeshNode | LightNode:
        """Add an instance of a mesh, or a light.

        Parameters
        ----------
        item : NaniteMesh, DirectionalLight, PointLight or SpotLight
            What to add. A mesh is shared, not copied.
        pose : (4, 4) array, optional
            Object-to-world matrix; the identity when not given. For a mesh any invertible affine matrix.
        material : Material or sequence of Material, optional
            The look of a mesh instance: one material for all of it, or one for each number of the mesh's
            ``face_materials``, of which the last stands for all numbers from there on.

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
        """
        if isinstance(item, NaniteMesh):
            material = Material() if material is None else material
            try:
                handle = self._core.add_mesh(item._core, _pose(pose), _raw(material))
            except ArgumentError as error:
                raise _advised(error, pose) from None
            self._shown[handle] = item, material
            return MeshNode(self, handle, item)
        if isinstance(item, DirectionalLight | PointLight | SpotLight):
            if material is not None:
                raise ArgumentError("material: a light has none")
            return LightNode(self, self._core.add_light(item._raw(), _pose(pose)), item)
        raise _no_item(item)

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

    @property
    def ambient_light(self) -> Rgb:
        """Constant light on every surface, linear RGB; assign to change it."""
        return self._core.ambient_light

    @ambient_light.setter
    def ambient_light(self, color: Color) -> None:
        self._core.set_ambient_light(_bright(color, "ambient_light"))

    @property
    def bg_color(self) -> Rgb:
        """Colour of pixels that nothing covers; assign to change it."""
        return self._core.bg_color

    @bg_color.setter
    def bg_color(self, color: Color) -> None:
        self._core.set_bg_color(_bright(color, "bg_color"))

    @property
    def environment(self) -> Environment | None:
        """Light from all around, by a map; assign to change it, or ``None`` for none.

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
