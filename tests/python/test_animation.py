"""Ways around things, and frames as files that other programs read back."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from PIL import Image

import nanite_rs as nrs
from oracles import camera as oracle
from oracles import subjects

BALL = [[-1.0, -1, -1], [1, 1, 1]]


def pictures(count: int = 6, height: int = 48, width: int = 64) -> list[np.ndarray]:
    """A bright bar that moves to the right over a blue ground."""
    made = []
    for k in range(count):
        picture = np.full((height, width, 3), (20, 40, 120), np.uint8)
        picture[:, 10 * k : 10 * k + 10] = (230, 200, 40)
        made.append(picture)
    return made


# ---------------------------------------------------------------------------------------------------- poses


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 2), (1, 1, 0)])
def test_look_at_is_that_of_the_oracle(up) -> None:
    for eye, target in (((1, 2, 3), (0, 0, 0)), ((-4, 0.5, 2), (3, -1, 7))):
        pose = nrs.look_at(eye, target, up)
        np.testing.assert_allclose(pose, oracle.look_at(np.array(eye), np.array(target), up), atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(pose) == pytest.approx(1)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (0, 0, -1), (1, -2, 0.5)])
@pytest.mark.parametrize("elevation", [-0.7, 0.0, 1.2])
def test_an_orbit_is_a_circle_that_looks_inward(up, elevation) -> None:
    box = np.array([[1.0, 2, 3], [2, 4, 9]])
    middle, axis = box.mean(axis=0), np.array(up) / np.linalg.norm(up)
    poses = nrs.orbit(box, 7, elevation=elevation, up=up, azimuth=0.3)
    eyes = np.array([pose[:3, 3] for pose in poses]) - middle
    away = np.linalg.norm(eyes, axis=1)
    np.testing.assert_allclose(away, away[0])
    np.testing.assert_allclose(eyes @ axis, away[0] * np.sin(elevation), atol=1e-12)
    for pose, eye in zip(poses, eyes, strict=True):
        np.testing.assert_allclose(pose[:3, 2], eye / away[0], atol=1e-12)
        assert pose[:3, 1] @ axis > 0
        assert pose[:3, 0] @ axis == pytest.approx(0, abs=1e-12)
    # Counter-clockwise from above, in equal steps, and closed.
    level = eyes - np.outer(eyes @ axis, axis)
    following = np.roll(level, -1, axis=0)
    across, along = np.cross(level, following) @ axis, (level * following).sum(axis=1)
    np.testing.assert_allclose(np.arctan2(across, along), 2 * np.pi / 7)


def test_the_sphere_about_the_box_fits_the_picture() -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    ball = mesh.bounds * [[1], [1]] / np.sqrt(3)  # of which the mesh is the sphere
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    with nrs.Renderer(120, 100, backend="cpu") as renderer:
        for distance in (1.0, 1.25):
            (pose,) = nrs.orbit(ball, 1, yfov=0.6, distance=distance)
            shown = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.6), pose).depth > 0
            rows = np.flatnonzero(shown.any(axis=1))
            reach = np.arcsin(np.sin(0.3) / distance)
            assert len(rows) == pytest.approx(100 * np.tan(reach) / np.tan(0.3), abs=2.5)


def test_what_has_bounds_can_be_gone_round() -> None:
    mesh = subjects.built("small sphere")
    expected = nrs.orbit(mesh.bounds, 3)
    for around in (mesh, mesh.cut(error=0.0).to_trimesh()):
        np.testing.assert_allclose(nrs.orbit(around, 3), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("eye: is at target", lambda: nrs.look_at((1, 2, 3), (1, 2, 3))),
        ("eye: expected three finite", lambda: nrs.look_at((1, 2), (1, 2, 3))),
        ("target: expected three finite", lambda: nrs.look_at((1, 2, 3), (1, np.nan, 3))),
        ("up: .* along the line of sight", lambda: nrs.look_at((0, 2, 0), (0, 0, 0))),
        ("around: expected a mesh", lambda: nrs.orbit(np.zeros(3), 3)),
        ("around: expected a mesh", lambda: nrs.orbit(BALL[::-1], 3)),
        ("count: must be 1 or more", lambda: nrs.orbit(BALL, 0)),
        (r"yfov: .*np\.radians\(45\)", lambda: nrs.orbit(BALL, 3, yfov=45)),
        ("elevation: .* radians", lambda: nrs.orbit(BALL, 3, elevation=20)),
        ("azimuth: must be finite", lambda: nrs.orbit(BALL, 3, azimuth=np.inf)),
        ("distance: must be positive", lambda: nrs.orbit(BALL, 3, distance=0)),
        ("distance: .* more than a point", lambda: nrs.orbit(np.zeros((2, 3)), 3)),
        ("up: expected a direction", lambda: nrs.orbit(BALL, 3, up=(0, 0, 0))),
        ("frames: expected one", lambda: nrs.save_animation("x.gif", [])),
        (r"frames\[0\]: expected shape", lambda: nrs.save_animation("x.gif", [np.zeros((2, 2), np.uint8)])),
        (r"frames\[1\]: of shape", lambda: nrs.save_animation("x.gif", [pictures()[0], pictures(1, 8)[0]])),
        ("fps: must be above 0", lambda: nrs.save_animation("x.gif", pictures(), fps=0)),
    ],
)
def test_values_out_of_range_are_refused(message, call, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(nrs.ArgumentError, match=f"^{message}"):
        call()
    assert not list(tmp_path.iterdir())


def test_other_types_are_refused(tmp_path) -> None:
    with pytest.raises(nrs.DtypeError, match=r"^eye: expected three numbers"):
        nrs.look_at("abc", (0, 0, 0))
    with pytest.raises(nrs.DtypeError, match=r"^count: expected an integer"):
        nrs.orbit(BALL, 3.0)
    with pytest.raises(nrs.DtypeError, match=r"^frames\[0\]: .* not float64"):
        nrs.save_animation(tmp_path / "x.gif", [np.zeros((2, 2, 3))])
    with pytest.raises(nrs.DtypeError, match=r"^fps: expected a number, not str"):
        nrs.save_animation(tmp_path / "x.gif", pictures(), fps="25")


# ---------------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize(("ending", "tolerance"), [("gif", 3), ("webp", 25)])
def test_pillow_reads_back_what_was_written(ending, tolerance, tmp_path) -> None:
    path = tmp_path / f"bar.{ending.upper()}"
    nrs.save_animation(path, iter(pictures()), fps=12.5)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with Image.open(path) as image:
        assert (image.format, image.n_frames, image.info["loop"]) == (ending.upper(), 6, 0)
        for k, picture in enumerate(pictures()):
            image.seek(k)
            image.load()
            assert image.info["duration"] == 80
            off = np.abs(np.asarray(image.convert("RGB")).astype(int) - picture)
            assert np.percentile(off, 95) <= tolerance


def test_frames_are_their_colours(tmp_path) -> None:
    scene = nrs.Scene(ambient_light=(0.4, 0.4, 0.4))
    scene.add(subjects.built("small sphere"))
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frames = [
            renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), pose)
            for pose in nrs.orbit(BALL, 3, yfov=0.8, distance=0.7)
        ]
    nrs.save_animation(tmp_path / "frames.webp", frames)
    nrs.save_animation(tmp_path / "arrays.webp", [frame.color for frame in frames])
    assert (tmp_path / "frames.webp").read_bytes() == (tmp_path / "arrays.webp").read_bytes()


@pytest.mark.parametrize("size", [(48, 64), (47, 63)])
def test_a_video_has_the_pictures(size, tmp_path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "bar.mp4"
    made = pictures(6, *size)
    nrs.save_animation(path, iter(made), fps=12.5)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        assert (stream.height, stream.width, float(stream.average_rate)) == (48, 64, 12.5)
        assert stream.codec_context.name == "h264"
        found = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(found) == 6
    for picture, read in zip(made, found, strict=True):
        off = np.abs(read[: size[0], : size[1]].astype(int) - picture)
        # Colours have half the resolution.
        assert np.percentile(off, 80) <= 12
        assert np.array_equal(
            read[..., 0] > 125, np.pad(picture, [(0, n % 2) for n in size] + [(0, 0)], "edge")[..., 0] > 125
        )


def test_without_pyav_the_error_says_what_to_do(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(nrs.DependencyError, match=r"pip install av, or save a \.gif") as error:
        nrs.save_animation(tmp_path / "x.mp4", pictures())
    assert error.value.name == "av"
    assert not list(tmp_path.iterdir())


def test_files_that_cannot_be(tmp_path) -> None:
    for name, found in (("x.avi", r"\.avi"), ("x", "without ending")):
        with pytest.raises(nrs.FormatError, match=rf"\.gif, \.webp or \.mp4, not {found}"):
            nrs.save_animation(tmp_path / name, pictures())
    with pytest.raises(nrs.MissingFileError):
        nrs.save_animation(tmp_path / "absent" / "x.gif", pictures())


def test_a_failure_half_way_leaves_what_was_there(tmp_path) -> None:
    pytest.importorskip("av")
    for ending in ("gif", "webp", "mp4"):
        path = tmp_path / f"x.{ending}"
        path.write_bytes(b"before")
        with pytest.raises(nrs.ArgumentError, match=r"frames\[2\]"):
            nrs.save_animation(path, [*pictures()[:2], pictures(1, 8)[0]])
        assert path.read_bytes() == b"before"
    assert len(list(tmp_path.iterdir())) == 3
