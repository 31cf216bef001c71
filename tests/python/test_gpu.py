"""The GPU backend: the same arrays as the CPU, and clear words where there is no device."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import adapters, subjects
from oracles.camera import at

SIZE = 320, 180
LENS = nrs.PerspectiveCamera(yfov=0.8)
LENSES = {
    "perspective": LENS,
    "wide, with a far plane": nrs.PerspectiveCamera(yfov=1.8, znear=0.5, zfar=9.0, aspectRatio=2.2),
    "intrinsics": nrs.IntrinsicsCamera(fx=250.0, fy=270.0, cx=140.0, cy=110.5),
    "intrinsics, far off the centre": nrs.IntrinsicsCamera(fx=200.0, fy=220.0, cx=10.0, cy=190.0, zfar=50.0),
    "parallel": nrs.OrthographicCamera(xmag=3.2, ymag=1.8),
    "parallel, with a far plane": nrs.OrthographicCamera(xmag=1.0, ymag=2.5, znear=3.0, zfar=6.5),
}
VIEWS = ("shaded", "triangles", "clusters", "groups", "levels", "rasterizers", "overdraw")
ARRAYS = ("color", "depth", "normal", "instance_id", "cluster_id", "triangle_id", "face_id", "overdraw")


@pytest.fixture(scope="module")
def device():
    try:
        renderer = nrs.Renderer(*SIZE, backend="gpu")
    except nrs.BackendError as error:
        pytest.skip(str(error))
    with renderer:
        yield renderer


def scene() -> nrs.Scene:
    out = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0, 0, 0.5))
    out.add(nrs.DirectionalLight(intensity=3.0), pose=np.eye(4))
    mesh = subjects.built("small sphere")
    looks = nrs.Material(base_color=(0.9, 0.3, 0.2)), nrs.Material(double_sided=True, smooth=False)
    for k in range(9):
        out.add(mesh, pose=at(1.5 * (k % 3) - 1.5, 1.5 * (k // 3) - 1.5, -k), material=looks[k % 2])
    return out


@pytest.mark.parametrize("pixel_error", [0.0, 1.0, 8.0])
@pytest.mark.parametrize(
    "eye", [at(0, 0, 4), at(0.2, 0.1, 1.2), at(30, 0, 60)], ids=["near", "inside", "far"]
)
def test_every_array_is_that_of_the_cpu(device, pixel_error, eye) -> None:
    shown = scene()
    frame = device.render(shown, LENS, eye, pixel_error=pixel_error, occlusion=False, raster="compute")
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        expected = renderer.render(shown, LENS, eye, pixel_error=pixel_error, occlusion=False)
    assert device.backend == "gpu"
    assert frame.stats.raster == expected.stats.raster == "compute"
    same(device, frame, expected)
    for stage in ("node_cull", "cluster_cull", "raster_small", "raster_large"):
        ours, theirs = frame.stats[stage], expected.stats[stage]
        assert (ours.received, ours.passed) == (theirs.received, theirs.passed), stage
        assert ours.ms >= 0.0
    assert 0.0 < sum(s.ms for s in frame.stats.stages) < frame.stats.total_ms
    assert frame.stats.covered_pixels == expected.stats.covered_pixels


def same(
    device: nrs.Renderer, frame: nrs.Frame, expected: nrs.Frame, arrays: tuple[str, ...] = ARRAYS
) -> None:
    for name in arrays:
        ours, theirs = getattr(frame, name), getattr(expected, name)
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        if name == "color":
            adapters.same_colors(device, ours, theirs)
        elif name == "normal":
            adapters.same_normals(device, ours, theirs)
        else:
            np.testing.assert_array_equal(ours, theirs, err_msg=name)


@pytest.mark.parametrize("occlusion", [False, True], ids=["whole", "occlusion"])
@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_every_projection_is_that_of_the_cpu(device, lens, occlusion) -> None:
    shown = scene()
    # Which clusters are drawn, and with them how often a pixel is, may differ where something is hidden.
    arrays = ARRAYS[:-1] if occlusion else ARRAYS
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for eye in (at(0.3, -0.2, 3.0), at(0.3, -0.2, 3.1), at(-1.0, 0.4, 0.2)):
            frame = device.render(shown, lens, eye, occlusion=occlusion)
            expected = renderer.render(shown, lens, eye, occlusion=occlusion)
            assert frame.stats.covered_pixels > 500
            same(device, frame, expected, arrays)


def test_every_view_is_that_of_the_cpu_and_outputs_come_when_asked_for(device) -> None:
    shown = scene()
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        expected = renderer.render(shown, LENS, at(0, 0, 3), occlusion=False)
    frames = [
        device.render(shown, LENS, at(0, 0, 3), occlusion=False, outputs=outputs)
        for outputs in ((), "depth", ("color", "depth"))
    ]
    # Frames stay as they are while the renderer goes on.
    device.render(nrs.Scene(), LENS, at(0, 0, 3))
    for frame in frames:
        same(device, frame, expected)
        for view in VIEWS:
            adapters.same_colors(device, frame.view(view), expected.view(view), view)


def test_a_scene_is_followed_through_its_changes(device) -> None:
    shown = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    light = shown.add(nrs.PointLight(intensity=40.0), pose=at(2, 2, 3))
    first, second = subjects.built("small sphere"), subjects.built("cube")
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:

        def check() -> int:
            frame = device.render(shown, LENS, at(0, 0, 6), pixel_error=0.5)
            same(device, frame, renderer.render(shown, LENS, at(0, 0, 6), pixel_error=0.5), ARRAYS[:-1])
            return frame.stats.covered_pixels

        assert check() == 0
        node = shown.add(first)
        alone = check()
        other = shown.add(second, pose=at(2.5), material=nrs.Material(base_color=(0.1, 0.8, 0.2)))
        assert check() > alone > 0
        node.pose = at(-2.0, 0.5, -1.0) @ np.diag((-1.0, 0.5, 2.0, 1.0))
        check()
        light.pose = at(-3, 0, 4)
        other.material = nrs.Material(base_color=(0.9, 0.1, 0.1), double_sided=True, smooth=False)
        check()
        other.visible = False
        moved = check()
        node.remove()
        assert check() == 0 < moved
        other.visible = True
        assert check() > 0


def test_what_a_mesh_carries_is_shaded_as_on_the_cpu(device) -> None:
    """Colours and normals of its own, and coordinates that float32 does not hold."""
    vertices, faces = subjects.subject("small sphere").vertices, subjects.subject("small sphere").faces
    origin = np.array([4.0e6, -1.5e6, 250.25])
    colors = np.clip(0.5 + 0.5 * vertices, 0.0, 1.0)
    mesh = nrs.NaniteMesh.from_arrays(
        vertices.astype(np.float64) + origin,
        faces,
        normals=-np.asarray(vertices),
        colors=colors,
        progress=False,
    )
    shown = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
    shown.add(nrs.DirectionalLight(intensity=2.0), pose=np.eye(4))
    shown.add(mesh)
    eye = at(*origin) @ at(0.1, 0.2, 4.0)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        expected = renderer.render(shown, LENS, eye, pixel_error=0.5)
    assert expected.stats.covered_pixels > 1000
    same(device, device.render(shown, LENS, eye, pixel_error=0.5), expected, ARRAYS[:-1])


def test_several_views_are_as_alone(device) -> None:
    shown = scene()
    views = [
        (LENS, at(0, 0, 4)),
        (nrs.OrthographicCamera(xmag=3.0, ymag=2.0), at(0.2, 0.1, 5)),
        (LENS, at(30, 0, 60)),
    ]
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for one in (device, renderer):
            frames = one.render_views(shown, iter(views), occlusion=False, raster="compute")
            for frame, (camera, pose) in zip(frames, views, strict=True):
                expected = renderer.render(shown, camera, pose, occlusion=False)
                same(device, frame, expected)
            assert one.render_views(shown, []) == []


def test_a_view_has_a_size_threshold_and_kind_of_its_own(device) -> None:
    shown = scene()
    views = [
        (LENS, at(0, 0, 4)),
        nrs.View(LENS, at(0.2, 0.1, 5), id=9, size=(48, 48), depth_only=True),
        nrs.View(LENS, at(0, 0, 4), id=5, pixel_error=8.0, outputs=["instance_id"]),
    ]
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for one in (device, renderer):
            for order in ((0, 1, 2), (2, 1, 0)):
                frames = one.render_views(shown, [views[k] for k in order])
                whole, depth, coarse = (frames[order.index(k)] for k in range(3))
                same(device, whole, renderer.render(shown, LENS, at(0, 0, 4)))
                assert depth.depth.shape == (48, 48)
                assert (depth.depth > 0).any()
                with pytest.raises(nrs.ArgumentError, match="depth_only: the frame has depth alone"):
                    _ = depth.color
                assert coarse.stats.triangles < whole.stats.triangles
                expected = renderer.render(shown, LENS, at(0, 0, 4), pixel_error=8.0)
                assert (coarse.instance_id == expected.instance_id).all()
        for view, message in (
            (nrs.View(LENS, at(0, 0, 4), size=(0, 4)), "width: must be between 1 and"),
            (nrs.View(LENS, at(0, 0, 4), id=-1), r"views\[1\]: id: must be between 0"),
            (nrs.View(LENS, at(0, 0, 4), id=0), "views: two of them have the id 0"),
            (nrs.View(LENS, at(0, 0, 4), pixel_error=-1.0), "pixel_error: must be finite and not negative"),
            (nrs.View(LENS, at(0, 0, 4), outputs=["colour"]), "output"),
        ):
            with pytest.raises(nrs.ArgumentError, match=message):
                renderer.render_views(shown, [views[0], view])
        with pytest.raises(TypeError, match=r"views\[1\]: size: expected a width and a height"):
            renderer.render_views(shown, [views[0], nrs.View(LENS, at(0, 0, 4), size=48)])


def test_the_view_at_fault_is_named(device) -> None:
    shown = scene()
    with pytest.raises(TypeError, match=r"views\[1\]: expected a View, or a camera and a pose"):
        device.render_views(shown, [(LENS, at(0, 0, 4)), LENS])
    with pytest.raises(nrs.ArgumentError, match=r"views\[1\]: pose: "):
        device.render_views(shown, [(LENS, at(0, 0, 4)), (LENS, np.diag((2.0, 1, 1, 1)))])


def wall_before_a_crowd() -> nrs.Scene:
    out = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    out.add(nrs.DirectionalLight(intensity=3.0), pose=np.eye(4))
    mesh = subjects.built("small sphere")
    out.add(mesh, pose=at(0, 0, 1) @ np.diag((1.6, 1.6, 0.2, 1)))
    for k in range(60):
        out.add(mesh, pose=at(0.4 * (k % 10) - 1.8, 0.5 * (k // 10) - 1.3, -3) @ np.diag((0.3, 0.3, 0.3, 1)))
    return out


def test_what_is_hidden_is_left_out_of_the_lists_and_not_of_the_picture(device) -> None:
    shown = wall_before_a_crowd()
    eyes = [at(0, 0, 4), at(0, 0, 4), at(0.5, 0.1, 4), at(3, 0, 4), at(0, 0, 4)]
    whole = nrs.Renderer(*SIZE, backend="gpu")
    saved = 0
    for eye in eyes:
        frame = device.render(shown, LENS, eye, pixel_error=0.0, raster="compute")
        expected = whole.render(shown, LENS, eye, pixel_error=0.0, occlusion=False, raster="compute")
        same(device, frame, expected, ARRAYS[:-1])
        saved += expected.stats.clusters - frame.stats.clusters
    assert saved > 0
    assert {s.pass_number for s in frame.stats.stages if s.stage == "hzb"} == {1, 2}


@pytest.mark.parametrize("raster", ["hybrid", "hardware"])
@pytest.mark.parametrize("eye", [at(0, 0, 4), at(0.2, 0.1, 1.2)], ids=["near", "inside"])
def test_the_rasterizer_of_the_device_covers_the_same_pixels(device, raster, eye) -> None:
    shown = scene()
    expected = device.render(shown, LENS, eye, pixel_error=0.0, raster="compute")
    device.render(shown, LENS, eye, raster="measured")
    if raster not in device.calibration.times_ms:
        pytest.skip(device.calibration.reason)
    frame = device.render(shown, LENS, eye, pixel_error=0.0, raster=raster)
    assert frame.stats.raster == raster
    np.testing.assert_array_equal(frame.depth > 0, expected.depth > 0)
    same = np.ones(frame.depth.shape, bool)
    for name in ("instance_id", "cluster_id", "triangle_id"):
        same &= getattr(frame, name) == getattr(expected, name)
    assert (~same).mean() <= 0.0005
    np.testing.assert_allclose(frame.depth[same], expected.depth[same], rtol=1e-6)
    assert raster in str(frame.stats)


def test_the_fastest_raster_is_measured_once_and_reported(device) -> None:
    assert device.render(scene(), LENS, at(0, 0, 4)).stats.raster == "compute"
    frame = device.render(scene(), LENS, at(0, 0, 4), raster="measured")
    found = device.calibration
    assert found is not None
    assert frame.stats.raster == found.raster
    assert found.reason
    assert all(ms > 0.0 for ms in found.times_ms.values())
    if "llvmpipe" in device.backend_reason:
        assert set(found.times_ms) == {"compute", "hybrid", "hardware"}
    with nrs.Renderer(*SIZE, backend="gpu") as other:
        assert other.calibration == found
    with nrs.Renderer(*SIZE, backend="cpu") as cpu:
        assert cpu.render(scene(), LENS, at(0, 0, 4), raster="hardware").stats.raster == "compute"
        assert cpu.calibration is None
        with pytest.raises(
            nrs.ArgumentError, match='"auto", "compute", "hybrid", "hardware" or "measured", not "fast"'
        ):
            cpu.render(scene(), LENS, at(0, 0, 4), raster="fast")


def test_it_says_which_device_it_took(device) -> None:
    assert device.backend_reason.startswith("asked for: ")
    assert len(device.backend_reason) > len("asked for: ")
    with nrs.Renderer(8, 8) as renderer:
        assert renderer.backend in {"cpu", "gpu"}
        assert renderer.backend_reason


def test_what_does_not_fit_is_named(device) -> None:
    with nrs.Renderer(8192, 8192, backend="gpu") as renderer:
        try:
            frame = renderer.render(scene(), LENS, at(0, 0, 4), outputs=())
        except nrs.BackendError as error:
            assert "the pixels of the picture take 512 MiB" in str(error)  # noqa: PT017
        else:
            assert frame.stats.covered_pixels > 0
        # A frame that failed leaves the device usable.
    assert device.render(scene(), LENS, at(0, 0, 4)).stats.covered_pixels > 0


def python(code: str, **environment: str) -> str:
    """What a fresh interpreter prints."""
    variables = os.environ | environment
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="drivers are found by other means elsewhere")
def test_without_a_driver_gpu_raises_and_auto_takes_the_cpu() -> None:
    code = """
import nanite_rs as nrs
try:
    nrs.Renderer(8, 8, backend="gpu")
except nrs.BackendError as error:
    assert isinstance(error, RuntimeError)
    print(error)
renderer = nrs.Renderer(8, 8)
print(renderer.backend, renderer.backend_reason)
"""
    raised, automatic = python(code, VK_DRIVER_FILES="", VK_ICD_FILENAMES="").splitlines()
    assert "no Vulkan, Metal or DX12 adapter" in raised
    assert automatic.startswith("cpu ")
    assert "no Vulkan, Metal or DX12 adapter" in automatic


def test_a_device_can_be_taken_again_and_again(device) -> None:
    """A driver that is loaded anew each time is not found any more after a few dozen times (NVIDIA's 580)."""
    code = """
import nanite_rs as nrs
for _ in range(100):
    nrs.Renderer(8, 8, backend="gpu").close()
print("still there")
"""
    assert python(code).strip() == "still there"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_importing_and_rendering_on_the_cpu_load_no_driver() -> None:
    code = """
import nanite_rs as nrs, numpy as np
with nrs.Renderer(8, 8, backend="cpu") as renderer:
    renderer.render(nrs.Scene(), nrs.PerspectiveCamera(yfov=0.8), np.eye(4))
print([line for line in open("/proc/self/maps") if "vulkan" in line])
"""
    assert python(code).strip() == "[]"
