"""Textures in pictures: no seams between clusters, no sparkle at grazing angles, one picture on both backends."""

from __future__ import annotations

import numpy as np
import pytest

import nanite_rs as nrs

SIZE = (160, 90)
CAMERA = nrs.PerspectiveCamera(yfov=0.9, aspectRatio=SIZE[0] / SIZE[1])


def plane(columns: int, rows: int) -> nrs.NaniteMesh:
    """A floor from -4 to 4 across and 0 to -32 ahead, its UVs in metres."""
    x, z = (
        axis.ravel() for axis in np.meshgrid(np.linspace(-4, 4, columns + 1), np.linspace(0, -32, rows + 1))
    )
    at = np.arange(len(x)).reshape(rows + 1, columns + 1)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    uvs = np.stack([x, z], axis=1).astype(np.float32)
    return nrs.NaniteMesh.from_arrays(np.stack([x, 0 * x, z], axis=1), faces, uvs=[uvs])


def eye(ahead: float) -> np.ndarray:
    """Half a metre above the floor, looking along it and a little down."""
    s, c = np.sin(-0.12), np.cos(-0.12)
    return np.array([[1, 0, 0, 0.1], [0, c, -s, 0.5], [0, s, c, -ahead], [0, 0, 0, 1.0]])


def checker() -> np.ndarray:
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    return np.where((x // 4 + y // 4) % 2, 255, 20).astype(np.uint8)


def scene(mesh: nrs.NaniteMesh, pixels: np.ndarray, **options: object) -> nrs.Scene:
    out = nrs.Scene(ambient_light=(1.0, 1.0, 1.0))
    texture = nrs.Texture(nrs.Image(pixels), **options)
    out.add(mesh, material=nrs.Material(base_color=(0.8, 0.8, 0.8), base_color_texture=texture))
    return out


@pytest.mark.parametrize("shading", ["flat", "pyrender"])
def test_no_seams_show_between_clusters(shading) -> None:
    """A floor of a hundred clusters looks as one of two triangles: derivatives are those of the surface."""
    noise = np.random.default_rng(3).integers(0, 256, (256, 256, 3), np.uint8)
    pictures = []
    for mesh in (plane(1, 1), plane(64, 128)):
        with nrs.Renderer(*SIZE, backend="cpu") as renderer:
            options = {"pixel_error": 0.0, "shading": shading, "outputs": ["color", "cluster_id"]}
            frame = renderer.render(scene(mesh, noise), CAMERA, eye(0.0), **options)
        pictures.append(frame)
    one, many = pictures
    assert len(np.unique(many.cluster_id)) > 40
    off = np.abs(one.color.astype(int) - many.color.astype(int))
    print(f"largest difference {off.max()}, mean {off.mean():.4f}")
    assert off.max() <= 2


def test_nothing_sparkles_at_grazing_angles() -> None:
    """Along a path of 100 frames a pixel changes as one of sixteen samples does; without levels it would not."""
    mesh = plane(1, 1)

    def path(samples: int, **options: object) -> np.ndarray:
        shown = scene(mesh, checker(), **options)
        with nrs.Renderer(*SIZE, backend="cpu") as renderer:
            frames = [
                renderer.render(shown, CAMERA, eye(0.01 * step), samples=samples, shading="flat").linear[
                    ..., 0
                ]
                for step in range(100)
            ]
        # Below the horizon, with its edge left out.
        return np.stack(frames)[:, 40:]

    def change(frames: np.ndarray) -> float:
        return float(np.abs(np.diff(frames, axis=0)).mean())

    reference = path(16)
    smooth, rough = path(1), path(1, mipmaps=None)
    still, one, without = (change(frames) for frames in (reference, smooth, rough))
    print(
        f"change from frame to frame: {still:.4f} of 16 samples, {one:.4f} of one, {without:.4f} without levels"
    )
    # Trilinear filtering is not ideal: squares about as wide as a pixel flicker a little more than their mean does.
    assert one < 2.0 * still
    assert without > 5.0 * still
    # Where squares are less than a pixel wide next to nothing moves.
    assert change(smooth[:, :10]) < 0.02
    assert change(rough[:, :10]) > 0.3
    off = np.abs(smooth - reference).mean()
    assert off < 0.05, off


def test_textures_that_a_device_has_no_room_for_are_told_of_once() -> None:
    """Which images lose levels is a unit test in Rust; here what a frame says of it is made up."""

    class Said:
        def __init__(self, core: object, smaller: int) -> None:
            self.core, self.smaller = core, smaller

        def __getattr__(self, name: str) -> object:
            return getattr(self.core, name)

        def render(self, *args: object, **options: object) -> list[object]:
            return [Said(frame, self.smaller) for frame in self.core.render(*args, **options)]

        def totals(self) -> tuple:
            totals, *rest = self.core.totals()
            return [(name, self.smaller if name == "reduced_images" else n) for name, n in totals], *rest

    shown = scene(plane(1, 1), checker())
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        assert renderer.render(shown, CAMERA, eye(0.0)).stats.reduced_images == 0
        renderer._core = Said(renderer._core, 3)
        with pytest.warns(nrs.TextureWarning, match="3 of the images") as told:
            frames = [renderer.render(shown, CAMERA, eye(0.0)) for _ in range(2)]
        assert len(told) == 1
        assert frames[1].stats.reduced_images == 3
        renderer._core = renderer._core.core
