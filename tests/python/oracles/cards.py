"""Generated trees of cards, and what rays see of cards with holes: Embree's hits and SciPy's bilinear alpha."""

from __future__ import annotations

import functools

import numpy as np
from scipy.ndimage import map_coordinates

import nanite_rs as nrs
from oracles.rays import Rays

CUTOFF = 0.5
# Hits of one ray that are looked through.
_LAYERS = 64


@functools.cache
def leaves(count: int, size: int = 128, seed: int = 0) -> np.ndarray:
    """An image (size, size, 4) of elliptical leaves with smooth edges, nothing at its border."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[0:size, 0:size] + 0.5) / size
    alpha = np.zeros((size, size))
    for _ in range(count):
        turn, at = rng.uniform(0, np.pi), rng.uniform(0.22, 0.78, 2)
        along = np.cos(turn) * (x - at[0]) + np.sin(turn) * (y - at[1])
        across = -np.sin(turn) * (x - at[0]) + np.cos(turn) * (y - at[1])
        long = rng.uniform(0.5, 1.0) * min(0.2, 0.6 / np.sqrt(count))
        # About a texel from all to nothing.
        away = (1.0 - np.hypot(along / long, across / (0.45 * long))) * 0.45 * long * size
        alpha = np.maximum(alpha, np.clip(0.5 + away, 0.0, 1.0))
    image = np.empty((size, size, 4), np.uint8)
    image[..., :3] = rng.integers(40, 160, 3)
    image[..., 3] = np.rint(alpha * 255)
    return image


def leaf_material(image: np.ndarray, **options: object) -> nrs.Material:
    texture = nrs.Texture(image, mipmaps=None)
    given = {"alpha_mode": "mask", "double_sided": True, "name": "leaves", **options}
    return nrs.Material(base_color=(1, 1, 1), base_color_texture=texture, **given)


def card(columns: int, rows: int, bend: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square card of unit size, bent around its height by so many radians: positions, faces, UVs."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)))
    if bend:
        points = np.stack([np.sin((u - 0.5) * bend), v * bend, 1 - np.cos((u - 0.5) * bend)], axis=1) / bend
    else:
        points = np.stack([u - 0.5, v, np.zeros_like(u)], axis=1)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + columns + 2], axis=1),
            np.stack([first, first + columns + 2, first + columns + 1], axis=1),
        ]
    )
    return points, faces, np.stack([u, v], axis=1)


def tree(kind: str, cards: int = 24, seed: int = 0) -> dict:
    """A trunk of eight sides with ``"bent"`` cards, half of them mirrored, or flat ones of ``"many"`` leaves."""
    rng = np.random.default_rng(seed)
    around = np.arange(9) * np.pi / 4
    ring = np.stack([np.cos(around), np.zeros(9), np.sin(around)], axis=1) * 0.06
    points = [np.concatenate([ring, ring * 0.3 + [0, 2, 0]])]
    k = np.arange(8)
    faces = [np.concatenate([np.stack([k, k + 9, k + 1], axis=1), np.stack([k + 1, k + 9, k + 10], axis=1)])]
    uvs, count = [np.zeros((18, 2))], 18
    shape = card(6, 2, 1.6) if kind == "bent" else card(1, 1, 0.0)
    for number in range(cards):
        turn, lean = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 1.3)
        own, triangles, uv = shape
        if kind == "bent" and number % 2:
            uv = uv * [-1, 1] + [1, 0]
        tilt = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
        spin = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
        place = (own * rng.uniform(0.5, 0.8)) @ tilt.T @ spin.T + [0, rng.uniform(0.8, 1.9), 0]
        points.append(place)
        faces.append(triangles + count)
        uvs.append(uv)
        count += len(own)
    numbers = np.repeat([0, 1], [len(faces[0]), sum(map(len, faces[1:]))])
    return {
        "vertices": np.concatenate(points),
        "faces": np.concatenate(faces),
        "uvs": np.concatenate(uvs).astype(np.float32),
        "face_materials": numbers.astype(np.int32),
        "materials": (
            nrs.Material(base_color=(0.3, 0.2, 0.1), name="bark"),
            leaf_material(leaves(5 if kind == "bent" else 60, 128 if kind == "bent" else 256)),
        ),
    }


def seen(arrays: dict, origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether rays (N, 3) meet a surface anywhere, holes of masks left out."""
    vertices, faces = np.asarray(arrays["vertices"], np.float64), np.asarray(arrays["faces"])
    uvs = arrays["uvs"][0] if isinstance(arrays["uvs"], list | tuple) else arrays["uvs"]
    numbers, rays = np.asarray(arrays["face_materials"]), Rays(vertices, faces)
    found = np.zeros(len(origins), bool)
    at, open_ = np.array(origins, np.float64), np.arange(len(origins))
    step = 1e-5 * float(np.ptp(vertices, axis=0).max())
    for _ in range(_LAYERS):
        hit, away = rays.first(at[open_], np.broadcast_to(direction, (len(open_), 3)))
        rows = np.flatnonzero(hit >= 0)
        if not len(rows):
            return found
        point = at[open_[rows]] + away[rows, None] * direction
        solid = np.array(
            [
                _alpha(arrays["materials"], numbers[hit[k]], uvs, vertices, faces[hit[k]], p) >= CUTOFF
                for k, p in zip(rows, point, strict=True)
            ]
        )
        found[open_[rows[solid]]] = True
        at[open_[rows]] = point + step * direction
        open_ = open_[rows[~solid]]
    raise AssertionError("more layers than are looked through")


def _alpha(
    materials: tuple, number: int, uvs: np.ndarray, vertices: np.ndarray, face: np.ndarray, point: np.ndarray
) -> float:
    look = materials[number]
    if look.alpha_mode == "opaque":
        return 1.0
    a, b, c = vertices[face]
    shares = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)[0]
    u, v = (
        uvs[face[0]] + shares[0] * (uvs[face[1]] - uvs[face[0]]) + shares[1] * (uvs[face[2]] - uvs[face[0]])
    )
    return bilinear(look.base_color_texture.image.pixels[..., -1], np.array([[u, 1.0 - v]]))[0]


def bilinear(alpha: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Alpha, 0 to 1, of places (N, 2) in sides of an image, v down, that repeats."""
    height, width = alpha.shape
    rows, columns = places[:, 1] * height - 0.5, places[:, 0] * width - 0.5
    return map_coordinates(alpha / 255.0, [rows, columns], order=1, mode="grid-wrap")
