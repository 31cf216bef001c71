"""Meshes that are not on a local disk: servers, stores, file systems and file objects, in all weathers."""

from __future__ import annotations

import _thread
import concurrent.futures
import io
import itertools
import multiprocessing
import os
import pickle
import random
import sys
import threading
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nanite_rs as nrs
from nanite_rs import _core, _page_cache, _remote, _sources, cli
from oracles.camera import look_at
from oracles.weather import Server, Weather

if TYPE_CHECKING:
    from pathlib import Path

SIZE = 320, 240
LENS = nrs.PerspectiveCamera(yfov=0.8)
POSE = look_at((0.0, 0.3, 1.6), (0.0, 0.0, 0.0))
pytest.importorskip("obstore")


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A generated mesh of 200,000 triangles in a file of 3 MB."""
    path = tmp_path_factory.mktemp("remote") / "ball.nanite"
    arrays = nrs.shapes.displaced_icosphere(faces=200_000)
    options = nrs.BuildOptions(quality="fast")
    nrs.NaniteMesh.from_arrays(*arrays, options=options, progress=False).save(path, precision="exact")
    return path


@pytest.fixture(scope="module")
def data(path) -> bytes:
    return path.read_bytes()


@pytest.fixture
def server(data):
    with Server({"ball.nanite": data, "a/b c.nanite": data}) as server:
        yield server


@pytest.fixture
def impatient(monkeypatch) -> None:
    """What goes on failing is an error after less than a tenth of a second."""
    monkeypatch.setattr(_remote, "TRIES", 4)
    monkeypatch.setattr(_remote, "OPENING_TRIES", 4)


def same_cut(a: nrs.Cut, b: nrs.Cut) -> None:
    for name in ("vertices", "faces", "normals", "cluster_ids"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert a.error == b.error


def same_frame(a: nrs.Frame, b: nrs.Frame) -> None:
    for name in ("color", "depth", "normal", "cluster_id", "triangle_id"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def scene_of(mesh: nrs.NaniteMesh) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
    scene.add(mesh)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=look_at((3, 4, 5), (0, 0, 0)))
    return scene


def picture(mesh: nrs.NaniteMesh, pose=POSE, **options) -> nrs.Frame:
    with nrs.Renderer(*SIZE, backend="cpu", streaming=True) as renderer:
        return renderer.render(scene_of(mesh), LENS, pose, **options)


def same_mesh(opened: nrs.NaniteMesh, path: Path) -> None:
    """Cuts and pictures are those of the same file opened by its path."""
    local = nrs.NaniteMesh.open(path)
    assert len(opened) == len(local)
    frame = picture(opened)
    assert frame.stats.stream.settled
    same_frame(frame, picture(local))
    for error in (0.05, 0.005):
        same_cut(opened.cut(error=error), local.cut(error=error))
    assert opened.info == local.info
    assert opened == local


# ---------------------------------------------------------------------------------------------- http


def test_http(server, path) -> None:
    opened = nrs.NaniteMesh.open(server.url("ball.nanite"))
    assert len(server.requests) == 1
    assert opened.traffic.requests == 1
    same_mesh(opened, path)
    assert opened.traffic.requests == len(server.requests)
    assert opened.traffic.failed_requests == 0
    assert opened.traffic.read_bytes == sum(end - start for _, start, end in server.requests)
    assert server.most_at_once <= _remote.AT_ONCE
    assert opened.traffic.latency_ms > 0
    assert "requests" in str(opened.traffic)


def test_names_of_files(server) -> None:
    faces = len(nrs.NaniteMesh.open(server.url("ball.nanite")))
    assert len(nrs.NaniteMesh.open(server.url("a/b%20c.nanite?version=2&X-Amz-Signature=secret"))) == faces
    assert server.paths[-1] == "/a/b%20c.nanite?version=2&X-Amz-Signature=secret"
    with pytest.raises(nrs.MissingFileError) as caught:
        nrs.NaniteMesh.open(server.url("none.nanite?version=2&X-Amz-Signature=secret"))
    assert "none.nanite?version=2:" in str(caught.value)
    assert "secret" not in str(caught.value)
    assert "secret" not in _sources.shown("https://me:secret@host/x?Signature=secret&sig=secret")


def test_a_large_head_takes_a_second_request(server, tmp_path) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    name = "long" * 100_000
    nrs.NaniteMesh.from_arrays(vertices, faces, channels={name: vertices[:, 0]}).save(tmp_path / "x.nanite")
    server.files["x.nanite"] = (tmp_path / "x.nanite").read_bytes()
    mesh = nrs.NaniteMesh.open(server.url("x.nanite"))
    assert len(server.requests) == 2
    cut = mesh.cut(error=0.0)
    assert len(cut) == len(mesh)
    assert np.allclose(cut.channels[name], cut.vertices[:, 0], atol=0.01)


def test_info(server, path, capsys) -> None:
    url = server.url("ball.nanite")
    assert nrs.NaniteMesh.file_info(url) == nrs.NaniteMesh.file_info(path)
    assert len(server.requests) == 1
    assert cli.main(["info", url]) == 0
    out = capsys.readouterr().out
    assert f"{len(nrs.NaniteMesh.open(path)):,} faces" in out
    assert "1 requests" in out
    assert len(server.requests) == 2


def test_a_cut_reads_what_it_needs(server, path, data) -> None:
    local, opened = nrs.NaniteMesh.open(path), nrs.NaniteMesh.open(server.url("ball.nanite"))
    head = opened.traffic.read_bytes
    sizes = [int(size) for size in _core.page_table_of_file(path)["bytes"]]
    for error in (0.02, 0.002, 0.0):
        before, asked = opened.traffic, len(server.requests)
        cut = opened.cut(error=error)
        assert np.array_equal(cut.vertices, local.cut(error=error).vertices)
        read = opened.traffic.read_bytes - before.read_bytes
        joined = opened.traffic.joined_bytes - before.joined_bytes
        # What was read besides gaps is pages, and gaps are a quarter at most.
        assert read <= 1.3 * (read - joined)
        assert len(server.requests) - asked == opened.traffic.requests - before.requests
    assert opened.traffic.requests < 0.5 * len(sizes)
    assert opened.traffic.read_bytes <= head + 1.3 * sum(sizes)


def test_frames_count_requests(server) -> None:
    opened = nrs.NaniteMesh.open(server.url("ball.nanite"))
    server.weather = Weather(latency=0.02)
    scene = scene_of(opened)
    with nrs.Renderer(*SIZE, backend="cpu", streaming=True) as renderer:
        before = opened.traffic
        first = renderer.render(scene, LENS, POSE).stats.stream
        assert first.settled
        assert first.requests == opened.traffic.requests - before.requests > 0
        assert first.read_bytes == opened.traffic.read_bytes - before.read_bytes > 0
        assert first.latency_ms >= 20
        assert "requests" in str(first)
        second = renderer.render(scene, LENS, POSE).stats.stream
        assert (second.requests, second.read_bytes, second.latency_ms) == (0, 0, 0.0)
        assert "requests" not in str(second)
    assert picture(nrs.NaniteMesh.open(server.url("ball.nanite"))).stats.as_dict()["stream_requests"] > 0


def test_frames_that_do_not_wait(server, path) -> None:
    server.weather = Weather(latency=0.1)
    opened = nrs.NaniteMesh.open(server.url("ball.nanite"))
    scene = scene_of(opened)
    with nrs.Renderer(*SIZE, backend="cpu", streaming=True) as renderer:
        first = renderer.render(scene, LENS, POSE, wait=False)
        assert not first.stats.stream.settled
        frames = 1
        while not (frame := renderer.render(scene, LENS, POSE, wait=False)).stats.stream.settled:
            frames += 1
            time.sleep(0.01)
            assert frames < 1_000
    same_frame(frame, picture(nrs.NaniteMesh.open(path)))


def test_many_requests_at_once(server, monkeypatch) -> None:
    monkeypatch.setattr(_remote, "MOST_REQUEST", 1 << 18)
    server.weather = Weather(latency=0.05)
    opened = nrs.NaniteMesh.open(server.url("ball.nanite"))
    opened.cut(error=0.0)
    assert server.most_at_once > 4


# ------------------------------------------------------------------------------------------- weather


def test_passing_errors_pass(server, path) -> None:
    server.weather = Weather(fail_every=5)
    server.requests.append(("", 0, 0))
    opened = nrs.NaniteMesh.open(server.url("ball.nanite"))
    same_mesh(opened, path)
    assert opened.traffic.failed_requests > 0


@pytest.mark.slow
def test_an_outage_of_seconds_loses_nothing(server, path) -> None:
    """Opening waits a second for a server that restarts, cuts and frames three."""
    url = server.url("ball.nanite")
    server.weather = Weather(status=503, until=time.monotonic() + 1.0)
    opened = nrs.NaniteMesh.open(url)
    server.weather = Weather(status=503, until=time.monotonic() + 3.0)
    cut = opened.cut(error=0.0)
    assert time.monotonic() > server.weather.until
    same_cut(cut, nrs.NaniteMesh.open(path).cut(error=0.0))
    opened = nrs.NaniteMesh.open(url)
    server.weather = Weather(status=503, until=time.monotonic() + 3.0)
    before = len(server.requests)
    frame = picture(opened)
    stream = frame.stats.stream
    assert stream.settled
    assert stream.read_errors == 0
    same_frame(frame, picture(nrs.NaniteMesh.open(path)))
    # What failed together is asked for together: a server in trouble does not get a request for each page.
    assert stream.failed_requests < 60
    assert len(server.requests) - before < 80


def test_pauses(monkeypatch) -> None:
    pauses = _core.retry_pauses(_remote.TRIES)
    assert len(pauses) == _remote.TRIES - 1
    assert all(0.005 * 2**k <= pause <= 0.01 * 2**k for k, pause in enumerate(pauses))
    assert 5 < sum(pauses) < 10.3
    assert pauses == _core.retry_pauses(_remote.TRIES)
    assert sum(_core.retry_pauses(_remote.OPENING_TRIES)) < 3


@pytest.mark.slow
@pytest.mark.usefixtures("heed")
def test_opening_is_given_up_during_a_pause(server, data) -> None:
    """Ctrl-C does not wait for a pause."""
    from nanite_rs.mesh import CoreMesh

    class Down:
        name = "down"

        def first(self, _):
            # The rest of the head takes another request.
            return _sources.Identity(len(data), None), data[:1000]

        def read(self, *_):
            raise _sources.Refusal(nrs.ServerError, "down", passing=True)

    reader = _remote.Reader(Down())
    timer = threading.Timer(1.5, _thread.interrupt_main)
    timer.start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        reader.open(CoreMesh.open_input)
    assert time.monotonic() - start < 2.5


def test_opening_is_tried_again(server) -> None:
    server.weather = Weather(status=503, times=3)
    assert nrs.NaniteMesh.open(server.url("ball.nanite")).traffic.failed_requests == 3
    assert len(server.requests) == 4


BAD = {
    "404": (Weather(status=404), nrs.MissingFileError, "404"),
    "403": (Weather(status=403), nrs.AccessError, "expired.*403"),
    "401": (Weather(status=401), nrs.AccessError, "credentials.*401"),
    "400": (Weather(status=400), nrs.ServerError, "answered 400"),
    "503": (Weather(status=503), nrs.ServerError, "answered 503"),
    "no ranges": (Weather(ranges=False), nrs.ServerError, "does not send ranges"),
    "short": (Weather(short=7), nrs.ServerError, "another range|sent"),
    "cut": (Weather(cut=7), nrs.ServerError, "body"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("when", ["opening", "reading"])
@pytest.mark.usefixtures("impatient")
def test_lasting_errors_are_typed(server, case, when) -> None:
    weather, kind, message = BAD[case]
    url = server.url("ball.nanite")
    if when == "opening":
        server.weather = Weather(**vars(weather))
        with pytest.raises(kind, match=message) as caught:
            nrs.NaniteMesh.open(url)
    else:
        mesh = nrs.NaniteMesh.open(url)
        server.weather = Weather(**vars(weather))
        with pytest.raises(kind, match=message) as caught:
            mesh.cut(error=0.001)
        server.weather = Weather()
        assert len(mesh.cut(error=0.001)) > 0
    assert type(caught.value) is kind
    assert str(caught.value).startswith(f"{url}: ")
    assert isinstance(caught.value, nrs.FileError)


@pytest.mark.usefixtures("impatient")
def test_nobody_answers() -> None:
    with Server({}) as server:
        url = server.url("ball.nanite")
    with pytest.raises(nrs.ServerError, match="error sending request"):
        nrs.NaniteMesh.open(url)


@pytest.mark.usefixtures("impatient")
def test_other_things_than_meshes(server) -> None:
    server.files["page.html"] = b"<html></html>" * 100
    server.files["empty"] = b""
    with pytest.raises(nrs.FormatError, match="magic"):
        nrs.NaniteMesh.open(server.url("page.html"))
    with pytest.raises((nrs.FormatError, nrs.ServerError)):
        nrs.NaniteMesh.open(server.url("empty"))


@pytest.mark.parametrize("how", ["if_match", "etag", "time", "size"])
def test_a_file_that_changes_is_an_error(server, path, data, how) -> None:
    calm = {
        "if_match": {},
        "etag": {"if_match": False},
        "time": {"etags": False},
        "size": {"if_match": False},
    }[how]
    server.weather = Weather(**calm)
    url = server.url("ball.nanite")
    mesh = nrs.NaniteMesh.open(url)
    kept = mesh.cut(error=0.05)
    server.change("ball.nanite", data[: len(data) // 2] if how == "size" else data)
    with pytest.raises(nrs.ChangedFileError, match="changed after it was opened") as caught:
        mesh.cut(error=0.0)
    assert str(caught.value).startswith(url)
    assert np.array_equal(mesh.cut(error=0.05).vertices, kept.vertices)
    with pytest.warns(nrs.StreamWarning, match="changed"):
        assert picture(mesh, look_at((0.0, 0.0, 1.1), (0.0, 0.0, 0.0))).stats.stream.read_errors > 0
    if how != "size":
        assert len(nrs.NaniteMesh.open(url).cut(error=0.0)) == len(mesh)


def test_what_nobody_waits_for_is_not_asked_for(server) -> None:
    """A renderer that is closed drops what was not sent yet."""
    mesh = nrs.NaniteMesh.open(server.url("ball.nanite"))
    answers = []

    class Slow:
        name = "slow"

        def first(self, end):
            return mesh._reader.source.first(end)

        def read(self, start, end, expected):
            answers.append(start)
            time.sleep(0.05)
            return mesh._reader.source.read(start, end, expected)

    reader = _remote.Reader(Slow())
    slow = nrs.NaniteMesh._opened(reader)
    scene = scene_of(slow)
    with nrs.Renderer(*SIZE, backend="cpu", streaming=True) as renderer:
        renderer.render(scene, LENS, POSE, wait=False)
        renderer.render(scene, LENS, POSE, wait=False)
    at_close = len(answers)
    time.sleep(0.3)
    assert len(answers) <= at_close + _remote.AT_ONCE


def test_batches_fit_the_line() -> None:
    """They shrink while answers wait for each other, whatever the way there takes, and grow again."""
    for latency in (0.01, 0.5):
        pace = _remote.Pace()

        def after(*begun: float, took: float, pace: _remote.Pace = pace) -> int:
            for at in begun:
                pace.answered(at, at + took)
            return pace.batch

        full = latency + 1.1 * _remote.QUEUED
        assert after(0, 1, 2, took=latency) == 64
        # What was on its way meanwhile counts once.
        assert after(10, 10, 10.1, took=full) == 32
        assert after(20, took=full) == 16
        assert after(30, 40, 50, took=full) == 8
        assert after(*range(60, 100), took=latency) == 64


# --------------------------------------------------------------------------------------------- joining


@given(
    st.lists(st.tuples(st.integers(0, 300_000), st.integers(1, 200_000)), min_size=1, max_size=60),
    st.randoms(),
)
@settings(max_examples=100, deadline=None)
def test_joining(parts: list[tuple[int, int]], order: random.Random) -> None:
    at, ranges = 0, []
    for gap, size in parts:
        ranges.append((at + gap, at + gap + size))
        at = ranges[-1][1]
    order.shuffle(ranges)
    found = _remote.joined(ranges)
    assert sorted(i for one in found for i in one.members) == list(range(len(ranges)))
    wanted = sum(end - start for start, end in ranges)
    assert sum(one.wasted for one in found) <= wanted / 4
    assert sum(one.end - one.start for one in found) == wanted + sum(one.wasted for one in found)
    for one in found:
        assert one.start == ranges[one.members[0]][0]
        assert one.end == ranges[one.members[-1]][1]
        assert len(one.members) == 1 or one.end - one.start <= _remote.MOST_REQUEST
        for a, b in itertools.pairwise(one.members):
            assert 0 <= ranges[b][0] - ranges[a][1] <= _remote.GAP
    firsts = [min(one.members) for one in found]
    assert firsts == sorted(firsts)


@pytest.mark.parametrize("seed", range(5))
def test_answers_arrive_in_any_order(path, data, seed) -> None:
    order = random.Random(seed)

    class Shuffled:
        name = "shuffled"

        def first(self, end):
            return _sources.Identity(len(data), None), data[:end]

        def read(self, start, end, _):
            time.sleep(order.random() * 0.01)
            return data[start:end]

    mesh = nrs.NaniteMesh._opened(_remote.Reader(Shuffled()))
    local = nrs.NaniteMesh.open(path)
    same_frame(picture(mesh), picture(local))
    same_cut(mesh.cut(error=0.002), local.cut(error=0.002))


# ------------------------------------------------------------------------------------------------ cache


def test_cache(server, path, tmp_path) -> None:
    url, folder = server.url("ball.nanite"), tmp_path / "pages"
    first = nrs.NaniteMesh.open(url, cache_dir=folder)
    same_mesh(first, path)
    asked = len(server.requests)
    second = nrs.NaniteMesh.open(url, cache_dir=str(folder))
    same_mesh(second, path)
    assert len(server.requests) == asked + 1
    assert second.traffic.requests == 1
    assert second.traffic.cached_bytes > 0.9 * (first.traffic.read_bytes - first.traffic.joined_bytes) - (
        1 << 18
    )
    assert picture(nrs.NaniteMesh.open(url, cache_dir=folder)).stats.stream.cached_bytes > 0
    # Another file by the same URL is another one in the cache.
    server.change("ball.nanite", server.files["ball.nanite"])
    assert len(nrs.NaniteMesh.open(url, cache_dir=folder).cut(error=0.0)) == len(first)
    assert len(server.requests) > asked + 4
    # Damage is found, and read again.
    for place in folder.rglob("*.range"):
        place.write_bytes(place.read_bytes()[:-9] + b"xxxxxxxxx")
    same_mesh(nrs.NaniteMesh.open(url, cache_dir=folder), path)


def held(folder: Path) -> int:
    return sum(place.stat().st_size for place in folder.rglob("*.*") if place.is_file())


def test_a_cache_keeps_to_its_budget(server, path, tmp_path) -> None:
    budget = 1 << 20
    mesh = nrs.NaniteMesh.open(server.url("ball.nanite"), cache_dir=tmp_path, cache_bytes=budget)
    same_mesh(mesh, path)
    assert 0.4 * budget < held(tmp_path) <= budget
    cache = _page_cache.PageCache(tmp_path / "lru", 1000, ["a"])
    for k in range(8):
        cache.put(100 * k, 100 * k + 96, bytes(96))
        os.utime(cache._place(100 * k, 100 * k + 96), (k, k))
    assert cache.get(0, 96) is not None
    for k in range(8, 12):
        cache.put(100 * k, 100 * k + 96, bytes(96))
    assert cache.get(0, 96) is not None
    assert cache.get(100, 196) is None
    assert held(tmp_path / "lru") <= 1000


def test_processes_share_a_cache(tmp_path) -> None:
    """Threads with caches of their own do what processes do."""
    caches = [_page_cache.PageCache(tmp_path, 20_000, ["a"]) for _ in range(4)]

    def work(k: int) -> int:
        order, found = random.Random(k), 0
        for _ in range(300):
            at = order.randrange(40) * 1000
            data = at.to_bytes(4, "little") * 250
            known = caches[k].get(at, at + 1000)
            assert known in {None, data}
            found += known is not None
            caches[k].put(at, at + 1000, data)
        return found

    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(work, range(4))) > 0
    assert held(tmp_path) <= 20_000 + 4 * 1004
    assert not list(tmp_path.rglob("*.tmp"))


# -------------------------------------------------------------------------------------------- file objects


def test_file_objects(path, data) -> None:
    with path.open("rb") as buffered, path.open("rb", buffering=0) as raw:
        for file in (io.BytesIO(data), buffered, raw, io.BufferedReader(io.BytesIO(data))):
            same_mesh(nrs.NaniteMesh.open(file), path)


def test_nobody_relies_on_the_position(path, data) -> None:
    file = io.BytesIO(data)
    mesh = nrs.NaniteMesh.open(file)
    file.seek(17)
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        cuts = list(pool.map(lambda _: mesh.cut(error=0.01), range(4)))
    same_cut(cuts[3], nrs.NaniteMesh.open(path).cut(error=0.01))


def test_file_objects_that_go_wrong(path, data, tmp_path) -> None:
    with path.open("rb") as file:
        mesh = nrs.NaniteMesh.open(file)
    with pytest.raises(nrs.FileError, match="closed file") as caught:
        mesh.cut(error=0.0)
    assert str(path) in str(caught.value)
    with pytest.raises(nrs.DtypeError, match='"rb"'):
        nrs.NaniteMesh.open(io.StringIO("text" * 100))
    file = io.BytesIO(data)
    mesh = nrs.NaniteMesh.open(file)
    file.truncate(len(data) // 2)
    with pytest.raises(nrs.ChangedFileError, match=r"<BytesIO>.*changed"):
        mesh.cut(error=0.0)
    copy = tmp_path / "copy.nanite"
    copy.write_bytes(data)
    with copy.open("rb") as file:
        mesh = nrs.NaniteMesh.open(file)
        with copy.open("r+b") as other:
            other.seek(len(data) // 2)
            other.write(bytes(1000))
        with pytest.raises(nrs.ChangedFileError):
            mesh.cut(error=0.0)
    with pytest.raises(
        nrs.DtypeError, match=r"path: expected a path, a URL or a binary file|path: expected a path"
    ):
        nrs.NaniteMesh.open(7)
    with pytest.raises(nrs.ArgumentError, match="cache_dir: goes with a URL"):
        nrs.NaniteMesh.open(path, cache_dir=tmp_path)
    with pytest.raises(nrs.ArgumentError, match="cache_dir: goes with a URL"):
        nrs.NaniteMesh.open(io.BytesIO(data), cache_dir=tmp_path)
    with pytest.raises(nrs.DtypeError, match="storage_options: expected a mapping"):
        nrs.NaniteMesh.open("https://example.org/x.nanite", storage_options=[1])


# -------------------------------------------------------------------------------------------------- fsspec


def test_fsspec(path, data) -> None:
    fsspec = pytest.importorskip("fsspec")
    files = fsspec.filesystem("memory")
    with files.open("/a/ball.nanite", "wb") as file:
        file.write(data)
    mesh = nrs.NaniteMesh.open("memory://a/ball.nanite")
    same_mesh(mesh, path)
    mesh = nrs.NaniteMesh.open("memory://a/ball.nanite")
    with files.open("/a/ball.nanite", "wb") as file:
        file.write(data)
    with pytest.raises(nrs.ChangedFileError, match=r"memory://a/ball.nanite: the file changed"):
        mesh.cut(error=0.0)
    with pytest.raises(nrs.MissingFileError, match=r"memory://none.nanite"):
        nrs.NaniteMesh.open("memory://none.nanite")
    with pytest.raises(nrs.NaniteError, match="nosuch"):
        nrs.NaniteMesh.open("nosuch://x.nanite")
    same_mesh(nrs.NaniteMesh.open(path.as_uri()), path)


@pytest.mark.parametrize(
    ("module", "url", "install"),
    [("obstore", "s3://a/b.nanite", "nanite_rs[cloud]"), ("fsspec", "sftp://a/b", "fsspec")],
)
def test_missing_libraries(monkeypatch, module, url, install) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(nrs.DependencyError) as caught:
        nrs.NaniteMesh.open(url)
    assert install in str(caught.value)
    assert url in str(caught.value)


# ------------------------------------------------------------------------------------------------------ S3


@pytest.fixture
def store(data):
    pytest.importorskip("moto.server")
    from oracles.store import Store

    with Store() as store:
        store.put("a/ball.nanite", data)
        yield store


def test_s3(store, path, data, tmp_path) -> None:
    url, options = "s3://meshes/a/ball.nanite", store.options
    mesh = nrs.NaniteMesh.open(url, storage_options=options, cache_dir=tmp_path)
    assert mesh.traffic.requests == 1
    same_mesh(mesh, path)
    with pytest.raises(nrs.MissingFileError, match=r"s3://meshes/none.nanite: there is no such file"):
        nrs.NaniteMesh.open("s3://meshes/none.nanite", storage_options=options)
    mesh = nrs.NaniteMesh.open(url, storage_options=options)
    store.put("a/ball.nanite", data[:-1] + b"x")
    with pytest.raises(nrs.ChangedFileError, match=r"s3://meshes/a/ball.nanite: the file changed"):
        mesh.cut(error=0.0)
    assert "secret" not in repr(mesh)


def test_without_credentials(store, monkeypatch) -> None:
    """What obstore asks where nothing else has any is not there."""
    for name in store.environment:
        monkeypatch.delenv(name, raising=False)
    nobody = {"region": "us-east-1", "metadata_endpoint": "http://127.0.0.1:9"}
    with pytest.raises(nrs.AccessError, match=r"s3://meshes/a/ball.nanite: no credentials were found"):
        nrs.NaniteMesh.open("s3://meshes/a/ball.nanite", storage_options=nobody)


def test_options_that_obstore_does_not_know() -> None:
    with pytest.raises(nrs.FileError, match=r"s3://a/b.nanite: "):
        nrs.NaniteMesh.open("s3://a/b.nanite", storage_options={"no_such_option": "1"})
    # obstore panics.
    with pytest.raises(nrs.FileError, match=r"s3://a/b\.nanite: "):
        nrs.NaniteMesh.open("s3://a/b.nanite", storage_options={"timeout": "5s"})


# ------------------------------------------------------------------------------------------------- processes


def sizes(mesh: nrs.NaniteMesh) -> tuple[int, int]:
    return len(mesh.cut(error=0.0)), mesh.traffic.requests


def test_meshes_travel_by_their_url(server, path, data) -> None:
    mesh = nrs.NaniteMesh.open(server.url("ball.nanite"))
    pickled = pickle.dumps(mesh)
    assert len(pickled) < 2_000
    assert len(server.requests) == 1
    same_mesh(pickle.loads(pickled), path)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        faces, requests = pool.apply(sizes, (mesh,))
    assert faces == len(mesh)
    assert requests > 1
    server.change("ball.nanite", data)
    with pytest.raises(nrs.ChangedFileError, match="changed after it was opened"):
        pickle.loads(pickled)
    of_file = nrs.NaniteMesh.open(io.BytesIO(data))
    assert len(pickle.dumps(of_file)) > 0.9 * len(data)
    assert pickle.loads(pickle.dumps(of_file)) == nrs.NaniteMesh.open(path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_forked_processes_say_what_to_do(server, path, data) -> None:
    mesh, of_file = nrs.NaniteMesh.open(server.url("ball.nanite")), nrs.NaniteMesh.open(io.BytesIO(data))
    with path.open("rb") as file:
        plain = nrs.NaniteMesh.open(file)
        found = [forked(lambda mesh=mesh: len(mesh.cut(error=0.0))) for mesh in (mesh, of_file, plain)]
    assert found[0].startswith("ForkError"), found
    assert '"spawn"' in found[0], found
    assert found[1:] == [str(len(mesh))] * 2


def forked(work) -> str:
    """What work returns in a forked process."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            said = str(work())
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        os.write(sender, said.encode())
        os._exit(0)
    os.close(sender)
    timer = threading.Timer(20, os.kill, (child, 9))
    timer.start()
    with os.fdopen(receiver, "rb") as pipe:
        said = pipe.read().decode()
    os.waitpid(child, 0)
    timer.cancel()
    return said
