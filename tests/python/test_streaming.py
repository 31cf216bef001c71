"""Streaming: meshes in files are drawn while a pool holds a part of them; files fail, and pictures come."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from conftest import SOAK
from oracles import data, memory
from oracles.camera import at, look_at

SIZE = 320, 240
LENS = nrs.PerspectiveCamera(yfov=0.8)
FRAMES = 10_000 if SOAK else 250


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A generated mesh of 300,000 triangles in a file."""
    path = tmp_path_factory.mktemp("streaming") / "ball.nanite"
    nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=500_000), progress=False).save(path)
    return path


def scene_of(mesh: nrs.NaniteMesh) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0, 0, 0.5))
    scene.add(mesh)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=look_at((3, 4, 5), (0, 0, 0)))
    return scene


def same(a: nrs.Frame, b: nrs.Frame) -> None:
    for name in ("color", "depth", "normal", "instance_id", "cluster_id", "triangle_id"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def flight(frames: int):
    """Poses from far to near and around, not straight, and back."""
    for t in np.linspace(0.0, 1.0, frames):
        distance = 1.3 + 4.0 * (0.5 + 0.5 * np.cos(6 * np.pi * t)) ** 4
        eye = distance * np.array([np.cos(9 * t), 0.4 * np.sin(5 * t), np.sin(9 * t)])
        yield look_at(eye, (0.0, 0.4 * np.sin(11 * t), 0.0))


def total_bytes(path: Path) -> int:
    """Bytes of all pages, as a GPU's pool counts them."""
    return nrs.NaniteMesh.file_info(path)["pages"] * 128 * 1024


def test_opening_reads_nothing(path) -> None:
    mesh = nrs.NaniteMesh.open(path)
    assert mesh.nbytes < 0.05 * mesh.file_info(path)["bytes"] * 3
    assert len(mesh) == mesh.info["faces"] > 290_000
    empty = mesh.nbytes
    coarse = mesh.cut(error=0.02)
    part = mesh.nbytes
    assert empty < part < 0.2 * total_bytes(path)
    assert 0 < len(coarse.faces) < 30_000
    fine = mesh.cut(error=0)
    assert mesh.nbytes > 5 * part
    assert len(fine.faces) == len(mesh)
    whole = nrs.NaniteMesh.open(path)
    whole.check()
    for a, b in ((coarse, whole.cut(error=0.02)), (fine, whole.cut(error=0))):
        assert np.array_equal(a.vertices, b.vertices)
        assert np.array_equal(a.faces, b.faces)
        assert a.error == b.error


def test_settled_pictures_are_those_of_the_whole_mesh(backend, path) -> None:
    whole, stored = scene_of(nrs.NaniteMesh.open(path)), scene_of(nrs.NaniteMesh.open(path))
    with (
        nrs.Renderer(*SIZE, backend=backend) as plain,
        nrs.Renderer(*SIZE, backend=backend, streaming=True, pool_bytes=total_bytes(path)) as streamed,
    ):
        for pose in flight(10):
            for options in ({}, {"occlusion": False, "pixel_error": 0.5}):
                expected = plain.render(whole, LENS, pose, **options)
                frame = streamed.render(stored, LENS, pose, **options)
                assert expected.stats.stream is None
                assert frame.stats.stream.settled
                assert frame.stats.stream.read_errors == 0
                same(frame, expected)
        resident = frame.stats.stream.resident_pages
        assert resident < nrs.NaniteMesh.file_info(path)["pages"]
        # Depth alone, and several views.
        depth = streamed.render(stored, LENS, pose, depth_only=True)
        assert np.array_equal(depth.depth, plain.render(whole, LENS, pose).depth)
        views = [(LENS, at(0, 0, 3)), (LENS, at(0.5, 0, 2))]
        for a, b in zip(streamed.render_views(stored, views), plain.render_views(whole, views), strict=True):
            same(a, b)


def test_scans_settle(backend, tmp_path) -> None:
    scan = data.scan("bunny")
    nrs.NaniteMesh.from_arrays(scan.vertices, scan.faces, progress=False).save(tmp_path / "bunny.nanite")
    mesh = nrs.NaniteMesh.open(tmp_path / "bunny.nanite")
    low, high = mesh.bounds
    center, size = (low + high) / 2, float(np.linalg.norm(high - low))
    with (
        nrs.Renderer(*SIZE, backend=backend) as plain,
        nrs.Renderer(*SIZE, backend=backend, streaming=True) as streamed,
    ):
        for eye in ((0, 0, 1.2), (0.5, 0.2, 0.4), (-0.6, 0.5, -0.6)):
            pose = look_at(center + size * np.array(eye), center)
            frame = streamed.render(scene_of(mesh), LENS, pose)
            assert frame.stats.stream.settled
            same(frame, plain.render(scene_of(mesh), LENS, pose))


def test_a_long_flight_with_little_room(backend, path) -> None:
    """With a seventh of what the path wants: frames come at once, say what they lack, and memory stays flat."""
    with nrs.Renderer(*SIZE, backend=backend, streaming=True) as large:
        stored = scene_of(nrs.NaniteMesh.open(path))
        for pose in flight(60):
            wanted = large.render(stored, LENS, pose, pixel_error=0.2).stats.stream.pool_bytes
    pool = max(wanted // 7, 4 * 128 * 1024)
    stored = scene_of(nrs.NaniteMesh.open(path))
    missing = arrived = evicted = refused = 0
    held = 0
    with nrs.Renderer(*SIZE, backend=backend, streaming=True, pool_bytes=pool) as renderer:
        for i, pose in enumerate(flight(FRAMES)):
            frame = renderer.render(stored, LENS, pose, pixel_error=0.2, wait=False)
            stream = frame.stats.stream
            assert stream.pool_bytes <= pool
            assert stream.draws == 1
            assert frame.stats.covered_pixels > 0
            # What is coarser than it should be is missed, and only then.
            assert (stream.coarsest_pixels > 0.2) == (stream.coarsest_pixels > 0.0)
            assert stream.missing_pages >= (stream.coarsest_pixels > 0.0)
            missing += stream.missing_pages
            arrived += stream.arrived_pages
            evicted += stream.evicted_pages
            refused += stream.refused_pages
            if i == FRAMES // 5 and Path("/proc/self/statm").exists():
                held = memory.resident()
        if held:
            assert memory.resident() < held + (32 << 20)
        assert min(missing, arrived, evicted, refused) > 0
        assert stream.read_errors == 0
        # At rest, what has room is there soon, and then nothing comes or goes.
        quiet = frames = 0
        while quiet < 20 and frames < 5000:
            stream = renderer.render(stored, LENS, pose, pixel_error=0.2, wait=False).stats.stream
            still = (stream.arrived_pages, stream.evicted_pages) == (0, 0)
            quiet = quiet + 1 if still and stream.missing_pages == stream.refused_pages else 0
            frames += 1
        assert quiet == 20
        # From far away all of it has room, and comes.
        frame = renderer.render(stored, LENS, at(0, 0, 60))
        assert frame.stats.stream.settled
    print(f"{backend}: {FRAMES} frames, pool of {pool:,} bytes of {wanted:,} wanted")
    print(f"{arrived} pages arrived, {evicted} left, {refused} refused")


def test_holding_still_brings_all_that_is_missing(backend, path) -> None:
    stored = scene_of(nrs.NaniteMesh.open(path))
    pose = at(0, 0, 2)
    with (
        nrs.Renderer(*SIZE, backend=backend) as plain,
        nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer,
    ):
        frame, frames = renderer.render(stored, LENS, pose, wait=False), 1
        assert not frame.stats.stream.settled
        while not frame.stats.stream.settled and frames < 5000:
            frame, frames = renderer.render(stored, LENS, pose, wait=False), frames + 1
        assert frames < 5000
        same(frame, plain.render(scene_of(nrs.NaniteMesh.open(path)), LENS, pose))


def copy_of(path: Path, folder: Path) -> Path:
    target = folder / "copy.nanite"
    target.write_bytes(path.read_bytes())
    return target


def test_a_damaged_page_costs_detail_and_is_told_once(backend, path, tmp_path) -> None:
    damaged = copy_of(path, tmp_path)
    blob = bytearray(damaged.read_bytes())
    for place in (0.6, 0.7, 0.8, 0.9):
        blob[int(place * len(blob))] ^= 16
    damaged.write_bytes(blob)
    stored = scene_of(nrs.NaniteMesh.open(damaged))
    with nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer:
        poses = [look_at(1.5 * np.array([np.cos(k), 0.0, np.sin(k)]), (0, 0, 0)) for k in range(8)]
        with pytest.warns(nrs.StreamWarning, match="checksum") as told:
            frames = [renderer.render(stored, LENS, pose, pixel_error=0.1) for pose in poses]
        frame, pose = frames[-1], poses[-1]
        assert all(frame.stats.covered_pixels > 20_000 for frame in frames)
        messages = {str(warning.message) for warning in told}
        assert len(messages) == len(told) == frame.stats.stream.read_errors
        assert all("copy.nanite" in message for message in messages)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            renderer.render(stored, LENS, pose, pixel_error=0.1)
    with nrs.Renderer(*SIZE, backend=backend) as plain, pytest.raises(nrs.FormatError, match="page"):
        plain.render(stored, LENS, pose)


def test_a_repaired_file_heals(backend, path, tmp_path) -> None:
    damaged = copy_of(path, tmp_path)
    good = damaged.read_bytes()
    blob = bytearray(good)
    for place in np.linspace(0.5, 0.95, 40):
        blob[int(place * len(blob))] ^= 16
    damaged.write_bytes(blob)
    stored = scene_of(nrs.NaniteMesh.open(damaged))
    with (
        nrs.Renderer(*SIZE, backend=backend) as plain,
        nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer,
    ):
        with pytest.warns(nrs.StreamWarning, match="checksum"):
            frame = renderer.render(stored, LENS, at(0, 0, 2), pixel_error=0.1)
        assert not frame.stats.stream.settled
        damaged.write_bytes(good)
        for _ in range(200):
            frame = renderer.render(stored, LENS, at(0, 0, 2), pixel_error=0.1)
            if frame.stats.stream.settled:
                break
            time.sleep(0.02)
        same(frame, plain.render(stored, LENS, at(0, 0, 2), pixel_error=0.1))


def test_a_file_cut_short_underneath(backend, path, tmp_path) -> None:
    short = copy_of(path, tmp_path)
    stored = scene_of(nrs.NaniteMesh.open(short))
    with nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer:
        renderer.render(stored, LENS, at(0, 0, 9))
        os.truncate(short, short.stat().st_size // 3)
        with pytest.warns(nrs.StreamWarning, match=r"copy\.nanite"):
            frame = renderer.render(stored, LENS, at(0, 0, 1.6), pixel_error=0.2)
        assert frame.stats.covered_pixels > 20_000
        assert frame.stats.stream.read_errors > 0
    target = copy_of(path, tmp_path)
    mesh = nrs.NaniteMesh.open(target)
    os.truncate(target, target.stat().st_size // 3)
    with pytest.raises(nrs.FileError, match=r"copy\.nanite"):
        mesh.check()


def test_a_file_replaced_underneath_goes_on_as_it_was(backend, path, tmp_path) -> None:
    target = copy_of(path, tmp_path)
    stored = scene_of(nrs.NaniteMesh.open(target))
    nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=320), progress=False).save(target)
    with (
        nrs.Renderer(*SIZE, backend=backend) as plain,
        nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer,
    ):
        frame = renderer.render(stored, LENS, at(0, 0, 2))
        same(frame, plain.render(scene_of(nrs.NaniteMesh.open(path)), LENS, at(0, 0, 2)))


def test_arguments_are_checked(path) -> None:
    with pytest.raises(nrs.DtypeError, match="pool_bytes"):
        nrs.Renderer(8, 8, streaming=True, pool_bytes=1.5)
    with pytest.raises(nrs.ArgumentError, match="pool_bytes"):
        nrs.Renderer(8, 8, streaming=True, pool_bytes=-1)
    with (
        nrs.Renderer(8, 8, backend="cpu", streaming=True, pool_bytes=10) as renderer,
        pytest.raises(nrs.ArgumentError, match="pool_bytes: the pool has 10 bytes"),
    ):
        renderer.render(scene_of(nrs.NaniteMesh.open(path)), LENS, at(0, 0, 3))


def test_what_streaming_did_is_told(backend, path) -> None:
    stored = scene_of(nrs.NaniteMesh.open(path))
    with nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer:
        first = renderer.render(stored, LENS, at(0, 0, 3), wait=False).stats
        assert first.stream.missing_pages > 0
        assert not first.stream.settled
        then = renderer.render(stored, LENS, at(0, 0, 3)).stats
    assert then.stream.settled
    assert then.stream.arrived_pages > 0
    assert "missing" in str(then)
    assert then.as_dict()["stream_resident_pages"] == then.stream.resident_pages
    # Meshes that were built lie in memory: nothing of them is streamed.
    built = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=5000), progress=False)
    with nrs.Renderer(*SIZE, backend=backend, streaming=True, pool_bytes=0) as renderer:
        stream = renderer.render(scene_of(built), LENS, at(0, 0, 3)).stats.stream
        assert (stream.needed_pages, stream.resident_pages, stream.settled) == (0, 0, True)
