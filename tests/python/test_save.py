"""Files of frames, read back with Pillow and OpenImageIO."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

import nanite_rs as nrs
from oracles import subjects
from oracles.camera import at

NOTHING = 0xFFFFFFFF
LENS = nrs.PerspectiveCamera(yfov=0.8, zfar=50.0)


def scene() -> nrs.Scene:
    out = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    for k in range(3):
        out.add(subjects.built("small sphere"), pose=at(1.2 * k - 1.2, 0.1 * k, -k))
    out.add(nrs.DirectionalLight(intensity=3.0))
    return out


@pytest.fixture(scope="module")
def frame() -> nrs.Frame:
    with nrs.Renderer(97, 61, backend="cpu") as renderer:
        return renderer.render(scene(), LENS, at(0.1, 0.2, 4), pixel_error=0.5)


def parts(path) -> list[oiio.ImageBuf]:
    first = oiio.ImageBuf(str(path))
    assert not first.has_error, first.geterror()
    return [oiio.ImageBuf(str(path), k, 0) for k in range(first.nsubimages)]


def channels(path) -> dict[str, np.ndarray]:
    """Every channel of every part, in the type in which it is stored."""
    found = {}
    for part in parts(path):
        spec = part.spec()
        pixels = part.get_pixels(spec.format)
        assert pixels.dtype == {"float": np.float32, "uint": np.uint32}[str(spec.format)]
        found |= {name: pixels[..., k] for k, name in enumerate(spec.channelnames)}
    return found


def texts(path) -> list[dict[str, str]]:
    return [{a.name: a.value for a in part.spec().extra_attribs} for part in parts(path)]


@pytest.mark.parametrize("view", [None, "shaded", "clusters", "overdraw"])
def test_a_png_is_the_view(frame, tmp_path, view):
    path = tmp_path / "frame.png"
    frame.save(path, view=view)
    shown = frame.view(view or "shaded")
    with Image.open(path) as image:
        assert image.mode == "RGB"
        np.testing.assert_array_equal(np.asarray(image), shown)
    np.testing.assert_array_equal(oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8), shown)


def test_an_exr_is_the_arrays_bit_for_bit(frame, tmp_path):
    path = tmp_path / "frame.exr"
    frame.save(path)
    found = channels(path)
    assert set(found) == {"R", "G", "B", "Z", "N.x", "N.y", "N.z", "instance_id", "cluster_id", "triangle_id"}
    np.testing.assert_array_equal(np.stack([found[channel] for channel in "RGB"], -1), frame.linear)
    np.testing.assert_array_equal(found["Z"], frame.depth)
    np.testing.assert_array_equal(np.stack([found[f"N.{axis}"] for axis in "xyz"], -1), frame.normal)
    empty = frame.depth == 0
    assert empty.any()
    assert not empty.all()
    for name in ("instance_id", "cluster_id", "triangle_id"):
        np.testing.assert_array_equal(found[name], getattr(frame, name).astype(np.uint32))
        assert (found[name][empty] == NOTHING).all()
        assert (found[name][~empty] != NOTHING).all()
    assert [part.spec().getattribute("oiio:subimagename") for part in parts(path)] == ["geometry", "ids"]


@pytest.mark.parametrize(
    ("outputs", "names"),
    [
        ("depth", {"Z"}),
        (["normal"], {"N.x", "N.y", "N.z"}),
        (("overdraw", "depth"), {"Z", "overdraw"}),
        (["cluster_id", "cluster_id"], {"cluster_id"}),
        (["color", "linear"], {"R", "G", "B"}),
    ],
)
def test_an_exr_has_what_was_asked_for(frame, tmp_path, outputs, names):
    path = tmp_path / "frame.EXR"
    frame.save(path, outputs=outputs)
    assert set(channels(path)) == names
    if "overdraw" in names:
        np.testing.assert_array_equal(channels(path)["overdraw"], frame.overdraw)


def test_depth_alone(tmp_path):
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frame = renderer.render(scene(), LENS, at(0, 0, 4), depth_only=True)
    frame.save(tmp_path / "depth.exr")
    found = channels(tmp_path / "depth.exr")
    assert set(found) == {"Z"}
    np.testing.assert_array_equal(found["Z"], frame.depth)
    assert frame.metadata["depth_only"] is True
    with pytest.raises(nrs.ArgumentError, match="no normal"):
        frame.save(tmp_path / "more.exr", outputs=["depth", "normal"])
    assert os.listdir(tmp_path) == ["depth.exr"]


def test_metadata_say_how_a_frame_was_made(frame):
    pose = at(0.1, 0.2, 4)
    made = frame.metadata
    assert made["software"] == f"nanite_rs {nrs.__version__}"
    assert (made["camera"], made["yfov"], made["znear"], made["zfar"]) == ("perspective", 0.8, 0.05, 50.0)
    assert "aspectRatio" not in made
    np.testing.assert_array_equal(made["pose"], pose)
    assert (made["pixel_error"], made["depth_only"], made["backend"]) == (0.5, False, "cpu")
    assert made["raster"] == "compute"
    assert made["triangles"] == frame.stats.triangles
    assert made["source_triangles"] == frame.stats.source_triangles


@pytest.mark.parametrize(
    ("lens", "kind"),
    [
        (nrs.IntrinsicsCamera(fx=50, fy=51.5, cx=32.0, cy=24.25), "intrinsics"),
        (nrs.OrthographicCamera(xmag=2.0, ymag=np.float64(0.1)), "orthographic"),
    ],
)
def test_metadata_of_each_view_are_its_own(lens, kind):
    poses = [at(0, 0, 4), at(0.3, 0, 4)]
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frames = renderer.render_views(scene(), [(LENS, poses[0]), (lens, poses[1])])
    poses[1][:] = 7.0
    assert [f.metadata["camera"] for f in frames] == ["perspective", kind]
    given = {k: v for k, v in vars(lens).items() if v is not None}
    assert {k: frames[1].metadata[k] for k in given} == given
    assert "zfar" not in frames[1].metadata
    np.testing.assert_array_equal(frames[1].metadata["pose"], at(0.3, 0, 4))


@pytest.mark.parametrize("name", ["frame.png", "frame.exr"])
def test_metadata_are_in_the_file(frame, tmp_path, name):
    frame.save(tmp_path / name)
    expected = {f"nanite_rs:{k}": v for k, v in frame.metadata.items() if k != "software"}
    for found in texts(tmp_path / name):
        assert found["Software"] == frame.metadata["software"]
        for key, value in expected.items():
            assert (found[key] if isinstance(value, str) else json.loads(found[key])) == value, key
    if name.endswith("png"):
        with Image.open(tmp_path / name) as image:
            assert image.text == {"Software": found["Software"], **{k: found[k] for k in expected}}


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_files_are_replaced_and_have_the_usual_permissions(frame, tmp_path, suffix):
    path, plain = tmp_path / f"frame.{suffix}", tmp_path / "plain"
    path.write_bytes(b"old")
    plain.touch()
    frame.save(str(path))
    with_oiio = oiio.ImageBuf(str(path))
    assert (with_oiio.spec().width, with_oiio.spec().height) == (97, 61)
    assert sorted(os.listdir(tmp_path)) == [path.name, "plain"]
    path.unlink()
    frame.save(path)
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_a_name_in_the_current_folder_and_unusual_letters(frame, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.png", "ä ü→.exr", "a.b.exr"):
        frame.save(name)
    assert sorted(os.listdir(".")) == sorted(["a.png", "ä ü→.exr", "a.b.exr"])
    np.testing.assert_array_equal(channels("ä ü→.exr")["Z"], frame.depth)


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("frame.jpg", {}, nrs.FormatError, r"frame\.jpg: extension \.jpg is unknown; .*\.png or \.exr"),
        ("frame", {}, nrs.FormatError, "frame: the name has no extension"),
        ("none/frame.png", {}, nrs.MissingFileError, "none/frame.png"),
        ("none/frame.exr", {}, nrs.MissingFileError, "none/frame.exr"),
        ("file/frame.exr", {}, nrs.FileError, "file/frame.exr"),
        ("folder.png", {}, nrs.FileError, "folder.png"),
        ("folder.exr", {}, nrs.FileError, "folder.exr"),
        ("frame.png", {"view": "nice"}, nrs.ArgumentError, "nice"),
        ("frame.png", {"outputs": ["depth"]}, nrs.ArgumentError, "outputs: a .png holds one picture"),
        ("frame.exr", {"view": "shaded"}, nrs.ArgumentError, "view: an .exr holds arrays"),
        (
            "frame.exr",
            {"outputs": ["levels"]},
            nrs.ArgumentError,
            "outputs: an .exr holds linear, .*'levels'",
        ),
        ("frame.exr", {"outputs": [7]}, nrs.ArgumentError, "outputs: .*not 7"),
        ("frame.exr", {"outputs": []}, nrs.ArgumentError, "outputs: expected one at least"),
    ],
)
def test_refusals_leave_nothing_behind(frame, tmp_path, name, options, error, message):
    (tmp_path / "file").touch()
    for folder in ("folder.png", "folder.exr"):
        (tmp_path / folder).mkdir()
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(error, match=message):
        frame.save(tmp_path / name, **options)
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit on the size of files")
@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_a_full_disk_leaves_the_old_file(tmp_path, suffix):
    path = tmp_path / f"frame.{suffix}"
    path.write_bytes(b"old")
    code = f"""
import resource, signal
import numpy as np
import nanite_rs as nrs
scene = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000), progress=False))
pose = np.eye(4)
pose[2, 3] = 3
frame = nrs.Renderer(200, 200, backend="cpu").render(scene, nrs.PerspectiveCamera(yfov=0.8), pose)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    frame.save({str(path)!r})
except nrs.FileError as error:
    print(error.filename)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == str(path), result.stderr
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == [path.name]


def test_without_openimageio(frame, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    with pytest.raises(nrs.DependencyError, match=r"OpenImageIO is needed; pip install OpenImageIO"):
        frame.save(tmp_path / "frame.exr")
    frame.save(tmp_path / "frame.png")
    assert os.listdir(tmp_path) == ["frame.png"]
