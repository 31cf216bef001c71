"""`.nanite` files and pickles: equal after a round trip, and a typed error whatever happens to the bytes."""

import contextlib
import copy
import hashlib
import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import camera, subjects

SOAK = bool(os.environ.get("NANITE_SOAK"))


@pytest.fixture(scope="module")
def mesh():
    v, f = subjects.cube(12)
    colors = np.random.default_rng(0).integers(0, 255, (len(v), 4), np.uint8)
    uvs = [np.asarray(v[:, :2], np.float32)]
    return nrs.NaniteMesh.from_arrays(
        v, f, colors=colors, uvs=uvs, options=nrs.BuildOptions(face_ids=True), progress=False
    )


@pytest.fixture(scope="module")
def blob(mesh, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("files") / "mesh.nanite"
    mesh.save(path, precision="exact")
    return path.read_bytes()


def opened(data: bytes, folder):
    path = folder / "damaged.nanite"
    path.write_bytes(data)
    return nrs.NaniteMesh.open(path)


def test_saved_and_opened_is_equal(mesh, tmp_path) -> None:
    path = tmp_path / "mesh.nanite"
    mesh.save(path, precision="exact")
    again = nrs.NaniteMesh.open(path)
    assert again == mesh
    assert (again != mesh) is False
    again.check()
    again.save(tmp_path / "again.nanite", precision="exact")
    assert (tmp_path / "again.nanite").read_bytes() == path.read_bytes()
    for error in (0.0, 0.05, 10.0):
        a, b = mesh.cut(error=error), again.cut(error=error)
        for name in ("vertices", "faces", "normals", "colors", "cluster_ids"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.error == b.error
    assert [p.name for p in tmp_path.iterdir() if "nanite" not in p.suffix] == []


def test_cuts_for_budgets_read_what_they_need(tmp_path) -> None:
    """Their pages and no others, and they are those of a mesh in memory."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=100_000, seed=5)
    path = tmp_path / "mesh.nanite"
    nrs.NaniteMesh.from_arrays(vertices, faces, progress=False).save(path)
    whole = nrs.NaniteMesh.open(path)
    whole.cut(error=0.0)
    for target in np.geomspace(30, 99_000, 40 if SOAK else 9).astype(int).tolist():
        mesh = nrs.NaniteMesh.open(path)
        before = mesh.nbytes
        cut, expected = mesh.cut(target_faces=target), whole.cut(target_faces=target)
        np.testing.assert_array_equal(cut.faces, expected.faces)
        np.testing.assert_array_equal(cut.vertices, expected.vertices)
        assert cut.error == expected.error
        if target < 2_000:
            assert mesh.nbytes - before < 0.2 * (whole.nbytes - before)
    assert mesh.cut(target_faces=500).error == whole.cut(target_faces=500).error


@pytest.mark.parametrize("precision", ["auto", 0.01, 0.3])
def test_rounded_files_state_what_they_lost(tmp_path, precision) -> None:
    """Positions are on the grid, off by what is stated, and nothing more is lost by saving again."""
    v, f = subjects.cube(12)
    rng = np.random.default_rng(0)
    colors, uvs = rng.integers(0, 255, (len(v), 4), np.uint8), np.asarray(v[:, :2], np.float32)
    options = nrs.BuildOptions(face_ids=True)
    mesh = nrs.NaniteMesh.from_arrays(v.astype(np.float32), f, colors=colors, uvs=uvs, options=options)
    path = tmp_path / "mesh.nanite"
    mesh.save(path, precision=precision)
    again = nrs.NaniteMesh.open(path)
    again.check()
    info = again.info
    step = info["precision"]
    assert np.log2(step) == round(np.log2(step))
    if precision != "auto":
        assert 0.5 * precision < step <= precision
    assert mesh.info["precision"] is None
    assert mesh.info["rounding"] == mesh.info["normal_rounding"] == 0.0
    assert 0.0 < info["normal_rounding"] < 0.3
    a, b = mesh.cut(error=0.0), again.cut(error=0.0)
    np.testing.assert_array_equal(a.faces, b.faces)
    np.testing.assert_array_equal(a.colors, b.colors)
    assert mesh.info["uv_rounding"] == 0.0
    assert info["uv_rounding"] == 2.0**-17
    assert 0.0 < np.abs(a.uvs[0].astype(np.float64) - b.uvs[0]).max() <= info["uv_rounding"]
    assert (b.uvs[0] * 2.0**16 % 1.0 == 0.0).all()
    np.testing.assert_array_equal(mesh.source_face_ids, again.source_face_ids)
    assert b.vertices.dtype == np.float32
    assert (b.vertices / step == np.rint(b.vertices / step)).all()
    moved = np.linalg.norm(a.vertices.astype(np.float64) - b.vertices, axis=1).max()
    assert moved <= info["rounding"] <= 0.5 * np.sqrt(3.0) * step * (1.0 + 1e-12)
    assert b.error == info["rounding"]
    cosine = (a.normals * b.normals).sum(axis=1).clip(-1.0, 1.0)
    assert np.degrees(np.arccos(cosine)).max() <= info["normal_rounding"] + 0.03  # rounding of f32
    for save in (path, tmp_path / "other.nanite"):
        before = path.read_bytes()
        again.save(save)
        assert save.read_bytes() == before
    again.save(path, precision="exact")
    assert nrs.NaniteMesh.open(path) == again
    assert pickle.loads(pickle.dumps(again)) == again


def test_uvs_too_large_for_steps_stay(tmp_path) -> None:
    v, f = nrs.shapes.icosphere(faces=2_000)
    # Coarser levels may go beyond the source's.
    for largest, stays in ((200.0, False), (256.001, True)):
        uvs = np.asarray(largest * v[:, :2] / np.abs(v[:, :2]).max(), np.float32)
        mesh = nrs.NaniteMesh.from_arrays(v, f, uvs=uvs)
        mesh.save(tmp_path / "mesh.nanite")
        again = nrs.NaniteMesh.open(tmp_path / "mesh.nanite")
        a, b = mesh.cut(error=0.0).uvs[0], again.cut(error=0.0).uvs[0]
        assert np.abs(a).max() == np.float32(largest)
        assert (again.info["uv_rounding"] == 0.0) == stays == np.array_equal(a, b)
        assert np.abs(a.astype(np.float64) - b).max() <= again.info["uv_rounding"]


def test_rounding_of_float64_and_of_files_add_up(mesh, tmp_path) -> None:
    mesh.save(tmp_path / "mesh.nanite")
    again = nrs.NaniteMesh.open(tmp_path / "mesh.nanite")
    before, after = mesh.info["rounding"], again.info["rounding"]
    a, b = mesh.cut(error=0.0), again.cut(error=0.0)
    assert a.vertices.dtype == b.vertices.dtype == np.float64
    moved = np.linalg.norm(a.vertices - b.vertices, axis=1).max()
    most = 0.5 * np.sqrt(3.0) * again.info["precision"]
    assert 0.0 < before < before + moved * (1.0 - 1e-12) <= after <= before + most * (1.0 + 1e-12)


def test_precision_is_checked(mesh, tmp_path) -> None:
    path = tmp_path / "mesh.nanite"
    for wrong in ("fine", 0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(nrs.ArgumentError, match="precision"):
            mesh.save(path, precision=wrong)
    with pytest.raises(nrs.DtypeError, match="precision"):
        mesh.save(path, precision=None)
    assert not path.exists()


def cylinder(sections: int, radius: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Closed, with a fan at either end."""
    angle = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    low, high = (np.column_stack([ring, np.full(sections, z)]) for z in (0.0, height))
    this = np.arange(sections)
    after, top = (this + 1) % sections, this + sections
    center = np.full(sections, 2 * sections)
    rows = [[this, after, after + sections], [this, after + sections, top], [after, this, center]]
    rows.append([top, after + sections, center + 1])
    faces = np.concatenate([np.stack(row, axis=1) for row in rows])
    return np.concatenate([low, high, [[0.0, 0.0, 0.0], [0.0, 0.0, height]]]), faces


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def small_beside_large() -> tuple[np.ndarray, np.ndarray]:
    """A coarse sphere, and a screw of a hundredth of its size with a twentieth of its triangles."""
    v, f = nrs.shapes.icosphere(faces=20_000)
    w, g = cylinder(200, 0.01, 0.05)
    return np.concatenate([v, w + np.array([1.5, 0.0, 0.0])]), np.concatenate([f, g + len(v)])


FINE = {
    "cylinder": lambda: cylinder(2_000, 10.0, 20.0),
    "rod": lambda: cylinder(64, 0.01, 100.0),
    "disc": lambda: cylinder(500, 10.0, 0.001),
    "small part": small_beside_large,
}


@pytest.mark.parametrize("name", FINE)
@pytest.mark.filterwarnings("error::nanite_rs.UsageWarning")
def test_saving_keeps_the_area_of_strips_and_small_parts(name: str, tmp_path) -> None:
    vertices, faces = FINE[name]()
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(quality="fast"))
    mesh.save(tmp_path / "saved.nanite")
    opened = nrs.NaniteMesh.open(tmp_path / "saved.nanite").cut(error=0)
    before, after = (np.sort(areas(*mesh)) for mesh in ((vertices, faces), (opened.vertices, opened.faces)))
    assert len(after) == len(before)
    assert (after > 0.0).all()
    assert after.sum() == pytest.approx(before.sum(), rel=5e-3)
    # Each of its own is off by the rounding of three corners, an eighth of the height at most for each.
    assert np.abs(after - before).max() < 0.4 * before.max()
    assert np.median(np.abs(after / before - 1.0)) < 0.1


def test_saving_warns_where_faces_lose_their_area(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*cylinder(2_000, 10.0, 20.0), options=nrs.BuildOptions(quality="fast"))
    with pytest.warns(nrs.UsageWarning, match=r"precision: [67],\d+ of 8,000 faces have no area"):
        mesh.save(tmp_path / "saved.nanite", precision=0.5)


def test_file_info_reads_what_comes_before_the_pages(mesh, tmp_path) -> None:
    path = tmp_path / "mesh.nanite"
    mesh.save(path)
    info = nrs.NaniteMesh.file_info(path)
    opened_info = nrs.NaniteMesh.open(path).info
    assert {name: info[name] for name in opened_info if name != "bytes"} == {
        name: value for name, value in opened_info.items() if name != "bytes"
    }
    assert info["bytes"] == path.stat().st_size == sum(info["parts"].values())
    assert info["parts"]["colors"] > 0
    assert info["parts"]["channels"] == 0
    # Damage in a page goes unseen here, and nowhere else.
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    assert nrs.NaniteMesh.file_info(path) == info
    damaged = nrs.NaniteMesh.open(path)
    for use in (
        damaged.check,
        lambda: damaged.cut(error=0),
        lambda: damaged == mesh,
        lambda: damaged.save(path),
    ):
        with pytest.raises(nrs.FormatError, match="page"):
            use()
    # What needs none of the damaged page does not know of it.
    assert len(damaged.cut(error=float(np.ptp(damaged.bounds))).faces) > 0
    with pytest.raises(FileNotFoundError):
        nrs.NaniteMesh.file_info(tmp_path / "none.nanite")


def test_pickled_and_copied_is_equal(mesh) -> None:
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        assert pickle.loads(pickle.dumps(mesh, protocol)) == mesh
    assert copy.deepcopy(mesh) == mesh
    assert copy.copy(mesh) == mesh


def test_meshes_that_differ_are_not_equal(mesh) -> None:
    v, f = subjects.cube(12)
    other = nrs.NaniteMesh.from_arrays(v * 1.0001, f, progress=False)
    assert mesh != other
    assert mesh != "mesh"
    assert mesh is not None


def test_pickles_travel_to_another_process(mesh, tmp_path) -> None:
    import subprocess
    import sys

    path = tmp_path / "mesh.pickle"
    path.write_bytes(pickle.dumps(mesh))
    code = "import pickle, sys; m = pickle.load(open(sys.argv[1], 'rb')); print(len(m.cut(error=0).faces))"
    out = subprocess.run(
        [sys.executable, "-c", code, path], capture_output=True, text=True, check=True
    ).stdout
    assert int(out) == len(mesh.cut(error=0).faces)


def test_every_truncation_is_a_typed_error(tmp_path) -> None:
    """Every length of a small file."""
    nrs.NaniteMesh.from_arrays(*subjects.cube(3), progress=False).save(tmp_path / "small.nanite")
    blob = (tmp_path / "small.nanite").read_bytes()
    assert opened(blob, tmp_path)
    for length in range(len(blob)):
        with pytest.raises(nrs.FormatError):
            opened(blob[:length], tmp_path)


def refuses(damaged: bytes, mesh, folder) -> bool:
    """True for a typed error; where only the padding between sections was hit, the same mesh is fine too."""
    try:
        assert opened(damaged, folder) == mesh
    except nrs.FormatError:
        return True
    return False


def test_flipped_bits_are_typed_errors(mesh, blob: bytes, tmp_path) -> None:
    """No flipped bit gives another mesh; all but those of the padding give an error."""
    rng = np.random.default_rng(2)
    places = np.concatenate([np.arange(512), rng.integers(0, len(blob), 20_000 if SOAK else 2000)])
    refused = 0
    for at in places:
        damaged = bytearray(blob)
        damaged[at] ^= 1 << rng.integers(8)
        refused += refuses(bytes(damaged), mesh, tmp_path)
    assert refused >= 0.9 * len(places)


def test_overwritten_stretches_are_typed_errors(mesh, blob: bytes, tmp_path) -> None:
    rng = np.random.default_rng(3)
    for _ in range(3000 if SOAK else 500):
        damaged = bytearray(blob)
        start = int(rng.integers(0, len(blob) - 64))
        stretch = int(rng.integers(1, 64))
        fill = [b"\x00", b"\xff", bytes([rng.integers(256)])][rng.integers(3)]
        damaged[start : start + stretch] = fill * stretch
        refuses(bytes(damaged), mesh, tmp_path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00" * 4096,
        b"\xff" * 4096,
        b"ply\nformat ascii 1.0\n",
        b"PK\x03\x04",
        bytes(np.random.default_rng(5).bytes(9999)),
    ],
    ids=["empty", "zeros", "ones", "ply", "zip", "random"],
)
def test_other_files_are_typed_errors(data: bytes, tmp_path) -> None:
    with pytest.raises(nrs.FormatError) as caught:
        opened(data, tmp_path)
    assert isinstance(caught.value, ValueError)
    assert "damaged.nanite" in str(caught.value)


def test_missing_files_and_folders(mesh, tmp_path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        nrs.NaniteMesh.open(tmp_path / "none.nanite")
    assert isinstance(caught.value, nrs.NaniteError)
    assert "none.nanite" in str(caught.value)
    with pytest.raises(OSError, match=r"none") as caught:
        mesh.save(tmp_path / "none" / "mesh.nanite")
    assert isinstance(caught.value, nrs.NaniteError)
    with pytest.raises(OSError, match=tmp_path.name):
        nrs.NaniteMesh.open(tmp_path)


def test_a_failed_save_leaves_the_old_file(mesh, tmp_path) -> None:
    """The write goes to a temporary file that is renamed: a full or read-only folder changes nothing."""
    folder = tmp_path / "locked"
    folder.mkdir()
    path = folder / "mesh.nanite"
    path.write_bytes(b"old")
    if os.geteuid() == 0:  # permissions do not bind root: a target that cannot be replaced does
        target = folder / "taken.nanite"
        target.mkdir()
        (target / "inside").write_bytes(b"x")
        with pytest.raises(OSError, match="taken"):
            mesh.save(target)
        assert sorted(p.name for p in folder.iterdir()) == ["mesh.nanite", "taken.nanite"]
    else:
        folder.chmod(0o500)
        with pytest.raises(OSError, match="locked"):
            mesh.save(path)
        folder.chmod(0o700)
        assert [p.name for p in folder.iterdir()] == ["mesh.nanite"]
    assert path.read_bytes() == b"old"


def test_saving_over_an_open_mesh_is_safe(mesh, tmp_path) -> None:
    path = tmp_path / "mesh.nanite"
    mesh.save(path)
    again = nrs.NaniteMesh.open(path)
    again.save(path)
    again.check()
    assert nrs.NaniteMesh.open(path) == again


def test_damaged_pickles_are_typed_errors(mesh) -> None:
    blob = bytearray(pickle.dumps(mesh))
    rng = np.random.default_rng(4)
    caught = 0
    for _ in range(200):
        damaged = bytearray(blob)
        damaged[int(rng.integers(len(blob) // 2, len(blob) - 64))] ^= 1 << rng.integers(8)
        try:
            pickle.loads(bytes(damaged))
        except nrs.NaniteError:
            caught += 1
    assert caught == 200


def digest(cut: nrs.Cut) -> str:
    arrays = (cut.vertices, cut.faces, cut.normals)
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[
        :16
    ]


def test_files_of_version_7_give_the_cuts_they_gave(tmp_path: Path) -> None:
    """A knot built and cut by the last version that wrote such files; the numbers beside it are what it gave."""
    folder = Path(__file__).parent / "files"
    given = json.loads((folder / "version7.json").read_text())
    old = nrs.NaniteMesh.open(folder / "version7.nanite")
    old.check()
    old.save(tmp_path / "again.nanite", precision="exact")
    for mesh in (old, nrs.NaniteMesh.open(tmp_path / "again.nanite")):
        for target, count, error, name in given["faces"]:
            cut = mesh.cut(target_faces=target, exact=False)
            assert (len(cut), cut.error, digest(cut)) == (count, error, name), target
            assert target - max(2, 0.005 * target) <= len(mesh.cut(target_faces=target)) <= target
        for most, count, error, name in given["error"]:
            cut = mesh.cut(error=most)
            assert (len(cut), cut.error, digest(cut)) == (count, error, name), most


@pytest.mark.parametrize("steps", [4, 40, 400])
def test_what_storing_moved_counts_in_pixels(tmp_path, steps) -> None:
    """A parallel view shows a unit of the mesh as 100 pixels everywhere; steps are thousandths of a unit."""
    mesh = subjects.built("small sphere")
    mesh.save(tmp_path / "m.nanite", precision=steps / 1000)
    stored = nrs.NaniteMesh.open(tmp_path / "m.nanite")
    moved = 100 * stored.info["rounding"]
    assert moved > 0
    lens, size = nrs.OrthographicCamera(xmag=1.0, ymag=1.0), (200, 200)
    coarser = 0
    for pixels in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 64.0):
        cut = stored.cut(camera=lens, pose=camera.at(0, 0, 3), viewport=size, pixel_error=pixels)
        if len(cut.faces) == len(stored):
            continue
        coarser += 1
        assert 100 * cut.error <= pixels * (1 + 1e-5)
        assert moved < pixels
        scene = nrs.Scene()
        scene.add(stored)
        for backend in ("cpu", "gpu"):
            with contextlib.suppress(nrs.BackendError), nrs.Renderer(*size, backend=backend) as renderer:
                frame = renderer.render(scene, lens, camera.at(0, 0, 3), pixel_error=pixels, occlusion=False)
                drawn, all_of_it = (
                    len(np.unique(a)) for a in (frame.cluster_id[frame.depth > 0], cut.face_clusters)
                )
                # Clusters of the side that is seen.
                assert all_of_it / 3 <= drawn <= all_of_it
    assert coarser > 0
