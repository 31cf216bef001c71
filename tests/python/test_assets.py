"""Textured scenes as users have them: beside pyrender, and read right by what test models were designed to show.

Each asset is drawn by pyrender on OSMesa and by the CPU backend with ``shading="pyrender"``, at full detail and at
one pixel of error, and with ``shading="gltf"``. Contact sheets of all four and of the difference go to
``target/contact-sheets/`` to be looked at.

What pyrender cannot do is left out on both sides: transparency and masks are opaque, emission is given as its
square root, since pyrender squares it, and what a node mirrors is given where it lies, since pyrender culls its
front and turns its normals.
"""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import nanite_rs as nrs
from nanite_rs import _flatten
from nanite_rs.assets import read_asset
from oracles import camera, compare, data, picture, rays

WIDTH, HEIGHT = 960, 540
SHEETS = Path(__file__).resolve().parents[2] / "target" / "contact-sheets"
AMBIENT = (0.25, 0.25, 0.25)


@dataclass(frozen=True)
class Case:
    """From where an asset is looked at, and how close the pictures have to be."""

    path: tuple[str, ...]
    direction: tuple[float, float, float] = (0.5, 0.35, 1.0)
    psnr: float = 38.0
    flip: float = 0.02


CASES = {
    "AlphaBlendModeTest": Case(("gltf", "AlphaBlendModeTest", "AlphaBlendModeTest.glb"), (0.1, 0.1, 1.0)),
    "FlightHelmet": Case(("gltf", "FlightHelmet", "FlightHelmet.gltf")),
    "MultiUVTest": Case(("gltf", "MultiUVTest", "MultiUVTest.glb")),
    "NegativeScaleTest": Case(("gltf", "NegativeScaleTest", "NegativeScaleTest.glb"), (0.1, 0.1, 1.0)),
    "SheenChair": Case(("gltf", "SheenChair", "glTF", "SheenChair.gltf")),
    "ToyCar": Case(("gltf", "ToyCar", "glTF", "ToyCar.gltf")),
    "VertexColorTest": Case(("gltf", "VertexColorTest", "VertexColorTest.glb"), (0.1, 0.1, 1.0)),
    "chess_board": Case(("gltf", "chess_board", "chess-board.glb"), (0.5, 0.8, 1.0)),
    "dutch_ship": Case(("gltf", "dutch_ship_medium_1k", "polyhaven", "dutch_ship_medium_1k.gltf")),
    "house": Case(("gltf", "house_lightmap_uv2", "house.glb")),
    "lamborghini": Case(("gltf", "lamborghini_gt3", "scene.glb")),
    "usd_shaderball": Case(("gltf", "usd_shaderball", "usd-shaderball-ball.glb")),
    "japanese_bridge_garden": Case(("cad", "japanese_bridge_garden", "scene.glb")),
    "occlusion_room": Case(("cad", "occlusion_room", "room.glb"), (0.4, 0.9, 1.0)),
    "zdm2_level": Case(("cad", "zdm2_level", "zdm2.glb"), (0.4, 0.9, 1.0)),
}


def comparable(material: nrs.Material) -> nrs.Material:
    """The same without what pyrender cannot do: textures without anisotropy, all where the first one lies."""
    textures = {
        slot: replace(texture, anisotropy=1)
        for slot in PYRENDER
        if (texture := getattr(material, slot)) is not None
    }
    first = next(iter(textures.values()), None)
    for slot, texture in textures.items():
        if (texture.uv_set, texture._rows()) != (first.uv_set, first._rows()):
            textures[slot] = None
    return replace(
        material,
        alpha_mode="opaque",
        normal_scale=1.0,
        occlusion_strength=1.0,
        **textures,
    )


def laid(source, material: nrs.Material) -> np.ndarray | None:
    """UVs for pyrender, which knows neither other sets nor transforms."""
    first = next((t for slot in PYRENDER if (t := getattr(material, slot)) is not None), None)
    if first is None:
        return source.uvs[0] if source.uvs else None
    u, v = (
        np.column_stack([source.uvs[first.uv_set], np.ones(len(source.vertices))]) @ np.array(first._rows()).T
    ).T
    return np.column_stack([u, 1.0 - v])


PYRENDER = {
    "base_color_texture": ("baseColorTexture", "RGBA"),
    "metallic_roughness_texture": ("metallicRoughnessTexture", "GB"),
    "normal_texture": ("normalTexture", "RGB"),
    "occlusion_texture": ("occlusionTexture", "R"),
    "emissive_texture": ("emissiveTexture", "RGB"),
}
GL_WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}


class Shots:
    """An asset in both forms, and the pictures of it."""

    def __init__(self, name: str, case: Case) -> None:
        self.name, self.case = name, case
        path = data.require(*case.path)
        self.pyrender = picture.import_pyrender()
        asset = read_asset(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.loaded = nrs.load_scene(path)
        self.materials: dict[nrs.MeshNode, tuple[nrs.Material, nrs.Material]] = {}
        self.placed: list[tuple] = []
        self.theirs = self.pyrender.Scene(ambient_light=AMBIENT, bg_color=(0.0, 0.0, 0.0, 0.0))
        self.textures: dict[tuple, object] = {}
        points = []
        nodes = {label: iter(own) for label, own in self.loaded.instances.items()}
        primitives: dict[object, object] = {}
        for label, number, pose in asset.placed:
            mirrored = bool(np.linalg.det(pose[:3, :3]) < 0.0)
            for part in asset.meshes[number]:
                points.append(
                    part.source.vertices[np.unique(part.source.faces)] @ pose[:3, :3].T + pose[:3, 3]
                )
                node = next(nodes[label])
                self.materials[node] = node.material, comparable(node.material)
                self.placed.append((part, pose, node))
                source = _flatten._transformed(replace(part.source), pose) if mirrored else part.source
                key = node if mirrored else id(part)
                if key not in primitives:
                    primitives[key] = self.pyrender.Mesh([self.primitive(source, self.materials[node][1])])
                self.theirs.add(primitives[key], pose=np.eye(4) if mirrored else pose)
        scene = self.loaded.scene
        for light in self.loaded.lights:
            light.remove()
        scene.ambient_light, scene.bg_color = AMBIENT, (0.0, 0.0, 0.0)
        self.view = camera.framing(np.concatenate(points), case.direction, width=WIDTH, height=HEIGHT)
        self.light()
        self.lens = lens = nrs.PerspectiveCamera(yfov=self.view.yfov, znear=self.view.znear)
        eye = self.pyrender.PerspectiveCamera(yfov=self.view.yfov, znear=self.view.znear)
        self.theirs.add(eye, pose=self.view.pose)
        color, self.depth = picture._offscreen(WIDTH, HEIGHT).render(self.theirs)
        self.color = np.array(color[..., :3])
        with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
            draw = functools.partial(renderer.render, scene, lens, self.view.pose)
            self.gltf = draw(pixel_error=1.0, shading="gltf", transfer="srgb")
            for node, (own, _) in self.materials.items():
                node.material = replace(own, alpha_mode="opaque")
            self.flat = draw(pixel_error=0.0, shading="flat", outputs=("color", "linear"))
            for node, (_, plain) in self.materials.items():
                node.material = plain
            self.full = draw(pixel_error=0.0, shading="pyrender")
            self.cut = draw(pixel_error=1.0, shading="pyrender")
        self.both = (self.depth > 0) & (self.full.depth > 0)
        self.inside = compare.away_from_silhouettes(self.depth, 1 / self.view.focal) & self.both

    def light(self) -> None:
        """A sun from the upper left behind the camera, and a lamp on the right."""
        pose = self.view.pose
        right, up, back, eye = pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3]
        sun = camera.look_at(eye - right + up + 0.5 * back, eye)
        target = eye - back * np.median(np.linalg.norm(eye - self.loaded.bounds.mean(axis=0)))
        away = float(np.linalg.norm(eye - target))
        lamp = np.eye(4)
        lamp[:3, 3] = target + (0.6 * right + 0.5 * up + 0.4 * back) * away
        for kind, pose, strength, color in (
            ("DirectionalLight", sun, 2.5, (1.0, 0.95, 0.9)),
            ("PointLight", lamp, 1.5 * away**2, (0.6, 0.8, 1.0)),
        ):
            self.loaded.scene.add(getattr(nrs, kind)(color, strength), pose=pose)
            self.theirs.add(
                getattr(self.pyrender, kind)(color=np.array(color), intensity=strength), pose=pose
            )

    def primitive(self, source, material: nrs.Material):
        """The same surface for pyrender: faces that are flat have vertices of their own."""
        faces = np.asarray(source.faces)
        arrays = {
            "positions": source.vertices,
            "normals": source.normals,
            "texcoord_0": laid(source, material),
            "color_0": None
            if source.colors is None or (source.colors == 255).all()
            else source.colors / 255.0,
        }
        if not material.smooth:
            corners = source.vertices[faces].astype(np.float64)
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            length = np.linalg.norm(cross, axis=1, keepdims=True)
            arrays = {key: None if a is None else a[faces.reshape(-1)] for key, a in arrays.items()}
            arrays["normals"] = np.repeat(cross / np.where(length > 0, length, 1.0), 3, axis=0)
            faces = np.arange(faces.size).reshape(-1, 3)
        look = self.pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(*material.base_color, 1.0)[:4],
            metallicFactor=material.metallic,
            roughnessFactor=material.roughness,
            emissiveFactor=material.emissive,
            doubleSided=material.double_sided,
        )
        for slot, (name, channels) in PYRENDER.items():
            texture = getattr(material, slot)
            if texture is not None:
                setattr(look, name, self.texture(texture, channels))
        return self.pyrender.Primitive(**arrays, indices=faces.astype(np.uint32), material=look, mode=4)

    def texture(self, texture: nrs.Texture, channels: str):
        key = id(texture.image), texture.wrap, texture.filter, texture.mipmaps, channels
        if key not in self.textures:
            near = texture.filter == "nearest"
            least = {None: 9728 if near else 9729, "nearest": 9984 + (not near), "linear": 9986 + (not near)}
            sampler = self.pyrender.Sampler(
                magFilter=9728 if near else 9729,
                minFilter=least[texture.mipmaps],
                wrapS=GL_WRAPS[texture.wrap[0]],
                wrapT=GL_WRAPS[texture.wrap[1]],
            )
            pixels = texture.image.pixels
            pixels = (pixels >> 8).astype(np.uint8) if pixels.dtype == np.uint16 else pixels
            made = self.pyrender.Texture(sampler=sampler, source=pixels, source_channels=channels)
            self.textures[key] = made, texture.image
        return self.textures[key][0]

    def sheet(self) -> Path:
        """Pyrender's picture, ours, the difference eight times; ours at a pixel of error, and as glTF has it."""
        difference = np.abs(self.full.color.astype(float) - self.color) * 8.0
        top = np.concatenate([self.color, self.full.color, difference], axis=1)
        covered = np.repeat(np.where(self.inside, 255, np.where(self.both, 128, 0))[..., None], 3, axis=-1)
        below = np.concatenate([self.gltf.color, self.cut.color, covered], axis=1)
        return compare.save_png(SHEETS / f"{self.name}.png", np.concatenate([top, below], axis=0)[::2, ::2])


@pytest.fixture(scope="module", params=CASES)
def shots(request) -> Shots:
    made = Shots(request.param, CASES[request.param])
    made.sheet()
    return made


def test_pictures_are_pyrenders(shots: Shots) -> None:
    inside, all_of_it = (
        compare.psnr(shots.full.color, shots.color, where) for where in (shots.inside, shots.both)
    )
    other = np.count_nonzero((shots.full.depth > 0) ^ (shots.depth > 0)) / np.count_nonzero(shots.depth > 0)
    print(
        f"\n{shots.name}: {inside:.2f} dB away from silhouettes, {all_of_it:.2f} dB over all; {other:.2e} uncovered"
    )
    assert shots.inside.sum() > 0.3 * shots.both.sum()
    assert other < 2e-3
    assert inside >= shots.case.psnr


def test_a_gpu_shows_the_same(shots: Shots) -> None:
    try:
        renderer = nrs.Renderer(WIDTH, HEIGHT, backend="gpu")
    except nrs.BackendError as error:
        pytest.skip(str(error))
    with renderer:
        frame = renderer.render(
            shots.loaded.scene, shots.lens, shots.view.pose, pixel_error=1.0, shading="pyrender"
        )
        assert renderer.backend == "gpu"
    # Drivers may round colours otherwise, and whose pixel an edge is; on software Vulkan all is the same.
    off = (np.abs(frame.color.astype(int) - shots.cut.color) > 1).any(axis=-1)
    assert np.count_nonzero(off) <= 1e-3 * off.size


@pytest.mark.parametrize("name", ["FlightHelmet", "ToyCar"])
def test_scenes_taken_over_are_pyrenders(name) -> None:
    shots = Shots(name, CASES[name])
    shots.theirs.ambient_light, shots.theirs.bg_color = np.array(AMBIENT), np.zeros(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view = nrs.from_pyrender(shots.theirs)
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        frame = renderer.render(*view, pixel_error=0.0, shading="pyrender")
    found = compare.psnr(frame.color, shots.color, shots.inside)
    print(f"\n{name}, taken over: {found:.2f} dB")
    assert found >= shots.case.psnr


def test_a_pixel_of_error_cannot_be_seen(shots: Shots) -> None:
    pytest.importorskip("OpenImageIO")
    full = nrs.compare(shots.full.color, shots.color).flip
    cut = nrs.compare(shots.cut.color, shots.color).flip
    print(f"\n{shots.name}: FLIP {full:.4f} at full detail, {cut:.4f} at one pixel of error")
    assert cut <= shots.case.flip


# ----------------------------------------------------------------------------- what the sources say by themselves


def encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB in 255ths."""
    v = np.clip(linear, 0.0, 1.0)
    return 255.0 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def decoded(levels: np.ndarray) -> np.ndarray:
    """Linear light of 255ths."""
    v = levels / 255.0
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def texels(texture: nrs.Texture, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The texel at each UV of a mesh, RGBA from 0 to 255, and how much its surroundings differ from each other.

    By the matrix of KHR_texture_transform, as the Khronos viewer has it, in NumPy.
    """
    c, s = np.cos(texture.rotation), np.sin(texture.rotation)
    u, v = uv[:, 0] * texture.scale[0], (1.0 - uv[:, 1]) * texture.scale[1]
    place = np.stack([c * u + s * v + texture.offset[0], -s * u + c * v + texture.offset[1]], axis=1)
    pixels = texture.image.pixels.astype(np.float64) / (
        257.0 if texture.image.pixels.dtype == np.uint16 else 1.0
    )
    height, width, channels = pixels.shape
    rgba = np.full((height, width, 4), 255.0)
    rgba[..., :3] = pixels[..., :3] if channels > 2 else pixels[..., :1]
    if channels in (2, 4):
        rgba[..., 3] = pixels[..., -1]
    at = []
    for axis, (way, side) in enumerate(zip(texture.wrap, (width, height), strict=True)):
        t = place[:, axis]
        t = {"repeat": t % 1.0, "mirror": 1.0 - np.abs(t % 2.0 - 1.0), "clamp": np.clip(t, 0.0, 1.0)}[way]
        at.append(np.minimum((t * side).astype(int), side - 1))
    return rgba[at[1], at[0]], spread(texture.image)[at[1], at[0]]


@functools.cache
def spread(image: nrs.Image) -> np.ndarray:
    """How far the levels around each pixel are apart, to a 32nd of the image away or 24 pixels, in 255ths."""
    window = max(49, min(image.size) // 16 | 1)
    pixels = image.pixels if image.pixels.dtype == np.uint8 else (image.pixels >> 8).astype(np.uint8)
    out = np.zeros(pixels.shape[:2], np.int64)
    for channel in np.moveaxis(pixels, -1, 0):
        high, low = (
            f(channel, window, mode="wrap") for f in (ndimage.maximum_filter, ndimage.minimum_filter)
        )
        out = np.maximum(out, high.astype(np.int64) - low)
    return out


class Struck:
    """What rays through pixel centres hit of parts that are placed: which, where on it, how far."""

    def __init__(self, placed: list[tuple], view: camera.View, mask: np.ndarray) -> None:
        corners, self.owner, self.face = [], [], []
        for number, (part, pose, node) in enumerate(placed):
            own = (part.source.vertices @ pose[:3, :3].T + pose[:3, 3])[part.source.faces]
            rows = np.arange(len(own))
            if np.linalg.det(pose[:3, :3]) < 0.0:
                own = own[:, ::-1]  # for culling alone
            if node.material.double_sided:
                own, rows = np.concatenate([own, own[:, ::-1]]), np.concatenate([rows, rows])
            corners.append(own)
            self.owner.append(np.full(len(own), number))
            self.face.append(rows)
        corners, self.owner, self.face = (np.concatenate(a) for a in (corners, self.owner, self.face))
        x, y = camera.pixel_centers(mask)
        eye = view.pose[:3, 3]
        traced = rays.Rays(
            corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3), culled_from=eye
        )
        self.directions = view.directions(x, y)
        self.hit, self.distance = traced.first(eye, self.directions)
        self.points = eye + self.directions * self.distance[:, None]
        self.placed = placed

    def of(self, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays that hit a part: their numbers, corners that they hit, and weights of those."""
        part, pose, _ = self.placed[number]
        own = np.flatnonzero((self.hit >= 0) & (self.owner[self.hit] == number))
        corners = part.source.faces[self.face[self.hit[own]]]
        a, b, c = ((part.source.vertices @ pose[:3, :3].T + pose[:3, 3])[corners[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        square = np.einsum("ij,ij->i", normal, normal)
        p = self.points[own]
        v = np.einsum("ij,ij->i", np.cross(p - a, c - a), normal) / square
        w = np.einsum("ij,ij->i", np.cross(b - a, p - a), normal) / square
        return own, corners, np.stack([1.0 - v - w, v, w], axis=1)


def blended(values: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ijk->ik", weights, np.asarray(values, np.float64)[corners])


NOISY = ("FlightHelmet", "SheenChair", "dutch_ship", "VertexColorTest", "chess_board")
"""Whose images have few places of one colour."""


def test_base_colours_are_what_the_source_says(shots: Shots) -> None:
    """As far as the surroundings on the image allow, whatever the filter."""
    mask = shots.inside & (np.random.default_rng(1).random(shots.inside.shape) < 0.3)
    ours = encoded(shots.flat.linear)[mask]
    struck = Struck(shots.placed, shots.view, mask)
    seen = shots.full.instance_id[mask]
    beyond, even_ones = [], 0
    for number, (part, _, node) in enumerate(shots.placed):
        own, corners, weights = struck.of(number)
        material = shots.materials[node][0]
        expected = np.tile(np.asarray(material.base_color[:3], np.float64), (len(own), 1))
        same, room = seen[own] == node.instance_id, np.zeros(len(own))
        if material.base_color_texture is not None:
            uv = blended(part.source.uvs[material.base_color_texture.uv_set], corners, weights)
            levels, room = texels(material.base_color_texture, uv)
            expected *= decoded(levels[:, :3])
        if part.source.colors is not None:
            expected *= blended(part.source.colors, corners, weights)[:, :3] / 255.0
        error = np.abs(ours[own] - encoded(expected)).max(axis=1)
        beyond.append((error - room)[same])
        even_ones += np.count_nonzero(same & (room <= 32))
    beyond = np.concatenate(beyond)
    print(
        f"\n{shots.name}: {even_ones:,} even of {len(beyond):,} pixels, 99.8 % to {np.quantile(beyond, 0.998):.1f}"
    )
    assert len(beyond) > 5_000
    assert even_ones > 1_000 or shots.name in NOISY
    assert np.quantile(beyond, 0.998) <= 3.0


def frame_of(name: str, direction=(0.0, 0.0, 1.0), **options):
    """A frame by glTF's model in even light, with parts as they were placed and the view."""
    case = CASES[name]
    asset = read_asset(data.require(*case.path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = nrs.load_scene(data.require(*case.path))
    loaded.scene.ambient_light, loaded.scene.bg_color = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    nodes = {key: iter(own) for key, own in loaded.instances.items()}
    placed = [
        (part, pose, next(nodes[key])) for key, number, pose in asset.placed for part in asset.meshes[number]
    ]
    corners = [part.source.vertices @ pose[:3, :3].T + pose[:3, 3] for part, pose, _ in placed]
    view = camera.framing(np.concatenate(corners), direction, width=WIDTH, height=HEIGHT)
    lens = nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        frame = renderer.render(
            loaded.scene, lens, view.pose, pixel_error=0.0, shading="gltf", transfer="srgb", **options
        )
    return frame, placed, view


def test_multiple_uvs_read_right() -> None:
    """The second UV set, of the emission, shows the logo; the first one would show words of failure."""
    frame, ((part, pose, node),), view = frame_of("MultiUVTest", (0.5, 0.35, 1.0))
    mask = compare.away_from_silhouettes(frame.depth, 1 / view.focal)
    struck = Struck([(part, pose, node)], view, mask)
    own, corners, weights = struck.of(0)
    material, light = node.material, 0.0
    assert (material.base_color_texture.uv_set, material.emissive_texture.uv_set) == (0, 1)
    even = np.ones(len(own), bool)
    for slot, factor in (
        ("base_color_texture", material.base_color),
        ("emissive_texture", material.emissive),
    ):
        texture = getattr(material, slot)
        levels, room = texels(texture, blended(part.source.uvs[texture.uv_set], corners, weights))
        light = light + decoded(levels[:, :3]) * np.array(factor[:3])
        even &= room <= 10
    error = np.abs(frame.color[mask][own] - encoded(light)).max(axis=1)[even]
    assert even.sum() > 5_000
    # Both colours of the logo are among them.
    assert np.ptp(frame.color[mask][own][even].astype(float), axis=0).max() > 50
    assert np.quantile(error, 0.999) <= 6.0


def test_vertex_colors_read_right() -> None:
    """The upper row, by vertex colours, looks as the lower one, by textures."""
    frame, placed, view = frame_of("VertexColorTest", (0.0, 0.0, 1.0))
    (test,) = (node for part, _, node in placed if part.source.colors is not None)
    color = frame.color.astype(np.float64)
    own = frame.instance_id == test.instance_id
    assert own.sum() > 20_000
    _, y, _ = view.project(np.array([[-2 / 3, 0.25, 0.0], [-2 / 3, -0.55, 0.0]]))
    assert (np.diff(y) > 0).all()
    # What each row has of pure red, green and blue.
    rows = np.arange(HEIGHT)[:, None]
    middle = np.nonzero(own.any(axis=1))[0].mean()
    for channel in range(3):
        others = [k for k in range(3) if k != channel]
        pure = (
            own & (color[..., channel] > 120) & (color[..., others].max(axis=-1) < 0.55 * color[..., channel])
        )
        above, below = (np.count_nonzero(pure & half) for half in (rows < middle, rows >= middle))
        assert above > 500
        assert abs(above - below) < 0.15 * below
        mean = [color[pure & half].mean(axis=0) for half in (rows < middle, rows >= middle)]
        assert np.abs(mean[0] - mean[1]).max() < 12.0


def test_negative_scales_read_right() -> None:
    """All marks are green: a red cross is what is seen where the wrong side is culled."""
    frame, _, _ = frame_of("NegativeScaleTest")
    red, green, blue = np.moveaxis(frame.color.astype(np.float64), -1, 0)
    assert np.count_nonzero((green > 1.5 * red) & (green > 1.5 * blue) & (green > 60)) > 1_500
    assert np.count_nonzero((red > 1.5 * green) & (red > 1.5 * blue) & (red > 60)) == 0


def test_alpha_modes_read_right() -> None:
    """Each pane has holes where its alpha is below its cutoff, and only there; the opaque one has none."""
    frame, placed, view = frame_of("AlphaBlendModeTest", (0.05, 0.05, 1.0))
    checked = 0
    for part, pose, node in placed:
        material = node.material
        texture = material.base_color_texture
        if texture is None or texture.image.pixels.shape[2] != 4 or material.alpha_mode == "blend":
            continue
        struck = Struck([(part, pose, node)], view, np.ones(frame.depth.shape, bool))
        own, corners, weights = struck.of(0)
        own, corners, weights = (a[weights.min(axis=1) > 0.01] for a in (own, corners, weights))
        cutoff = material.alpha_cutoff
        # Where all of the surroundings are on one side of the cutoff.
        uv = blended(part.source.uvs[texture.uv_set], corners, weights)
        assert len(material.base_color) == 3
        alphas = texture.image.pixels[..., 3]
        least, most = (
            texels(replace(texture, image=f(alphas, 33, mode="nearest")), uv)[0][:, 0] / 255.0
            for f in (ndimage.minimum_filter, ndimage.maximum_filter)
        )
        opaque = material.alpha_mode == "opaque"
        there = (least >= cutoff) | opaque
        shown = frame.instance_id.reshape(-1)[own] == node.instance_id
        depth = frame.depth.reshape(-1)[own]
        free = (depth == 0) | (depth > 0.9999 * struck.distance[own]) | shown
        sure = free & (there | (most < cutoff))
        wrong = np.count_nonzero((there != shown)[sure])
        print(f"\n{part.name}: {material.alpha_mode}, {sure.sum():,} pixels, {wrong} wrong")
        if sure.sum() > 2_000:
            assert wrong <= 0.002 * sure.sum()
            # Holes and what is left are both there.
            assert opaque or (there[sure].any() and not there[sure].all())
            checked += 1
    assert checked >= 5
