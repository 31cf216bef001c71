"""What people hand over by mistake as a file or a place for one."""

from __future__ import annotations

import io

import numpy as np
import pytest

import nanite_rs as nrs
from oracles.camera import at


@pytest.fixture(scope="module")
def frame() -> nrs.Frame:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=320))
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    with nrs.Renderer(16, 12, backend="cpu") as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), at(0, 0, 4))


@pytest.mark.parametrize("target", [None, io.BytesIO(), 3], ids=["none", "buffer", "number"])
def test_a_place_that_is_no_path(target, frame: nrs.Frame) -> None:
    for save in (frame.save, frame.save_depth, lambda path: nrs.save_animation(path, [frame])):
        with pytest.raises(nrs.DtypeError, match=r"^path: expected a path, not "):
            save(target)


def test_names_that_are_empty(frame: nrs.Frame) -> None:
    for use in (frame.save, nrs.NaniteMesh.from_file, nrs.NaniteMesh.open, nrs.load_scene, nrs.Image.open):
        with pytest.raises(nrs.ArgumentError, match="the name is empty"):
            use("")


def test_text_files_and_what_is_no_gltf(tmp_path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\n\xff\xfe\x8c")
    with path.open() as file, pytest.raises(nrs.DtypeError, match="'rb'"):
        nrs.NaniteMesh.from_file(file)
    with pytest.raises(nrs.FormatError, match=r"no glTF: it begins with b'ply"):
        nrs.NaniteMesh.from_file(path.read_bytes(), format="glb")
    with pytest.raises(nrs.FormatError, match="it is empty"):
        nrs.load_scene(b"", format="glb")


def test_meshes_without_a_look_are_saved_without_a_word(tmp_path, recwarn: pytest.WarningsRecorder) -> None:
    path = tmp_path / "a.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 3\n"
    head += "".join(
        f"property {kind}\n" for kind in ("float x", "float y", "float z", "uchar red", "uchar green")
    )
    head += "property uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(head + "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n")
    nrs.NaniteMesh.from_file(path).save(tmp_path / "a.nanite")
    assert not recwarn.list


def test_a_camera_of_pictures_of_another_size() -> None:
    intrinsics = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]
    camera = nrs.IntrinsicsCamera.from_opencv(intrinsics, 64, 48)
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        assert renderer.render(nrs.Scene(), camera, np.eye(4)).metadata["cx"] == 32.0
    other = nrs.Renderer(32, 24, backend="cpu")
    with pytest.raises(nrs.ArgumentError, match=r"camera: it is of pictures of 64 × 48"):
        other.render(nrs.Scene(), camera, np.eye(4))


def test_rotations_of_opencv_that_mirror() -> None:
    with pytest.raises(nrs.ArgumentError, match=r"^R: it mirrors"):
        nrs.pose_from_opencv(-np.eye(3), [0, 0, 1])
