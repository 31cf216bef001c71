"""Builds of sources that do not fit: against the same source built in memory, and against the source itself."""

from __future__ import annotations

import errno
import multiprocessing
import re
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from types import SimpleNamespace
from typing import TYPE_CHECKING

import igl
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from conftest import SOAK
from nanite_rs import _pieces, building
from oracles import subjects

if TYPE_CHECKING:
    from pathlib import Path

#: Too little for any source here: blocks have about as many faces as are allowed at least.
LITTLE = 1 << 20


def arrays(name: str) -> tuple[np.ndarray, np.ndarray]:
    mesh = subjects.subject(name)
    return mesh.vertices, mesh.faces


def is_closed(cut: nrs.Cut) -> bool:
    return trimesh.Trimesh(cut.vertices, cut.faces, process=False).is_watertight


def built(source, folder, **kwargs) -> nrs.NaniteMesh:
    return nrs.build_file(source, folder / "built.nanite", memory=kwargs.pop("memory", LITTLE), **kwargs)


def in_memory(arrays, folder, **kwargs) -> nrs.NaniteMesh:
    nrs.NaniteMesh.from_arrays(*arrays, **kwargs).save(folder / "memory.nanite")
    return nrs.NaniteMesh.open(folder / "memory.nanite")


def write_ply(path: Path, vertices, faces, order: str = "<", **columns) -> None:
    """Binary PLY, of float32 or float64 positions, with further properties of vertices."""
    kind = {"f4": "float", "f8": "double", "u1": "uchar"}
    fields = [(axis, order + vertices.dtype.str[1:]) for axis in "xyz"]
    fields += [
        (name, order + rows.dtype.str[1:] if rows.dtype.itemsize > 1 else "u1")
        for name, rows in columns.items()
    ]
    rows = np.zeros(len(vertices), fields)
    for k, axis in enumerate("xyz"):
        rows[axis] = vertices[:, k]
    for name, values in columns.items():
        rows[name] = values
    triangles = np.zeros(len(faces), [("count", "u1"), ("corners", order + "i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    end = "little" if order == "<" else "big"
    lines = ["ply", f"format binary_{end}_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property {kind[dtype[-2:]]} {name}" for name, dtype in fields]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + rows.tobytes() + triangles.tobytes())


def key(vertices, faces) -> set[bytes]:
    """Triangles by the bits of their corners, whichever comes first."""
    corners = np.asarray(vertices, np.float64)[faces]
    first = np.lexsort(corners.transpose(2, 0, 1)[::-1], axis=1)[:, 0]
    turned = np.stack([corners[np.arange(len(faces)), (first + k) % 3] for k in range(3)], axis=1)
    return {row.tobytes() for row in turned}


NAMES = ("sphere", "knot", "part", "gyroid", "terrain", *(("sheets", "soup", "bunny") if SOAK else ()))


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("name", NAMES)
def test_blocks_make_the_same_mesh(name, quality, tmp_path) -> None:
    vertices, faces = arrays(name)
    options = nrs.BuildOptions(quality=quality)
    mesh = built((vertices, faces), tmp_path, options=options)
    whole = in_memory((vertices, faces), tmp_path, options=options)
    assert mesh.check().borders > 0
    full, expected = mesh.cut(error=0.0), whole.cut(error=0.0)
    assert mesh.report.input_faces == len(faces) == whole.report.input_faces
    counted = ("degenerate_faces", "duplicate_faces", "border_edges", "non_manifold_edges")
    assert [getattr(mesh.report, k) for k in counted] == [getattr(whole.report, k) for k in counted]
    assert key(full.vertices, full.faces) == key(expected.vertices, expected.faces)
    assert len(full.vertices) == len(expected.vertices)
    # Normals are computed over the borders of blocks.
    order = [np.lexsort(np.column_stack([c.vertices, c.normals]).T) for c in (full, expected)]
    of_full, of_expected = full.normals[order[0]], expected.normals[order[1]]
    assert np.abs(of_full - of_expected).max() < 1e-2


@pytest.mark.parametrize("name", ["sphere", "knot", "gyroid"])
def test_closed_sources_stay_closed(name, tmp_path) -> None:
    mesh = built(arrays(name), tmp_path)
    largest = mesh.cut(target_faces=1).error
    for error in np.geomspace(1e-4, 1.0, 12) * largest:
        assert is_closed(mesh.cut(error=float(error))), error


def assert_bounds_hold(cut: nrs.Cut, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Samples and vertices of each surface are no farther from the other than the error of the cut."""
    # libigl squares coordinates.
    origin = np.asarray(vertices, np.float64)[faces[0, 0]]
    surfaces = [
        (np.asarray(of.vertices) - origin, of.faces)
        for of in (SimpleNamespace(vertices=vertices, faces=faces), cut)
    ]
    for (points, own), (others, of_others) in (surfaces, surfaces[::-1]):
        surface = trimesh.Trimesh(points, own, process=False)
        samples, _ = trimesh.sample.sample_surface(surface, 5_000, seed=1)
        samples = np.concatenate([samples, points[np.unique(own)]])
        squared, _, _ = igl.point_mesh_squared_distance(samples, others, np.asarray(of_others, np.int64))
        assert np.sqrt(squared.max()) <= cut.error * (1 + 1e-9) + 1e-12


@pytest.mark.parametrize("name", ["knot", "terrain"])
def test_bounds_hold_over_the_borders_of_blocks(name, tmp_path) -> None:
    vertices, faces = arrays(name)
    mesh = built((vertices, faces), tmp_path)
    largest = mesh.cut(target_faces=1).error
    rng = np.random.default_rng(7)
    for error in np.exp(rng.uniform(np.log(1e-4), 0.0, 200 if SOAK else 4)) * largest:
        assert_bounds_hold(mesh.cut(error=float(error)), vertices, faces)


def test_attributes_and_face_ids_come_along(tmp_path) -> None:
    vertices, faces = arrays("knot")
    rng = np.random.default_rng(3)
    colors = rng.integers(0, 255, (len(vertices), 4)).astype(np.uint8)
    uvs = rng.uniform(0, 1, (len(vertices), 2)).astype(np.float32)
    numbers = (vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int32)
    given = {"colors": colors, "uvs": uvs, "face_materials": numbers}
    options = nrs.BuildOptions(face_ids=True)
    mesh = built([(vertices, faces, given)], tmp_path, options=options)
    mesh.check()
    whole = in_memory((vertices, faces), tmp_path, options=options, **given)
    a, b = mesh.cut(error=0.0), whole.cut(error=0.0)
    ids = mesh.source_face_ids, whole.source_face_ids
    assert sorted(ids[0]) == list(range(len(faces)))
    by_a, by_b = (np.argsort(of) for of in ids)
    assert np.array_equal(a.face_materials[by_a], b.face_materials[by_b])
    assert np.array_equal(a.face_materials[by_a], numbers)
    for rows_of in (lambda cut: cut.colors, lambda cut: cut.uvs[0]):
        of_corners = [
            np.sort(rows_of(cut)[cut.faces[order]].reshape(len(faces), -1))
            for cut, order in ((a, by_a), (b, by_b))
        ]
        assert np.array_equal(*of_corners)


class Lazy:
    """An array that is read by slices of rows alone, as those of zarr and h5py."""

    def __init__(self, rows: np.ndarray) -> None:
        self._rows = rows
        self.shape, self.dtype, self.ndim = rows.shape, rows.dtype, rows.ndim
        self.most = 0

    def __getitem__(self, where: slice) -> np.ndarray:
        assert isinstance(where, slice)
        rows = self._rows[where]
        self.most = max(self.most, len(rows))
        return rows

    def __len__(self) -> int:
        return len(self._rows)

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise AssertionError("read as a whole")


def all_attributes(vertices, faces) -> dict:
    rng = np.random.default_rng(3)
    return {
        "normals": vertices / np.linalg.norm(vertices, axis=1, keepdims=True).astype(np.float32),
        "colors": rng.integers(0, 255, (len(vertices), 3)).astype(np.uint8),
        "uvs": rng.uniform(0, 1, (len(vertices), 2)),
        "face_materials": (vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int64),
        "channels": {
            "a/b heat": vertices[:, 0].astype(np.float64),
            "part": (vertices[:, 1] > 0).astype(np.uint8),
            "two": np.stack([vertices[:, 2], vertices[:, 0]], axis=1).astype(np.float32),
        },
    }


def mapped(given: dict, wrap) -> dict:
    return {
        name: mapped(rows, wrap) if isinstance(rows, dict) else wrap(rows) for name, rows in given.items()
    }


def assert_same_rows(a: nrs.Cut, b: nrs.Cut) -> None:
    assert key(a.vertices, a.faces) == key(b.vertices, b.faces)
    assert a.colors.dtype == b.colors.dtype
    assert {n: c.dtype for n, c in a.channels.items()} == {n: c.dtype for n, c in b.channels.items()}
    for rows in (
        lambda cut: cut.colors,
        lambda cut: cut.uvs[0],
        lambda cut: cut.channels["a/b heat"],
        lambda cut: cut.channels["part"],
        lambda cut: cut.channels["two"],
    ):
        values = [np.sort(rows(cut)[cut.faces].reshape(3 * len(cut.faces), -1), axis=0) for cut in (a, b)]
        assert np.array_equal(*values)
    assert np.array_equal(np.bincount(a.face_materials), np.bincount(b.face_materials))


def dask_array(rows: np.ndarray):
    return pytest.importorskip("dask.array").from_array(rows, chunks=5_000)


@pytest.mark.parametrize("wrap", [lambda rows: rows, Lazy, dask_array], ids=["numpy", "lazy", "dask"])
@pytest.mark.parametrize("memory", [LITTLE, "4 GiB"])
def test_arrays_with_attributes_are_one_source(wrap, memory, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(_pieces, "ROWS", 1 << 12)
    vertices, faces = arrays("knot")
    given = all_attributes(vertices, faces)
    source = wrap(vertices), wrap(faces.astype(np.int64)), mapped(given, wrap)
    mesh = built(source, tmp_path, memory=memory)
    if isinstance(source[0], Lazy):
        assert source[0].most <= 1 << 12
    whole = in_memory((vertices, faces), tmp_path, **given)
    if memory == "4 GiB":
        assert (tmp_path / "built.nanite").read_bytes() == (tmp_path / "memory.nanite").read_bytes()
    else:
        assert mesh.check().borders > 0
        assert_same_rows(mesh.cut(error=0.0), whole.cut(error=0.0))


def test_channels_of_pieces(tmp_path) -> None:
    vertices, faces = arrays("knot")
    given = all_attributes(vertices, faces)

    def pieces():
        for part in np.array_split(np.arange(len(faces)), 5):
            used, corners = np.unique(faces[part], return_inverse=True)
            own = {n: r[part if n == "face_materials" else used] for n, r in given.items() if n != "channels"}
            channels = {name: rows[used] for name, rows in given["channels"].items()}
            yield vertices[used], corners.reshape(-1, 3), {**own, "channels": channels}

    mesh = built(pieces(), tmp_path)
    whole = in_memory((vertices, faces), tmp_path, **given)
    assert_same_rows(mesh.cut(error=0.0), whole.cut(error=0.0))


def test_face_channels_of_what_fits(tmp_path) -> None:
    vertices, faces = arrays("knot")
    part = (vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int32)
    mesh = built((vertices, faces, {"face_channels": {"part": part}}), tmp_path, memory="4 GiB")
    assert np.array_equal(np.bincount(mesh.cut(error=0.0).face_channels["part"]), np.bincount(part))


def test_channels_on_executors(tmp_path) -> None:
    vertices, faces = arrays("knot")
    source = vertices, Lazy(faces), {"channels": {"part": (vertices[:, 1] > 0).astype(np.uint8)}}
    built(source, tmp_path)
    expected = (tmp_path / "built.nanite").read_bytes()
    with ThreadPoolExecutor(2) as executor:
        built(source, tmp_path, executor=executor)
    assert (tmp_path / "built.nanite").read_bytes() == expected


def test_the_same_bytes_on_any_number_of_threads(tmp_path) -> None:
    source = arrays("knot")
    found = []
    for threads in (1, 2):
        nrs.build_file(
            source, tmp_path / "x.nanite", memory=LITTLE, options=nrs.BuildOptions(threads=threads)
        )
        found.append((tmp_path / "x.nanite").read_bytes())
    assert found[0] == found[1]


@pytest.mark.parametrize("memory", ["4 MB", "4 GiB"])
def test_positions_are_rounded_as_asked(memory, tmp_path) -> None:
    source = nrs.shapes.displaced_icosphere(faces=30_000)
    made = {
        precision: nrs.build_file(
            source, tmp_path / f"{precision}.nanite", memory=memory, precision=precision
        )
        for precision in ("auto", "exact", 1e-5)
    }
    assert made["exact"].info["rounding"] == 0.0
    assert 0.0 < made[1e-5].info["rounding"] <= 0.5e-5 * 3**0.5
    assert made["auto"].info["precision"] > 1e-5
    places = [{tuple(p) for p in mesh.cut(error=0.0).vertices} for mesh in (made["exact"], made["auto"])]
    assert places[0] == {tuple(p) for p in source[0]} != places[1]
    with pytest.raises(nrs.ArgumentError, match="precision"):
        nrs.build_file(source, tmp_path / "a.nanite", memory=memory, precision="fine")


def test_what_fits_is_what_memory_makes(tmp_path) -> None:
    vertices, faces = arrays("knot")
    write_ply(tmp_path / "x.ply", vertices.astype(np.float32), faces)
    nrs.NaniteMesh.from_file(tmp_path / "x.ply").save(tmp_path / "memory.nanite")
    nrs.build_file(tmp_path / "x.ply", tmp_path / "x.nanite")
    assert (tmp_path / "x.nanite").read_bytes() == (tmp_path / "memory.nanite").read_bytes()
    assert {p.name for p in tmp_path.iterdir()} == {"x.ply", "x.nanite", "memory.nanite"}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_ply_is_read_in_pieces(order, dtype, tmp_path) -> None:
    vertices, faces = arrays("knot")
    vertices = vertices.astype(dtype) + dtype(0.1 if dtype == np.float64 else 0.0)
    red = np.linspace(0, 255, len(vertices)).astype(np.uint8)
    extra = {"red": red, "green": red, "blue": red, "quality": vertices[:, 0].astype(np.float32)}
    write_ply(tmp_path / "x.ply", vertices, faces, order, **extra)
    mesh = built(tmp_path / "x.ply", tmp_path)
    cut = mesh.cut(error=0.0)
    assert np.allclose(cut.channels["quality"], cut.vertices[:, 0], atol=1e-3)
    whole = in_memory((vertices, faces), tmp_path).cut(error=0.0)
    assert key(cut.vertices, cut.faces) == key(whole.vertices, whole.faces)
    assert cut.colors is not None
    assert list(cut.channels) == ["quality"]
    assert len(cut) == len(faces)


def test_stl_is_read_in_pieces(tmp_path) -> None:
    vertices, faces = arrays("knot")
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "x.stl")
    mesh = built(tmp_path / "x.stl", tmp_path)
    assert mesh.report.border_edges == 0
    assert len(mesh) == len(faces)
    assert is_closed(mesh.cut(target_faces=500))


def test_memory_maps_are_read_where_they_lie(tmp_path) -> None:
    vertices, faces = arrays("knot")
    np.save(tmp_path / "v.npy", vertices.astype(np.float32))
    np.save(tmp_path / "f.npy", faces.astype(np.uint32))
    maps = [np.load(tmp_path / name, mmap_mode="r") for name in ("v.npy", "f.npy")]
    assert len(built(tuple(maps), tmp_path)) == len(faces)


def test_pieces_that_touch_are_one_surface(tmp_path) -> None:
    x, y = np.meshgrid(np.arange(65), np.arange(65), indexing="ij")
    corner = np.arange(64)[:, None] * 65 + np.arange(64)
    faces = np.stack([corner, corner + 65, corner + 1, corner + 1, corner + 65, corner + 66], -1).reshape(
        -1, 3
    )

    def pieces():
        for i in range(2):
            for j in range(2):
                a, b = x + 64 * i, y + 64 * j
                yield np.stack([a, b, 3 * np.sin(a / 9) * np.cos(b / 7)], -1).reshape(-1, 3), faces

    mesh = built(pieces(), tmp_path)
    assert mesh.report.border_edges == 4 * 128
    assert mesh.report.welded_vertices == 4 * 65**2 - 129**2


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        (lambda b: b[:-7], nrs.FormatError, "element face, row .* file ends at byte"),
        (lambda b: b.replace(b"binary_little_endian", b"ascii"), nrs.FormatError, "element vertex, row 0 of"),
        (lambda b: b.replace(b"float x", b"floaf x"), nrs.FormatError, "is no type of PLY"),
        (lambda b: b.replace(b"end_header", b"end_heager"), nrs.FormatError, "header"),
    ],
)
def test_bad_files_say_what_is_wrong(change, error, match, tmp_path) -> None:
    write_ply(
        tmp_path / "x.ply", *[a.astype(t) for a, t in zip(arrays("knot"), (np.float32, int), strict=True)]
    )
    (tmp_path / "x.ply").write_bytes(change((tmp_path / "x.ply").read_bytes()))
    with pytest.raises(error, match=match):
        built(tmp_path / "x.ply", tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"x.ply"}


def test_bad_arguments_say_what_is_wrong(tmp_path) -> None:
    vertices, faces = arrays("knot")
    for source, error, match in (
        ((vertices, faces + len(vertices)), nrs.MeshError, "refers to vertex"),
        ((vertices * np.nan, faces), nrs.MeshError, "not finite"),
        ([(vertices, faces), (vertices,)], nrs.DtypeError, "piece 1"),
        ([(vertices, faces), (vertices, faces + 1)], nrs.MeshError, "piece 1: faces"),
        ([(vertices, faces, {"color": vertices})], nrs.ArgumentError, "piece 0: 'color' is none of"),
        ((vertices, faces, {"color": vertices}), nrs.ArgumentError, "'color' is none of"),
        ((vertices, faces, {"normals": vertices[1:]}), nrs.ArgumentError, "normals has shape"),
        ((vertices, faces, {"channels": {"a": faces}}), nrs.ArgumentError, "channel a has shape"),
        (
            (vertices, faces, {"face_channels": {"a": faces[:, 0]}}),
            nrs.ArgumentError,
            "at most 4,096 are kept apart",
        ),
        (
            [(vertices, faces, {"face_channels": {"a": faces[:, 0]}})],
            nrs.ArgumentError,
            "at most 4,096 are kept apart",
        ),
        ([(vertices, faces), (vertices, faces, {"normals": vertices})], nrs.ArgumentError, "piece 1: has"),
        ([tmp_path / "none.ply"], nrs.FileError, "none.ply"),
        ([], nrs.MeshError, "no pieces"),
        (7, nrs.DtypeError, "source: expected"),
    ):
        with pytest.raises(error, match=match):
            built(source, tmp_path)
    for memory in ("much", "4 XB", -1, 0):
        with pytest.raises(nrs.ArgumentError, match="memory"):
            built((vertices, faces), tmp_path, memory=memory)
    with pytest.raises(nrs.FormatError, match=r"must end in \.nanite"):
        nrs.build_file((vertices, faces), tmp_path / "x.ply")
    with pytest.raises(nrs.FileError):
        nrs.build_file((vertices, faces), tmp_path / "none" / "x.nanite")
    assert not list(tmp_path.iterdir())


CHILD = """
import sys
import numpy as np
import nanite_rs as nrs
folder = sys.argv[1]
source = np.load(f"{folder}/v.npy", mmap_mode="r"), np.load(f"{folder}/f.npy", mmap_mode="r")
nrs.build_file(source, f"{folder}/x.nanite", memory=1 << 20, resume=True)
"""


def saved_arrays(name: str, folder: Path) -> None:
    vertices, faces = arrays(name)
    np.save(folder / "v.npy", vertices.astype(np.float32))
    np.save(folder / "f.npy", faces.astype(np.uint32))


def test_a_killed_build_goes_on(tmp_path) -> None:
    saved_arrays("knot", tmp_path)
    command = [sys.executable, "-c", CHILD, str(tmp_path)]
    start = time.perf_counter()
    subprocess.run(command, check=True)
    whole = time.perf_counter() - start
    expected = (tmp_path / "x.nanite").read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(50 if SOAK else 3):
        (tmp_path / "x.nanite").unlink()
        made = 0
        for _ in range(3):
            child = subprocess.Popen(command)
            time.sleep(rng.uniform(0.0, whole))
            child.kill()
            child.wait()
            found = len(list((tmp_path / "x.nanite.work").rglob("*.made")))
            # What is finished stays finished.
            assert found >= made or (tmp_path / "x.nanite").exists()
            made = found
        subprocess.run(command, check=True)
        assert (tmp_path / "x.nanite").read_bytes() == expected
        assert {path.name for path in tmp_path.iterdir()} == {"v.npy", "f.npy", "x.nanite"}


def test_what_a_killed_build_was_removing_is_removed(tmp_path) -> None:
    """A work folder gets another name before it goes."""
    left, other = tmp_path / f"built.nanite.work-{'0a' * 16}", tmp_path / "built.nanite.work-mine"
    for folder in (left, other):
        (folder / "blocks").mkdir(parents=True)
    built(arrays("knot"), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"built.nanite", other.name}


@pytest.mark.parametrize("processes", [False, True])
def test_another_build_is_not_gone_on_with(processes, tmp_path) -> None:
    class Stop(Exception):
        pass

    def stop(done, total):
        if done > 0.7 * total:
            raise Stop

    class Stopping(ThreadPoolExecutor):
        def submit(self, *task):
            if len(list((tmp_path / "built.nanite.work").rglob("*.made"))) > 2:
                raise Stop
            super().submit(*task).result()
            return super().submit(int)

    vertices, faces = arrays("knot")
    how = {"executor": Stopping()} if processes else {"progress": stop}
    with pytest.raises(Stop):
        built((vertices, faces), tmp_path, resume=True, **how)
    assert list((tmp_path / "built.nanite.work").rglob("*.made"))
    how = {"executor": ThreadPoolExecutor(2)} if processes else {}
    bent = vertices + np.float32([0.2, 0.0, 0.0]) * np.sin(vertices[:, 1:2] * 9.0)
    built((bent, faces), tmp_path, resume=True, **how)
    assert not (tmp_path / "built.nanite.work").exists()
    found = (tmp_path / "built.nanite").read_bytes()
    built((bent, faces), tmp_path)
    assert found == (tmp_path / "built.nanite").read_bytes()


def test_bounds_are_those_of_the_source(tmp_path) -> None:
    """What is coarse may stray from it."""
    vertices, faces = arrays("knot")
    found = built((vertices, faces), tmp_path).bounds
    # The file rounds positions to its grid.
    assert np.allclose(np.asarray(found), np.array([vertices.min(0), vertices.max(0)]), atol=1e-3)


@pytest.mark.parametrize("workers", [1, 3])
def test_processes_make_the_same_bytes(workers, tmp_path) -> None:
    source = arrays("knot")
    built(source, tmp_path)
    expected = (tmp_path / "built.nanite").read_bytes()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context) as executor:
        built(source, tmp_path, executor=executor)
    assert (tmp_path / "built.nanite").read_bytes() == expected
    with ThreadPoolExecutor(workers) as executor:
        built(source, tmp_path, executor=executor)
    assert (tmp_path / "built.nanite").read_bytes() == expected


def test_a_full_disk_loses_nothing(tmp_path) -> None:
    saved_arrays("knot", tmp_path)
    # No file may be larger: what a full disk does, for one file.
    limit = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, resource.RLIM_INFINITY))"
    command = [sys.executable, "-c", limit + CHILD, str(tmp_path)]
    failed = subprocess.run(command, check=False, capture_output=True, text=True)
    assert failed.returncode != 0
    assert "FileError" in failed.stderr
    assert "x.nanite" in failed.stderr.splitlines()[-1]
    made = len(list((tmp_path / "x.nanite.work").rglob("*.made")))
    assert made > 0
    subprocess.run([sys.executable, "-c", CHILD, str(tmp_path)], check=True)
    assert nrs.NaniteMesh.open(tmp_path / "x.nanite").check().borders > 0


def test_a_folder_in_the_way_stays(tmp_path) -> None:
    (tmp_path / "built.nanite.work").mkdir()
    (tmp_path / "built.nanite.work" / "mine").write_text("mine")
    with pytest.raises(nrs.FileError, match="in the way"):
        built(arrays("knot"), tmp_path)
    assert (tmp_path / "built.nanite.work" / "mine").read_text() == "mine"
    # That of a build that was killed at once is none.
    (tmp_path / "built.nanite.work" / "mine").unlink()
    built(arrays("knot"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["built.nanite"]


def test_a_build_can_be_stopped(tmp_path) -> None:
    class Stop(Exception):
        pass

    def stop(done, total):
        if done > 0.3 * total:
            raise Stop

    with pytest.raises(Stop):
        built(arrays("gyroid"), tmp_path, progress=stop)
    assert not list(tmp_path.iterdir())


def test_channels_come_along(tmp_path) -> None:
    vertices, faces = arrays("knot")
    vertices = vertices.astype(np.float32)
    rng = np.random.default_rng(4)
    channels = {
        "heat": (3 * vertices[:, 0] + np.sin(9 * vertices[:, 1])).astype(np.float32),
        "flow": rng.normal(size=(len(vertices), 3)).astype(np.float32),
        "part": np.where(vertices[:, 2] > 0, 4, -3).astype(np.int16),
    }
    mesh = built([(vertices, faces, {"channels": channels})], tmp_path)
    again = built((vertices, faces, {"channels": channels}), tmp_path)
    assert mesh == again
    mesh.check()
    whole = in_memory((vertices, faces), tmp_path, channels=channels)
    full, expected = mesh.cut(error=0.0), whole.cut(error=0.0)
    for name, given in channels.items():
        assert full.channels[name].dtype == given.dtype
        of_corners = [
            np.sort(np.asarray(cut.channels[name], float)[cut.faces].reshape(-1)) for cut in (full, expected)
        ]
        assert np.array_equal(*of_corners), name
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        other = whole.cut(target_reduction=reduction)
        assert set(cut.channels["part"]) <= {-3, 4}
        wrong = [np.mean((of.channels["part"] == 4) != (of.vertices[:, 2] > 0)) for of in (cut, other)]
        # Labels are those of what the stage before left.
        assert wrong[0] < wrong[1] + 0.02
        off = [
            np.abs(of.channels["heat"] - (3 * of.vertices[:, 0] + np.sin(9 * of.vertices[:, 1]))).mean()
            for of in (cut, other)
        ]
        assert off[0] < 1.3 * off[1]


@pytest.mark.parametrize("materials", [False, True])
def test_face_channels_come_along(materials, tmp_path) -> None:
    vertices, faces = arrays("knot")
    centers = vertices[faces].mean(axis=1)
    given = {"face_channels": {"segment": (centers[:, 0] > 0).astype(np.int8) + 2 * (centers[:, 1] > 0)}}
    if materials:
        given["face_materials"] = (centers[:, 2] > 0).astype(np.int32)
    options = nrs.BuildOptions(face_ids=True)
    half = len(faces) // 2
    parts = [
        (
            vertices,
            faces[rows],
            {
                name: {k: v[rows] for k, v in of.items()} if name == "face_channels" else of[rows]
                for name, of in given.items()
            },
        )
        for rows in (slice(0, half), slice(half, None))
    ]
    whole = in_memory((vertices, faces), tmp_path, options=options, **given)
    for source in ((vertices, faces, given), parts):
        mesh = built(source, tmp_path, options=options)
        mesh.check()
        full = mesh.cut(error=0.0)
        order = np.argsort(mesh.source_face_ids)
        assert np.array_equal(full.face_channels["segment"][order], given["face_channels"]["segment"])
        if materials:
            assert np.array_equal(full.face_materials[order], given["face_materials"])
        assert full.face_channels["segment"].dtype == given["face_channels"]["segment"].dtype
        assert mesh.report.border_edges == whole.report.border_edges == 0
        # Lines between segments stay in place: each keeps its area.
        cut = mesh.cut(target_reduction=0.9)
        segments = (full.face_channels["segment"], cut.face_channels["segment"])
        areas = [
            np.bincount(of, trimesh.Trimesh(c.vertices, c.faces, process=False).area_faces, 4)
            for of, c in zip(segments, (full, cut), strict=True)
        ]
        assert np.allclose(areas[1], areas[0], rtol=0.03)
    # Numbers are averaged to vertices, beside labels and without them.
    heat = np.sin(np.arange(len(faces)) / 100).astype(np.float32)
    for labels in ({}, given["face_channels"]):
        own = {**given, "face_channels": {**labels, "heat": heat}}
        with pytest.warns(nrs.UsageWarning, match="averaged to vertices"):
            mesh = built((vertices, faces, own), tmp_path)
        with pytest.warns(nrs.UsageWarning, match="averaged to vertices"):
            other = in_memory((vertices, faces), tmp_path, **own).cut(error=0.0)
        full = mesh.cut(error=0.0)
        assert set(full.face_channels) == set(labels)
        rows = []
        for cut in (full, other):
            of_corners = np.column_stack([cut.vertices, cut.channels["heat"]])[cut.faces.reshape(-1)]
            rows.append(of_corners[np.lexsort(of_corners.T)])
        assert np.array_equal(*rows)


def test_pieces_may_share_vertices(tmp_path) -> None:
    vertices, faces = arrays("knot")
    half, third = len(vertices) // 2, len(faces) // 3
    pieces = [
        (vertices[:half], faces[:third]),
        (vertices[half:], faces[third : 2 * third]),
        (vertices[:0], faces[2 * third :]),
    ]
    mesh = built(iter(pieces), tmp_path, numbering="all")
    assert mesh == built((vertices, faces), tmp_path)
    assert mesh.report.welded_vertices == 0
    faces = faces.copy()
    faces[third + 5, 1] = len(vertices)
    pieces[1] = vertices[half:], faces[third : 2 * third]
    match = rf"piece 1: faces\[5\] refers to vertex {len(vertices)}, but all"
    with pytest.raises(nrs.MeshError, match=match):
        built(iter(pieces), tmp_path, numbering="all")
    with pytest.raises(nrs.MeshError, match="piece 0: faces"):
        built([(vertices, faces - 1)], tmp_path, numbering="all")
    with pytest.raises(nrs.ArgumentError, match="numbering"):
        built(iter(pieces), tmp_path, numbering="global")


def test_a_full_disk_says_how_much_is_missing(tmp_path, monkeypatch) -> None:
    class Full:
        """What begins a build where there is no room for it."""

        @staticmethod
        def begin(*_, folder: Path, **__) -> None:
            raise nrs.FileError(errno.ENOSPC, "No space left on device", str(folder / "own-000000"))

    vertices, faces = arrays("knot")
    monkeypatch.setattr(building, "BlockBuild", Full)
    assert len(faces) * 150 == 9_000_000
    for free, missing in ((1_000_000, True), (1 << 40, False)):
        monkeypatch.setattr(building.shutil, "disk_usage", lambda _, free=free: SimpleNamespace(free=free))
        with pytest.raises(nrs.FileError) as caught:
            built((vertices, faces), tmp_path)
        text = str(caught.value)
        said = r"own-000000: No space left on device; the work folder takes some 9\.0 MB, and has (.*) MB"
        found = re.search(said + (r": some (.*) MB are missing$" if missing else "$"), text)
        assert found is not None, text
        assert not missing or abs(9.0 - float(found[1]) - 1.0 - float(found[2])) < 0.11
