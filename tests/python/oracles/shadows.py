"""Scenes that cast shadows, and rays of Embree through their full source."""

from __future__ import annotations

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

import nanite_rs as nrs

from . import data, picture

SIZE = 320, 180
YFOV = 0.8
CAMERA = nrs.PerspectiveCamera(yfov=YFOV, znear=0.001)


def placed(x=0.0, y=0.0, z=0.0, scale=1.0, turn=0.0):
    pose = np.eye(4)
    pose[:3, :3] = scale * np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    pose[:3, 3] = x, y, z
    return pose


def floor(half=5.0, height=0.0):
    corners = half * np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], float)
    return corners + np.array([0, height, 0]), np.array([[0, 1, 2], [0, 2, 3]])


def box():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def sun(elevation, around=0.6):
    """A light from so many degrees above the horizon."""
    up = np.radians(elevation)
    way = np.array([np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)])
    return nrs.DirectionalLight(intensity=3.0), nrs.look_at(way, (0, 0, 0))


def ball():
    bumpy = nrs.shapes.displaced_icosphere(faces=200_000)
    meshes = [(bumpy, placed()), (floor(height=-1.1), placed()), (bumpy, placed(1.6, -0.6, 0.5, scale=0.4))]
    lights = [
        sun(45.0),
        (nrs.SpotLight(intensity=20.0, outerConeAngle=0.5), nrs.look_at((-3, 3, 1), (0, -1, 0))),
        (nrs.PointLight(intensity=8.0), placed(0.0, 1.5, 2.4)),
    ]
    return meshes, lights, nrs.look_at((2.5, 2, 5), (0, -0.3, 0))


def street():
    rng = np.random.default_rng(1)
    house = box()
    meshes = [(floor(200.0), placed())]
    for k in range(600):
        pose = placed(4.0 * (k % 30) - 58.0, 0.0, -4.0 * (k // 30), scale=1.0, turn=rng.uniform(-0.2, 0.2))
        pose[1, 1] = rng.uniform(0.5, 4.0)
        meshes.append((house, pose))
    return meshes, [sun(30.0), sun(4.0, around=1.9)], nrs.look_at((3, 12, 14), (0, 0, -20))


def terrain():
    land = nrs.shapes.terrain(faces=150_000)
    return [(land, placed(scale=30.0))], [sun(25.0), sun(8.0, around=2.4)], nrs.look_at((2, 9, 25), (0, 0, 0))


def sheets():
    u, v = np.meshgrid(np.linspace(-1, 1, 120), np.linspace(-1, 1, 120), indexing="ij")
    i = np.arange(119 * 120).reshape(119, 120)[:, :-1].ravel()
    faces = np.concatenate([np.stack([i, i + 120, i + 121], 1), np.stack([i, i + 121, i + 1], 1)])
    faces = faces[(faces[:, 0] % 7) > 1]  # strips, with slits between them
    cloth = np.stack([u, 0.15 * np.sin(5 * u) * np.cos(4 * v), v], -1).reshape(-1, 3), faces
    meshes = [
        (floor(6.0), placed()),
        *((cloth, placed(0.1 * k, 0.5 + 0.3 * k, 0.0, turn=0.3 * k)) for k in range(3)),
    ]
    return meshes, [sun(60.0), sun(35.0, around=-2.0)], nrs.look_at((1.5, 2.5, 4), (0, 0.6, 0))


def scan():
    mesh = data.scan("dragon")
    vertices, faces = mesh.vertices.astype(np.float64), mesh.faces
    vertices = (vertices - vertices.mean(axis=0)) / np.ptp(vertices, axis=0).max() * 2.0
    low = vertices[:, 1].min()
    meshes = [((vertices, faces), placed()), (floor(8.0, low), placed())]
    return meshes, [sun(40.0), sun(2.0)], nrs.look_at((1.6, 1.0, 2.6), (0, 0, 0))


def plates():
    """Occluders of one layer: a square and two balls above a floor."""
    square = floor(1.0)
    round_ = nrs.shapes.icosphere(faces=80_000)
    meshes = [
        (floor(8.0), placed()),
        (square, placed(y=2.0, turn=0.4)),
        (round_, placed(2.2, 1.2, -1.0, scale=0.6)),
        (round_, placed(-2.2, 0.5, 1.0, scale=0.5)),
    ]
    lights = [
        sun(50.0, around=-1.0),
        sun(20.0, around=2.2),
        (nrs.SpotLight(intensity=20.0, outerConeAngle=0.5), nrs.look_at((-3, 6, 1), (0, -1, 0))),
        (nrs.PointLight(intensity=8.0), placed(0.5, 4.0, 2.4)),
    ]
    return meshes, lights, nrs.look_at((2.5, 3.2, 4.6), (-0.2, 0.3, -0.4))


def on_floor(name, size=2.0, elevations=(40.0, 10.0)):
    """A real mesh on a floor, in low and in high light."""

    def make():
        mesh = data.scan(name) if "/" not in name else data.model(name)
        vertices, faces = mesh.vertices.astype(np.float64), mesh.faces
        vertices = (vertices - mesh.center) / np.ptp(mesh.used, axis=0).max() * size
        low = vertices[np.unique(faces), 1].min()
        meshes = [((vertices, faces), placed()), (floor(8.0, low), placed())]
        lights = [sun(elevation, around=2.2 - 3.4 * k) for k, elevation in enumerate(elevations)]
        return meshes, lights, nrs.look_at((1.6, 1.2, 2.6), (0, 0, 0))

    return make


def trees():
    """Many layers: trees of modelled leaves."""
    path = data.require("foliage", "quaternius_birch_solid", "OBJ", "BirchTree_4.obj")
    vertices, faces = data.load_arrays(path)
    vertices = vertices.astype(np.float64) * 3.0 / np.ptp(vertices, axis=0).max()
    vertices -= [vertices[:, 0].mean(), vertices[:, 1].min(), vertices[:, 2].mean()]
    tree = vertices, faces
    poses = [placed(-1.5), placed(1.0, 0.0, -1.2, turn=1.0), placed(0.2, 0.0, 1.5, scale=0.6, turn=2.0)]
    meshes = [(floor(9.0), placed()), *((tree, pose) for pose in poses)]
    return meshes, [sun(50.0, around=-1.0), sun(25.0, around=2.2)], nrs.look_at((3.0, 3.5, 6.0), (0, 0.8, 0))


def city():
    """Ten thousand houses."""
    rng = np.random.default_rng(2)
    house = box()
    meshes = [(floor(400.0), placed())]
    for k in range(10_000):
        pose = placed(6.0 * (k % 100) - 297.0, 0.0, 290.0 - 6.0 * (k // 100), turn=rng.uniform(-0.2, 0.2))
        pose[1, 1] = rng.uniform(0.5, 6.0)
        meshes.append((house, pose))
    return meshes, [sun(35.0), sun(12.0, around=1.9)], nrs.look_at((2, 40, 120), (0, 0, 40))


def horizon():
    """Land to the horizon, the sun 2° above it."""
    land = nrs.shapes.terrain(faces=400_000)
    return (
        [(land, placed(scale=2000.0))],
        [sun(20.0), sun(2.0, around=2.4)],
        nrs.look_at((2, 500, 1800), (0, 300, 0)),
    )


def sizes():
    """From a millimetre to ten kilometres: a pebble before the camera, a house, a mountain."""
    stone = nrs.shapes.displaced_icosphere(faces=40_000)
    # Rings about each other: a triangle of kilometres is rounded by millimetres, here and for rays.
    corners = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], float)
    sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    ring = (
        np.concatenate([corners, 0.25 * corners]),
        np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]),
    )
    meshes = [
        (floor(0.5), placed()),
        *((ring, placed(scale=0.5 * 4.0**k)) for k in range(1, 9)),
        (stone, placed(0.0, 0.0005, -0.02, scale=0.0005)),
        (stone, placed(0.012, 0.002, -0.04, scale=0.003)),
        (box(), placed(4.0, 0.0, -20.0, scale=2.0)),
        (stone, placed(3000.0, 0.0, -12_000.0, scale=5000.0)),
    ]
    return (
        meshes,
        [sun(30.0, around=2.0), sun(15.0, around=0.8)],
        nrs.look_at((0.0, 0.02, 0.03), (0, 0.004, -0.04)),
    )


SCENES = {"ball": ball, "street": street, "terrain": terrain, "sheets": sheets, "scan": scan}
"""Scenes of every run."""
MORE_SCENES = {
    "plates": plates,
    "trees": trees,
    "city": city,
    "horizon": horizon,
    "sizes": sizes,
    **{name: on_floor(name) for name in ("bunny", "armadillo", "lucy", "horse", "turbine", "mountain")},
    **{
        name: on_floor(f"cad/{name}")
        for name in ("ADIS16480", "counter_unitsmm", "voron_a_drive_frame_lower")
    },
    "nave": on_floor("cad/zdm2_level"),
    "gear": on_floor("cad/voron_hubbed_gear"),
}
"""Scenes of long runs besides."""


def scene_of(meshes, lights, smooth=True):
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    built: dict[int, nrs.NaniteMesh] = {}
    for arrays, pose in meshes:
        mesh = built.setdefault(id(arrays), nrs.NaniteMesh.from_arrays(*arrays))
        scene.add(mesh, pose=pose, material=nrs.Material(double_sided=True, smooth=smooth))
    for light, pose in lights:
        scene.add(light, pose=pose)
    return scene


class Rays:
    """The full source of a scene, for rays."""

    def __init__(self, meshes):
        corners = [(v @ pose[:3, :3].T + pose[:3, 3])[np.asarray(f)] for (v, f), pose in meshes]
        self.scene = rtcore_scene.EmbreeScene(robust=True)
        self.mesh = TriangleMesh(self.scene, np.concatenate(corners).astype(np.float32))

    def reach(self, points, light, pose):
        """Whether nothing is between points and a light."""
        if isinstance(light, nrs.DirectionalLight):
            way, far = np.broadcast_to(pose[:3, 2], points.shape), np.full(len(points), 1e30)
        else:
            way = pose[:3, 3] - points
            far = np.ones(len(points))
        return self._free(points, way, far)

    def share(self, points, light, pose, size, strata=16, seed=0):
        """How much of a light of a size is to be seen from points, by rays to ``strata²`` parts of it."""
        rng = np.random.default_rng(seed)
        sun = isinstance(light, nrs.DirectionalLight)
        center = np.broadcast_to(pose[:3, 2], points.shape) if sun else pose[:3, 3] - points
        across = np.cross(
            center, np.where(np.abs(center[:, :1]) > np.abs(center[:, 1:2]), [[0.0, 1, 0]], [[1.0, 0, 0]])
        )
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        up = np.cross(center, across)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        seen = np.zeros(len(points))
        far = np.full(len(points), 1e30 if sun else 1.0)
        for part in range(strata**2):
            u, v = (np.array([[part // strata], [part % strata]]) + rng.random((2, len(points)))) / strata
            x, y = (size * np.sqrt(u) * f(2 * np.pi * v) for f in (np.cos, np.sin))
            seen += self._free(points, center + x[:, None] * across + y[:, None] * up, far)
        return seen / strata**2

    def _free(self, points, way, far):
        hit = self.scene.run(
            np.ascontiguousarray(points, np.float32),
            np.ascontiguousarray(way, np.float32),
            far.astype(np.float32),
        )
        return np.asarray(hit) == -1


def lit_by_pyrender(meshes, place, pose):
    """Which pixels a directional light of pyrender reaches, past the shadows that it draws."""
    pyrender = picture.import_pyrender()
    scene = pyrender.Scene(ambient_light=(0.0, 0.0, 0.0), bg_color=(0.0, 0.0, 0.0, 0.0))
    for (vertices, faces), placing in meshes:
        corners = np.asarray(vertices, np.float32)[np.asarray(faces)]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-30)
        primitive = pyrender.Primitive(
            positions=corners.reshape(-1, 3),
            normals=np.repeat(normal, 3, axis=0),
            material=pyrender.MetallicRoughnessMaterial(doubleSided=True, metallicFactor=0.0),
        )
        scene.add(pyrender.Mesh([primitive]), pose=placing)
    scene.add(pyrender.DirectionalLight(color=np.ones(3), intensity=50.0), pose=place)
    scene.add(pyrender.PerspectiveCamera(yfov=YFOV, znear=0.05), pose=pose)
    renderer = pyrender.OffscreenRenderer(*SIZE)
    try:
        color, _ = renderer.render(scene, flags=pyrender.RenderFlags.SHADOWS_DIRECTIONAL)
    finally:
        renderer.delete()
    return color.max(axis=-1) > 8


def points_of(frame, pose):
    """World positions of pixels, and the size of a pixel there."""
    depth = frame.depth.astype(np.float64)
    high, wide = depth.shape
    focal = 0.5 * high / np.tan(0.5 * YFOV)
    y, x = np.mgrid[:high, :wide] + 0.5
    local = np.stack([(x - wide / 2) / focal * depth, (high / 2 - y) / focal * depth, -depth], -1)
    return local @ pose[:3, :3].T + pose[:3, 3], depth / focal
