"""Conversion of scenes of other packages. Nothing here imports one: whoever has such a scene has imported it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from nanite_rs import _checks, _colors
from nanite_rs._asset import MIPMAPS, NEAREST, WRAPS, segments, triangles
from nanite_rs.camera import Camera, IntrinsicsCamera, OrthographicCamera, PerspectiveCamera
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.light import DirectionalLight, PointLight, SpotLight
from nanite_rs.material import Material
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import chosen, pays
from nanite_rs.scene import MeshNode, Scene
from nanite_rs.strokes import Lines, Points
from nanite_rs.texture import Image, Texture
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import pyrender
    from numpy.typing import NDArray

    from nanite_rs.options import BuildOptions, VirtualName

__all__ = ["PyrenderView", "from_pyrender"]

_Made = TypeVar("_Made")

# What was made of a primitive, while the primitive lives, behind the arrays and the setting that it was made from.
_built: WeakKeyDictionary[pyrender.Primitive, tuple[tuple[Any, ...], float, Any]]
_built = WeakKeyDictionary()

# Likewise the images of a texture: for roughness and metalness, and for everything else.
_images: WeakKeyDictionary[pyrender.Texture, tuple[NDArray[np.uint8], dict[bool, Image]]] = (
    WeakKeyDictionary()
)


@dataclass(frozen=True)
class PyrenderView:
    """A pyrender scene, taken over. It unpacks into what `Renderer.render` takes: scene, camera and pose."""

    scene: Scene
    """The meshes and lights."""
    camera: Camera
    """The main camera."""
    pose: NDArray[np.float64]
    """Its camera-to-world matrix, (4, 4)."""
    instances: dict[pyrender.Node, list[MeshNode]]
    """For each node with a mesh the instances that were made of it; their ``instance_id`` is what frames show."""
    shadows: bool = False
    """Whether the flags ask for shadows: ``render(*view, shadows=view.shadows)``."""

    def __iter__(self) -> Iterator[Any]:
        """Scene, camera and pose."""
        return iter((self.scene, self.camera, self.pose))


def from_pyrender(
    scene: pyrender.Scene,
    *,
    viewport: tuple[int, int] | None = None,
    options: BuildOptions | None = None,
    virtual: VirtualName = "auto",
    flags: int | None = None,
    point_size: float = 1.0,
) -> PyrenderView:
    """Take over a pyrender scene: meshes, poses, materials, lights, background and its main camera.

    A pyrender script changes two lines: the renderer, and ``render(scene)`` into
    ``render(*nrs.from_pyrender(scene))``. Meshes are built when a primitive is first seen, and again only if its
    arrays were replaced; everything else is read anew each time, so poses may change from frame to frame.

    What has no counterpart here is left out, and a warning says so once for each call: wireframes and specular
    colours. Points are discs where pyrender draws squares, and points and lines have their colours, whatever the
    light. Transparency is blended in linear light, by depth. Metal-rough materials
    with their textures and samplers, vertex colours and double-sidedness are kept. As in pyrender, textures lie on
    the first UV set and are filtered without anisotropy, and lights have no range. Masks have the holes that glTF
    wants and pyrender does not draw.

    Parameters
    ----------
    scene : pyrender.Scene
        The scene; it is not changed.
    viewport : (int, int), optional
        Width and height of the picture in pixels. pyrender's orthographic cameras take their width from it; without
        it the camera's ``xmag`` counts.
    options : BuildOptions, optional
        How to build meshes that were not seen before: all of them, where options are given.
    virtual : {"auto", "always", "never"}
        Which meshes are built as a `NaniteMesh`, with levels of detail; the others become a `TriangleMesh`, which
        is there at once. With ``"auto"`` those whose instances have 20,000 triangles or more together.
    flags : int, optional
        pyrender's ``RenderFlags``, of which those for shadows count: lights of the kinds that they name cast
        shadows, and no others. pyrender itself draws none of point lights. Without flags all lights may.
    point_size : float
        Diameter of points in pixels, as pyrender's ``OffscreenRenderer`` has it.

    Returns
    -------
    PyrenderView
        Unpacks into scene, camera and pose; `PyrenderView.instances` leads from nodes to instances.

    Raises
    ------
    DtypeError
        If it is no pyrender scene.
    ArgumentError
        If it has no camera, or one of a kind that is not pyrender's.
    MeshError
        If a mesh cannot be built.

    Examples
    --------
    >>> import pyrender, trimesh  # doctest: +SKIP
    >>> script = pyrender.Scene(ambient_light=(0.2, 0.2, 0.2))  # doctest: +SKIP
    >>> node = script.add(pyrender.Mesh.from_trimesh(trimesh.load("dragon.ply")))  # doctest: +SKIP
    >>> node = script.add(pyrender.PerspectiveCamera(yfov=0.8), pose=pose)  # doctest: +SKIP
    >>> with nrs.Renderer(1280, 720) as renderer:  # doctest: +SKIP
    ...     frame = renderer.render(*nrs.from_pyrender(script))
    """
    for name in ("mesh_nodes", "light_nodes", "camera_nodes", "get_pose"):
        if not hasattr(scene, name):
            raise DtypeError(f"scene: expected a pyrender.Scene, not {type(scene).__name__}")
    virtual = chosen(virtual, options)
    point_size = _checks.number(point_size, "point_size")
    if not 0.0 < point_size <= 1e6:
        raise ArgumentError(f"point_size: must be positive, not {point_size:g}")
    lost: set[str] = set()
    out = Scene(ambient_light=scene.ambient_light, bg_color=scene.bg_color)
    out._said = True  # pyrender does not either
    instances: dict[pyrender.Node, list[MeshNode]] = {}
    for node in (node for node in scene.nodes if node.mesh is not None):
        pose = scene.get_pose(node)
        own = instances[node] = []
        for primitive in node.mesh.primitives:
            mesh = _mesh(primitive, virtual, options, point_size)
            look = _material(primitive, lost)
            for instance in _poses(primitive):
                own.append(out.add(mesh, pose=pose @ instance, material=look))
                own[-1].visible = bool(node.mesh.is_visible)
    for node in (node for node in scene.nodes if node.light is not None):
        light = _light(node.light, flags)
        if light is None:
            lost.add(f"lights of type {type(node.light).__name__}")
        else:
            out.add(light, pose=scene.get_pose(node))
    node = scene.main_camera_node
    if node is None:
        raise ArgumentError(
            "scene: has no camera; scene.add(pyrender.PerspectiveCamera(yfov=0.8), pose=pose) adds one"
        )
    if lost:
        warnings.warn(f"left out of the pyrender scene: {', '.join(sorted(lost))}", stacklevel=2)
    pose = np.array(scene.get_pose(node), np.float64)
    shadows = flags is not None and any(node.light.casts_shadows for node in out.lights)
    return PyrenderView(out, _camera(node.camera, viewport), pose, instances, shadows)


# pyrender's flags of what casts shadows, by the kind of light.
_CASTING = {"DirectionalLight": 32, "PointLight": 64, "SpotLight": 128}


def _light(light: pyrender.Light, flags: int | None) -> DirectionalLight | PointLight | SpotLight | None:
    kind = type(light).__name__
    casts = flags is None or bool(int(flags) & _CASTING.get(kind, 0))
    if kind == "DirectionalLight":
        return DirectionalLight(light.color, light.intensity, casts_shadows=casts)
    if kind == "PointLight":
        return PointLight(light.color, light.intensity, casts_shadows=casts)
    if kind == "SpotLight":
        cone = {"innerConeAngle": light.innerConeAngle, "outerConeAngle": light.outerConeAngle}
        return SpotLight(light.color, light.intensity, **cone, casts_shadows=casts)
    return None


def _poses(primitive: pyrender.Primitive) -> Iterator[NDArray[np.float64]]:
    if primitive.poses is None:
        yield np.eye(4)
    else:
        yield from np.asarray(primitive.poses, np.float64)


def _mesh(
    primitive: pyrender.Primitive, virtual: VirtualName, options: BuildOptions | None, point_size: float
) -> NaniteMesh | TriangleMesh | Points | Lines:
    faces = _faces(primitive)
    if faces is None:
        return _strokes(primitive, point_size)
    sets = (primitive.texcoord_0, primitive.texcoord_1)
    instances = 1 if primitive.poses is None else len(primitive.poses)
    builds = pays(virtual, len(faces) * instances)
    carried = (primitive.normals, primitive.color_0, *sets)
    arrays = (primitive.positions, primitive.indices, *carried, options)

    def make() -> NaniteMesh | TriangleMesh:
        colors = None if primitive.color_0 is None else _colors.rgba(np.asarray(primitive.color_0))
        uvs = [np.asarray(uv, np.float32)[:, :2] for uv in sets if uv is not None]
        given: dict[str, Any] = {"normals": primitive.normals, "colors": colors, "uvs": uvs}
        if builds:
            return NaniteMesh.from_arrays(primitive.positions, faces, options=options, **given)
        return TriangleMesh(primitive.positions, faces, **given)

    return _made_once(primitive, arrays, builds, make)


def _made_once(
    primitive: pyrender.Primitive, arrays: tuple[Any, ...], setting: float, make: Callable[[], _Made]
) -> _Made:
    """What was made of a primitive, made anew where one of its arrays is another or a setting changed."""
    known = _built.get(primitive)
    # The arrays are kept alive, so that no other array gets the id of one of them.
    if known is None or known[1] != setting or [*map(id, known[0])] != [*map(id, arrays)]:
        known = _built[primitive] = (arrays, setting, make())
    made: _Made = known[2]
    return made


def _strokes(primitive: pyrender.Primitive, point_size: float) -> Points | Lines:
    """Points or lines of a primitive."""

    def make() -> Points | Lines:
        colors = None if primitive.color_0 is None else _colors.rgba(np.asarray(primitive.color_0))[:, :3]
        positions = np.asarray(primitive.positions)
        order = _order(primitive)
        ends = segments(order, primitive.mode)
        if ends is not None:
            return Lines(positions, ends, colors=colors)
        own = None if colors is None else colors[order]
        return Points(positions[order], colors=own, radius=point_size / 2.0)

    arrays = (primitive.positions, primitive.indices, primitive.color_0)
    return _made_once(primitive, arrays, point_size, make)


def _order(primitive: pyrender.Primitive) -> NDArray[np.int64]:
    """The vertices of a primitive in their order."""
    indices = np.arange(len(primitive.positions)) if primitive.indices is None else primitive.indices
    return np.asarray(indices, np.int64).reshape(-1)


def _faces(primitive: pyrender.Primitive) -> NDArray[np.int64] | None:
    """Triangles of a primitive; nothing where it is no surface."""
    return triangles(_order(primitive), primitive.mode)


def _material(primitive: pyrender.Primitive, lost: set[str]) -> Material:
    material = primitive.material
    if material.wireframe:
        lost.add("wireframes")
    metal_rough = hasattr(material, "baseColorFactor")
    if metal_rough:
        color, painted = material.baseColorFactor, material.baseColorTexture
        metallic, roughness = material.metallicFactor, material.roughnessFactor
        rough = material.metallicRoughnessTexture
    else:
        lost.add("specular colours")
        color, painted = material.diffuseFactor, material.diffuseTexture
        metallic, roughness, rough = 0.0, 1.0 - material.glossinessFactor, None
    mode = material.alphaMode.lower()
    if mode == "blend" and not _is_transparent(color, painted, primitive.color_0):
        mode = "opaque"  # what `pyrender.Mesh.from_trimesh` makes blends, and has nothing to blend
    emissive = np.zeros(3) if material.emissiveFactor is None else material.emissiveFactor
    found = {
        "base_color_texture": painted,
        "metallic_roughness_texture": rough,
        "normal_texture": material.normalTexture,
        "occlusion_texture": material.occlusionTexture,
        "emissive_texture": material.emissiveTexture,
    }
    textures: dict[str, Any] = {
        slot: _texture(texture, lost, rough=slot == "metallic_roughness_texture")
        for slot, texture in found.items()
        if texture is not None and primitive.texcoord_0 is not None
    }
    if len(textures) < sum(texture is not None for texture in found.values()):
        lost.add("textures of primitives without UVs")
    return Material(
        name=str(material.name or ""),
        base_color=color,
        metallic=metallic,
        roughness=roughness,
        emissive=emissive,
        double_sided=bool(material.doubleSided),
        smooth=primitive.normals is not None,
        alpha_mode=mode,
        alpha_cutoff=float(material.alphaCutoff) if mode == "mask" else 0.5,
        **textures,
    )


def _is_transparent(
    color: NDArray[Any], painted: pyrender.Texture | None, vertices: NDArray[Any] | None
) -> bool:
    pixels = None if painted is None else painted.source
    return bool(
        color[3] < 1.0
        or (pixels is not None and pixels.ndim == 3 and pixels.shape[2] == 4 and (pixels[..., 3] < 255).any())
        or (vertices is not None and (vertices[:, 3] < 1.0).any())
    )


def _texture(texture: pyrender.Texture, lost: set[str], *, rough: bool) -> Texture | None:
    if texture.source is None:
        lost.add("textures without pixels")
        return None
    known = _images.get(texture)
    if known is None or known[0] is not texture.source:
        known = _images[texture] = texture.source, {}
    if rough not in known[1]:
        known[1][rough] = Image(_pixels(texture.source, rough=rough))
    sampler = texture.sampler
    return Texture(
        known[1][rough],
        wrap=(WRAPS.get(sampler.wrapS, "clamp"), WRAPS.get(sampler.wrapT, "clamp")),
        filter="nearest" if sampler.magFilter == NEAREST else "linear",
        mipmaps=MIPMAPS.get(sampler.minFilter, "linear"),
        anisotropy=1,
    )


def _pixels(source: NDArray[Any], *, rough: bool) -> NDArray[np.uint8]:
    """Pixels as glTF has them: roughness in green and metalness in blue.

    pyrender takes the first two channels of a texture for them. When it makes one of an image, it puts there what
    glTF has in green and blue; of a `pyrender.Texture` that somebody made they are red and green.
    """
    pixels = np.asarray(source, np.uint8)
    if rough and pixels.ndim == 3 and pixels.shape[2] >= 2:
        return np.dstack([np.full_like(pixels[..., 0], 255), pixels[..., 0], pixels[..., 1]])
    return pixels


def _camera(camera: pyrender.Camera, viewport: tuple[int, int] | None) -> Camera:
    kind, planes = type(camera).__name__, {"znear": camera.znear, "zfar": camera.zfar}
    if kind == "PerspectiveCamera":
        return PerspectiveCamera(camera.yfov, aspectRatio=camera.aspectRatio, **planes)
    if kind == "IntrinsicsCamera":
        return IntrinsicsCamera(camera.fx, camera.fy, camera.cx, camera.cy, **planes)
    if kind == "OrthographicCamera":
        wide = camera.xmag if viewport is None else camera.ymag * viewport[0] / viewport[1]
        return OrthographicCamera(wide, camera.ymag, **planes)
    raise ArgumentError(f"scene: a camera of type {kind} has no counterpart")
