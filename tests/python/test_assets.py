"""Textured scenes as users have them: beside pyrender, and read right by what test models were designed to show.

Each asset is drawn by pyrender on OSMesa and by the CPU backend with ``shading="pyrender"``, at full detail and at one
pixel of error, and with ``shading="gltf"``. Contact sheets of all four and of the difference go to
``target/contact-sheets/`` to be looked at.

What pyrender cannot do is left out on both sides: transparency and masks are opaque, emission is given as its square
root, since pyrender squares it, and parts that a node mirrors are double-sided, since pyrender culls their front.
"""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from nanite_rs.assets import read_asset
from oracles import camera, compare, data, picture

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


def comparable(material: nrs.Material, *, mirrored: bool) -> nrs.Material:
    """The same without what pyrender cannot do; textures without anisotropy, as it has them."""
    textures = {
        slot: replace(texture, anisotropy=1)
        for slot in PYRENDER
        if (texture := getattr(material, slot)) is not None
    }
    return replace(
        material,
        alpha_mode="opaque",
        double_sided=material.double_sided or mirrored,
        normal_scale=1.0,
        occlusion_strength=1.0,
        **textures,
    )


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
        self.materials = {}
        self.theirs = self.pyrender.Scene(ambient_light=AMBIENT, bg_color=(0.0, 0.0, 0.0, 0.0))
        self.textures: dict[tuple, object] = {}
        points = []
        nodes = {name: iter(own) for name, own in self.loaded.instances.items()}
        primitives: dict[tuple, object] = {}
        for name, number, pose in asset.placed:
            mirrored = bool(np.linalg.det(pose[:3, :3]) < 0.0)
            for part in asset.meshes[number]:
                points.append(part.source.vertices[np.unique(part.source.faces)] @ pose[:3, :3].T + pose[:3, 3])
                node = next(nodes[name])
                self.materials[node] = node.material, comparable(node.material, mirrored=mirrored)
                key = id(part), mirrored
                if key not in primitives:
                    primitives[key] = self.pyrender.Mesh([self.primitive(part.source, self.materials[node][1])])
                self.theirs.add(primitives[key], pose=pose)
        scene = self.loaded.scene
        for light in self.loaded.lights:
            light.remove()
        scene.ambient_light, scene.bg_color = AMBIENT, (0.0, 0.0, 0.0)
        self.view = camera.framing(np.concatenate(points), case.direction, width=WIDTH, height=HEIGHT)
        self.light()
        lens = nrs.PerspectiveCamera(yfov=self.view.yfov, znear=self.view.znear)
        eye = self.pyrender.PerspectiveCamera(yfov=self.view.yfov, znear=self.view.znear)
        self.theirs.add(eye, pose=self.view.pose)
        color, self.depth = picture._offscreen(WIDTH, HEIGHT).render(self.theirs)
        self.color = np.array(color[..., :3])
        with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
            draw = functools.partial(renderer.render, scene, lens, self.view.pose)
            self.gltf = draw(pixel_error=1.0, shading="gltf", transfer="srgb")
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
            self.theirs.add(getattr(self.pyrender, kind)(color=np.array(color), intensity=strength), pose=pose)

    def primitive(self, source, material: nrs.Material):
        """The same surface for pyrender: faces that are flat have vertices of their own."""
        faces = np.asarray(source.faces)
        arrays = {
            "positions": source.vertices,
            "normals": source.normals,
            "texcoord_0": source.uvs[0] if source.uvs else None,
            "color_0": None if source.colors is None or (source.colors == 255).all() else source.colors / 255.0,
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
            emissiveFactor=np.sqrt(np.asarray(material.emissive, np.float64)),
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
    inside, all_of_it = (compare.psnr(shots.full.color, shots.color, where) for where in (shots.inside, shots.both))
    other = np.count_nonzero((shots.full.depth > 0) ^ (shots.depth > 0)) / np.count_nonzero(shots.depth > 0)
    print(f"\n{shots.name}: {inside:.2f} dB away from silhouettes, {all_of_it:.2f} dB over all; {other:.2e} uncovered")
    assert shots.inside.sum() > 0.3 * shots.both.sum()
    assert other < 2e-3
    assert inside >= shots.case.psnr


def test_a_pixel_of_error_cannot_be_seen(shots: Shots) -> None:
    pytest.importorskip("OpenImageIO")
    full = nrs.compare(shots.full.color, shots.color).flip
    cut = nrs.compare(shots.cut.color, shots.color).flip
    print(f"\n{shots.name}: FLIP {full:.4f} at full detail, {cut:.4f} at one pixel of error")
    assert cut <= shots.case.flip
