"""Files that are written anew: modes, symbolic links, and names that cannot be."""

import os
import stat
import sys

import numpy as np
import pytest

import nanite_rs as nrs

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="modes and links of POSIX")

FADING = [np.full((16, 16, 3), grey, np.uint8) for grey in (0, 100)]
MESH = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=500))


@pytest.fixture(scope="module")
def frame() -> nrs.Frame:
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(MESH)
    with nrs.Renderer(16, 16, backend="cpu") as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), nrs.look_at((0, 0, 4), (0, 0, 0)))


@pytest.fixture(params=["nanite", "png", "exr", "gif", "webp", "depth.png"])
def kind(request, frame):
    """A file's ending, and what writes it."""
    if request.param == "exr":
        pytest.importorskip("OpenImageIO")
    writers = {
        "nanite": MESH.save,
        "png": frame.save,
        "exr": frame.save,
        "gif": lambda path: nrs.save_animation(path, FADING),
        "webp": lambda path: nrs.save_animation(path, FADING),
        "depth.png": frame.save_depth,
    }
    return request.param, writers[request.param]


def mode(path) -> int:
    return stat.S_IMODE(os.stat(path).st_mode)


@pytest.mark.parametrize("umask", [0o022, 0o002, 0o077])
def test_new_files_have_what_the_umask_leaves(tmp_path, kind, umask) -> None:
    ending, write = kind
    before = os.umask(umask)
    try:
        write(tmp_path / f"new.{ending}")
    finally:
        os.umask(before)
    assert mode(tmp_path / f"new.{ending}") == 0o666 & ~umask


@pytest.mark.parametrize("own", [0o664, 0o600, 0o444, 0o755])
def test_old_files_keep_their_mode(tmp_path, kind, own) -> None:
    ending, write = kind
    path = tmp_path / f"old.{ending}"
    path.write_bytes(b"old")
    path.chmod(own)
    write(path)
    assert mode(path) == own
    assert path.stat().st_size > 3
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("there", [True, False])
def test_links_stay_links(tmp_path, kind, there) -> None:
    """Also a link to a link in another folder, whose text is relative to where it lies."""
    ending, write = kind
    folder = tmp_path / "data"
    folder.mkdir()
    target, middle, link = (
        folder / f"target.{ending}",
        folder / f"middle.{ending}",
        tmp_path / f"link.{ending}",
    )
    middle.symlink_to(target.name)
    link.symlink_to(os.path.join("data", middle.name))
    if there:
        target.write_bytes(b"old")
        target.chmod(0o640)
    write(link)
    assert link.is_symlink()
    assert middle.is_symlink()
    assert not target.is_symlink()
    assert target.stat().st_size > 3
    assert not there or mode(target) == 0o640
    assert sorted(os.listdir(folder)) == sorted([middle.name, target.name])


def test_names_that_cannot_be_leave_nothing(tmp_path, kind) -> None:
    ending, write = kind
    (tmp_path / f"folder.{ending}").mkdir()
    loop = tmp_path / f"loop.{ending}"
    loop.symlink_to(loop.name)
    os.mkfifo(tmp_path / f"pipe.{ending}")
    before = sorted(os.listdir(tmp_path))
    bad = [f"folder.{ending}", loop.name, f"pipe.{ending}", f"no/such.{ending}", "n" * 300 + f".{ending}"]
    for name in (*bad, f"zero\0byte.{ending}"):
        with pytest.raises(nrs.NaniteError):
            write(str(tmp_path / name))
    assert sorted(os.listdir(tmp_path)) == before
    assert loop.is_symlink()
