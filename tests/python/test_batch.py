"""Many small pictures in one call: each as it is alone, whoever draws it, in arrays of whoever gives them."""

from __future__ import annotations

import numpy as np
import pytest

import nanite_rs as nrs

RNG = np.random.default_rng(2)
SIZE = 48, 32
CAMERA = nrs.PerspectiveCamera(yfov=0.8)


def scenes(count):
    """Scenes of a few meshes each, that share them."""
    ball = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000), progress=False)
    knot = nrs.TriangleMesh(*nrs.shapes.torus_knot(faces=1_000))
    found = []
    for k in range(count):
        scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(k / count, 0.5, 0.5))
        for mesh in (ball, knot, ball):
            pose = np.eye(4)
            pose[:3, 3] = RNG.uniform(-1, 1, 3)
            scene.add(mesh, pose=pose)
        scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 2, 1), (0, 0, 0)))
        found.append(scene)
    return found


def items(count, of):
    poses = [nrs.look_at(np.add(RNG.uniform(-4, 4, 3), (0, 0, 6)), (0, 0, 0)) for _ in range(count)]
    return [(of[k * len(of) // count], CAMERA, pose) for k, pose in enumerate(poses)]


@pytest.mark.parametrize(
    "options", [{}, {"shadows": True, "samples": 4}, {"shading": "flat", "pixel_error": 3.0}]
)
def test_pictures_are_those_that_are_drawn_alone(backend, options):
    outputs = ["color", "depth", "instance_id", "normal"]
    batch = items(40 if backend == "cpu" else 8, scenes(5))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        arrays = renderer.render_batch(batch, outputs=outputs, **options)
        assert list(arrays) == outputs
        for number, (scene, camera, pose) in enumerate(batch):
            frame = renderer.render(scene, camera, pose, **options)
            for name in outputs:
                np.testing.assert_array_equal(arrays[name][number], getattr(frame, name))
    assert arrays["color"].shape == (len(batch), *SIZE[::-1], 3)


def test_arrays_may_be_given(tmp_path):
    batch = items(30, scenes(3))
    mapped = np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint8, (30, *SIZE[::-1], 3))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        expected = renderer.render_batch(batch)
        arrays = renderer.render_batch(iter(batch), out={"color": mapped})
        assert arrays["color"] is mapped
        np.testing.assert_array_equal(mapped, expected["color"])
        np.testing.assert_array_equal(arrays["depth"], expected["depth"])
        np.testing.assert_array_equal(np.from_dlpack(arrays["depth"]), expected["depth"])
        assert renderer.render_batch([]) == {}
        views = renderer.render_batch(batch[:2], outputs=["clusters"])
        np.testing.assert_array_equal(views["clusters"][1], renderer.render(*batch[1]).view("clusters"))
        for wrong, error, message in (
            (
                {"color": mapped[:-1]},
                nrs.ArgumentError,
                r"^out\['color'\]: expected uint8 of shape \(30, 32, 48, 3\)",
            ),
            ({"color": mapped.astype(np.float32)}, nrs.ArgumentError, r"^out\['color'\]: expected uint8"),
            ({"normal": mapped}, nrs.ArgumentError, r"^out\['normal'\]: outputs= does not name it"),
            ({"color": [1]}, nrs.DtypeError, r"^out\['color'\]: expected an array, not list"),
        ):
            with pytest.raises(error, match=message):
                renderer.render_batch(batch, out=wrong)
        fixed = expected["color"].copy()
        fixed.flags.writeable = False
        with pytest.raises(nrs.ArgumentError, match=r"^out\['color'\]: is read-only"):
            renderer.render_batch(batch, out={"color": fixed})


def test_mistakes_are_named():
    batch = items(6, scenes(1))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for place, wrong, error, message in (
            (3, batch[3][:2], nrs.DtypeError, r"^items\[3\]: expected a scene, a camera and a pose"),
            (
                2,
                (CAMERA, *batch[2][1:]),
                nrs.DtypeError,
                r"^items\[2\]: expected a Scene, not PerspectiveCamera",
            ),
            (1, (batch[1][0], None, batch[1][2]), nrs.DtypeError, r"^items\[1\]: expected a camera"),
            (5, (*batch[5][:2], 2 * np.eye(4)), nrs.ArgumentError, r"^items\[5\]: pose"),
        ):
            with pytest.raises(error, match=message):
                renderer.render_batch([*batch[:place], wrong, *batch[place + 1 :]])
        with pytest.raises(nrs.ArgumentError, match=r"colour"):
            renderer.render_batch(batch, outputs=["colour"])
        with pytest.raises(nrs.ArgumentError, match=r"^pixel_error"):
            renderer.render_batch(batch, pixel_error=-1.0)
    with pytest.raises(nrs.NaniteError, match="closed"):
        renderer.render_batch(batch)


def test_threads_do_not_matter():
    batch = items(50, scenes(4))
    found = []
    for threads in (1, 2, 5):
        with nrs.Renderer(*SIZE, backend="cpu", threads=threads) as renderer:
            found.append(renderer.render_batch(batch, shadows=True))
    for other in found[1:]:
        np.testing.assert_array_equal(other["color"], found[0]["color"])
        np.testing.assert_array_equal(other["depth"], found[0]["depth"])
