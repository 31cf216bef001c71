"""Meshes that are written to URLs: stores and file systems have the whole file, or what they had."""

from __future__ import annotations

import _thread
import io
import random
import re
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs import _sources, _upload, cli
from oracles.weather import Server, Weather

fsspec = pytest.importorskip("fsspec")
obstore = pytest.importorskip("obstore")
pytest.importorskip("moto.server")
pytestmark = pytest.mark.usefixtures("heed")

from oracles.store import Store, calm  # noqa: E402

URL = "s3://meshes/a/ball.nanite"
KEY = "a/ball.nanite"
S3_LEAST_PART = 5 << 20
# Before, obstore did not drop an upload of which one of the last parts had failed.
DROPS_ALL = tuple(map(int, re.findall(r"\d+", obstore.__version__)[:3])) >= (0, 12, 1)
OLD = b"what was there before"


@pytest.fixture(scope="module")
def store():
    with Store() as store:
        yield store


@pytest.fixture(autouse=True)
def clean(store, tmp_path, monkeypatch):
    """An empty bucket in good weather, small parts, and a folder for temporary files."""
    store.clear()
    monkeypatch.setattr(_upload, "PART", S3_LEAST_PART)
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(_upload.tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000), progress=False)


@pytest.fixture(scope="module")
def big() -> bytes:
    """Three parts: 11 MiB."""
    return random.Random(0).randbytes(11 << 20)


def send(data: bytes, url: str, options: dict | None, **more: object) -> None:
    """Write bytes as meshes are."""
    with _upload.written(url, options, **more) as file:
        file.write_bytes(data)


def impatient(store) -> dict:
    return store.options | {"retry_config": {"max_retries": 0}}


def of_all(status: int):
    """Refuse everything."""
    return lambda _: status


def of_part(number: int, status: int):
    """Refuse a part of an upload."""
    return lambda request: status * (request.query.get("partNumber") == str(number))


def kept(message: str) -> Path:
    """The file that a message says is kept."""
    return Path(message.partition("is kept: ")[2])


# -------------------------------------------------------------------------------------------------- stores


def test_save(store, mesh, clean, tmp_path) -> None:
    mesh.save(URL, storage_options=store.options)
    mesh.save(tmp_path / "ball.nanite")
    assert store.get(KEY) == (tmp_path / "ball.nanite").read_bytes()
    opened = nrs.NaniteMesh.open(URL, storage_options=store.options)
    assert opened == nrs.NaniteMesh.open(tmp_path / "ball.nanite")
    opened.save("s3://meshes/copy.nanite", storage_options=store.options, precision="exact")
    assert nrs.NaniteMesh.open("s3://meshes/copy.nanite", storage_options=store.options) == opened
    assert not list(clean.iterdir())


def test_build_file(store, clean, tmp_path) -> None:
    source = nrs.shapes.icosphere(faces=20_000)
    nrs.build_file(source, tmp_path / "x.nanite", memory="2 MB", progress=False)
    told: list[tuple[int, int]] = []
    built = nrs.build_file(
        source, URL, memory="2 MB", storage_options=store.options, progress=lambda *at: told.append(at)
    )
    assert built.traffic is not None
    assert built == nrs.NaniteMesh.open(tmp_path / "x.nanite")
    assert store.get(KEY) == (tmp_path / "x.nanite").read_bytes()
    assert told[-1] == (len(store.get(KEY)),) * 2
    assert not list(clean.iterdir())
    work = tmp_path / "work"
    work.mkdir()
    options = {"storage_options": store.options, "progress": False}
    nrs.build_file(source, URL, memory="2 MB", folder=work, resume=True, **options)
    assert not list(work.iterdir())
    with pytest.raises(nrs.ArgumentError, match="resume: with a URL, give folder="):
        nrs.build_file(source, URL, resume=True, **options)


def test_several_parts_at_once(store, big, clean) -> None:
    arrived, at_once, lock = threading.Barrier(3, timeout=20), [], threading.Lock()

    def together(request) -> int:
        if "partNumber" in request.query:
            with lock:
                at_once.append(request.query["partNumber"])
            arrived.wait()  # passes when all three are on their way
        return 0

    store.weather = together
    told: list[tuple[int, int]] = []
    send(big, URL, store.options, progress=lambda *at: told.append(at))
    assert store.get(KEY) == big
    assert sorted(at_once) == ["1", "2", "3"]
    assert told[-1] == (len(big), len(big))
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert store.open_uploads() == []
    assert not list(clean.iterdir())


@pytest.mark.parametrize("size", [1, 8 << 20, 80 << 30, (80 << 30) + 1, 5 << 40])
def test_parts_fit_the_limits_of_stores(monkeypatch, size) -> None:
    monkeypatch.setattr(_upload, "PART", 8 << 20)
    part = _upload.part_size(size)
    assert S3_LEAST_PART <= part <= 5 << 30
    assert -(-size // part) <= 10_000


def test_passing_errors_are_tried_again(store, big) -> None:
    seen: set[str] = set()

    def once(request) -> int:
        name = f"{request.method} {request.query.get('partNumber')} {'uploads' in request.query}"
        if name in seen:
            return 0
        seen.add(name)
        return 503

    store.weather = once
    send(big, URL, store.options)
    assert len(seen) >= 5
    assert store.get(KEY) == big


FAILURES = {
    "a part in the middle": (of_part(2, 500), nrs.ServerError, "answered 500"),
    "the last part": (of_part(3, 503), nrs.ServerError, "answered 503"),
    "rights that ended": (of_part(2, 403), nrs.AccessError, r"do not allow writing it \(403"),
    "joining": (
        lambda request: 500 * (request.method == "POST" and "uploadId" in request.query),
        nrs.ServerError,
        "answered 500",
    ),
}


@pytest.mark.parametrize("case", FAILURES)
@pytest.mark.parametrize("at_once", [1, 8])
def test_failures_leave_what_was_there(store, big, monkeypatch, case, at_once) -> None:
    monkeypatch.setattr(_upload, "PARTS_AT_ONCE", at_once)
    rule, kind, message = FAILURES[case]
    store.put(KEY, OLD)
    store.weather = rule
    with pytest.raises(kind, match=message) as caught:
        send(big, URL, impatient(store))
    assert type(caught.value) is kind
    assert str(caught.value).startswith(f"{URL}: ")
    assert kept(str(caught.value)).read_bytes() == big
    store.weather = calm
    assert store.get(KEY) == OLD
    assert store.names() == [KEY]
    if DROPS_ALL:
        assert store.open_uploads() == []


def test_what_is_kept_is_a_mesh(store, mesh) -> None:
    store.weather = lambda request: 500 * (request.method == "PUT")
    with pytest.raises(nrs.ServerError, match="answered 500") as caught:
        nrs.build_file(nrs.shapes.icosphere(faces=2_000), URL, storage_options=impatient(store))
    store.weather = calm
    assert store.names() == []
    rest = nrs.NaniteMesh.open(kept(str(caught.value)))
    rest.save(URL, storage_options=store.options)
    assert nrs.NaniteMesh.open(URL, storage_options=store.options) == rest


def test_an_interrupt_leaves_what_was_there(store, big, monkeypatch) -> None:
    monkeypatch.setattr(_upload, "PARTS_AT_ONCE", 1)
    store.put(KEY, OLD)

    def interrupt(request) -> int:
        if request.query.get("partNumber") == "1":
            _thread.interrupt_main()
            time.sleep(0.3)
        return 0

    store.weather = interrupt
    with (
        pytest.warns(nrs.UsageWarning, match=f"{URL}: not written; .* is kept: ") as warned,
        pytest.raises(KeyboardInterrupt),
    ):
        send(big, URL, store.options)
    assert kept(str(warned[0].message)).read_bytes() == big
    assert "3" not in {request.query.get("partNumber") for request in store.requests}
    assert store.get(KEY) == OLD
    assert store.open_uploads() == []


def test_an_interrupt_that_is_too_late(store, big, clean) -> None:
    """Of what is complete nothing is kept, and nothing said."""
    store.put(KEY, OLD)

    def interrupt(request) -> int:
        if request.method == "POST" and "uploadId" in request.query:
            _thread.interrupt_main()
            time.sleep(0.3)
        return 0

    store.weather = interrupt
    with warnings.catch_warnings(record=True) as warned, pytest.raises(KeyboardInterrupt):
        send(big, URL, store.options)
    assert not warned
    assert store.get(KEY) == big
    assert store.open_uploads() == list(clean.iterdir()) == []


def test_what_stops_a_build_leaves_nothing(store, clean) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nrs.build_file(nrs.shapes.icosphere(faces=200_000), URL, storage_options=store.options, progress=stop)
    assert store.names() == store.open_uploads() == list(clean.iterdir()) == []


# ------------------------------------------------------------------------------------- before anything is built


def never() -> object:
    raise AssertionError("it was built before the URL was tried out")
    yield


def refused(url: str, options: dict | None, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message) as caught:
        nrs.build_file(never(), url, storage_options=options)
    assert type(caught.value) is kind
    assert _sources.shown(url) in str(caught.value)


def test_trying_out_leaves_nothing(store) -> None:
    store.put(KEY, OLD)
    store.requests.clear()
    with pytest.raises(AssertionError, match="before the URL"):
        nrs.build_file(never(), URL, storage_options=store.options)
    assert [request.method for request in store.requests] == ["POST", "DELETE"]
    assert store.get(KEY) == OLD
    assert store.open_uploads() == []


def test_an_interrupt_while_trying_out(store, clean) -> None:
    """It does not wait for a server that says nothing; what was begun is dropped all the same."""

    def slow(request) -> int:
        if request.method == "POST":
            _thread.interrupt_main()
            time.sleep(1.0)
        return 0

    store.weather = slow
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        nrs.build_file(never(), URL, storage_options=store.options)
    assert time.perf_counter() - start < 0.8
    while [request.method for request in store.requests] != ["POST", "DELETE"]:
        time.sleep(0.02)
        assert time.perf_counter() - start < 20
    assert store.open_uploads() == list(clean.iterdir()) == []


def test_refusals_come_before_building(store, clean, monkeypatch) -> None:
    absent = "there is no such bucket or container"
    refused("s3://nowhere/x.nanite", store.options, nrs.MissingFileError, absent)
    store.weather = of_all(403)
    refused(URL, store.options, nrs.AccessError, r"do not allow writing it \(403")
    store.weather = of_all(503)
    refused(URL, impatient(store), nrs.ServerError, "answered 503")
    gone = impatient(store) | {"endpoint": "http://127.0.0.1:9"}
    refused(URL, gone, nrs.ServerError, "error sending request")
    for name in store.environment:
        monkeypatch.delenv(name, raising=False)
    nobody = {"region": "us-east-1", "metadata_endpoint": "http://127.0.0.1:9"}
    refused(URL, nobody, nrs.AccessError, "no credentials were found")
    refused(URL, {"no_such_option": "1"}, nrs.FileError, "no_such_option")
    refused("s3://meshes", None, nrs.FormatError, "must end in .nanite")
    refused("nosuch://x/y.nanite", None, nrs.FileError, "nosuch")
    for scheme in ("http", "https"):
        refused(f"{scheme}://me:secret@host/x.nanite?sig=secret", None, nrs.FileError, "read and not written")
    with pytest.raises(nrs.DtypeError, match="storage_options: expected a mapping"):
        nrs.build_file(never(), URL, storage_options=[1])
    with pytest.raises(nrs.ArgumentError, match="storage_options: goes with a URL"):
        nrs.build_file(never(), "x.nanite", storage_options={})
    store.weather = calm
    with pytest.raises(nrs.FileError, match="none"):
        nrs.build_file(never(), URL, storage_options=store.options, folder=clean / "none")
    assert not list(clean.iterdir())


def test_saving_refuses_what_it_cannot_write(store, mesh) -> None:
    with pytest.raises(nrs.FormatError, match=r"s3://meshes/x.ply\?a=1: save writes .nanite files"):
        mesh.save("s3://meshes/x.ply?a=1&sig=secret", storage_options=store.options)
    with pytest.raises(nrs.ArgumentError, match="names a bucket and no file"):
        mesh.save("s3://meshes/", storage_options=store.options)
    with pytest.raises(nrs.ArgumentError, match="storage_options: goes with a URL"):
        mesh.save("x.nanite", storage_options={})


@pytest.mark.parametrize(
    ("module", "url", "install"),
    [("obstore", URL, "nanite_rs[cloud]"), ("fsspec", "memory://b.nanite", "fsspec")],
)
def test_missing_libraries(monkeypatch, mesh, module, url, install) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(nrs.DependencyError) as caught:
        mesh.save(url)
    assert install in str(caught.value)
    assert url in str(caught.value)


@pytest.mark.parametrize("threads", [0, 2])
def test_many_files_into_a_bucket(store, threads, tmp_path) -> None:
    for k in range(2):
        trimesh.creation.icosphere(subdivisions=3, radius=k + 1.0).export(tmp_path / f"ball{k}.ply")
    sources = [tmp_path / name for name in ("ball0.ply", "none.ply", "ball1.ply")]
    executor = ThreadPoolExecutor(threads) if threads else None
    how = {"storage_options": store.options, "executor": executor, "existing": "skip"}
    results = nrs.build_many(sources, "s3://meshes/built", **how)
    assert [result.source for result in results.failed] == [str(sources[1])]
    assert [result.path for result in results] == [
        f"s3://meshes/built/{name}.nanite" for name in ("ball0", "none", "ball1")
    ]
    for result in (results[0], results[2]):
        nrs.build_file(result.source, tmp_path / "alone.nanite")
        expected = (tmp_path / "alone.nanite").read_bytes()
        assert store.get(result.path.partition("meshes/")[2]) == expected
        assert (result.faces, result.file_bytes, result.skipped) == (1280, len(expected), False)
    again = nrs.build_many(sources, "s3://meshes/built/", **how)
    assert [result.skipped for result in again] == [True, False, True]
    with pytest.raises(nrs.ArgumentError, match="resume: with a URL"):
        nrs.build_many(sources, "s3://meshes/built", resume=True)
    with pytest.raises(nrs.ArgumentError, match="would both be s3://meshes/built/ball0"):
        nrs.build_many([sources[0]] * 2, "s3://meshes/built", **how)


# -------------------------------------------------------------------------------------------- file systems


@pytest.fixture
def memory():
    files = fsspec.filesystem("memory")
    files.store.clear()
    yield files
    files.store.clear()


def test_fsspec(memory, mesh, tmp_path) -> None:
    mesh.save("memory://a/ball.nanite")
    mesh.save(tmp_path / "ball.nanite")
    assert memory.cat("/a/ball.nanite") == (tmp_path / "ball.nanite").read_bytes()
    built = nrs.build_file(nrs.shapes.icosphere(faces=2_000), "memory://a/ball.nanite", progress=False)
    assert len(built.cut(error=0.0)) == len(built)


def test_fsspec_leaves_what_was_there(memory, big, monkeypatch) -> None:
    memory.pipe("/ball.nanite", OLD)
    kind, seen = fsspec.implementations.memory.MemoryFile, []

    def write(self, data: bytes) -> int:
        seen.append(memory.cat("/ball.nanite"))
        if len(seen) == 2:
            _thread.interrupt_main()
            time.sleep(0.3)
        return io.BytesIO.write(self, data)

    monkeypatch.setattr(kind, "write", write, raising=False)
    with pytest.warns(nrs.UsageWarning, match="is kept: "), pytest.raises(KeyboardInterrupt):
        send(big, "memory://ball.nanite", None)
    assert seen == [OLD, OLD]
    assert memory.cat("/ball.nanite") == OLD

    def refuse(self, data: bytes) -> int:
        raise PermissionError("only to look at")

    monkeypatch.setattr(kind, "write", refuse)
    with pytest.raises(nrs.AccessError, match=r"memory://ball.nanite: writing is not allowed: .*kept: "):
        send(big, "memory://ball.nanite", None)
    assert memory.cat("/ball.nanite") == OLD


@pytest.mark.parametrize("url", [URL, "memory://ball.nanite"])
def test_progress_may_stop_it(store, memory, big, url) -> None:
    def stop(done: int, total: int) -> None:
        raise LookupError("enough")

    def slow(_) -> int:
        time.sleep(0.2)
        return 0

    options = store.options if url == URL else None
    store.weather = slow
    with pytest.warns(nrs.UsageWarning, match="is kept: "), pytest.raises(LookupError, match="enough"):
        send(big * (1 if url == URL else 20), url, options, progress=stop)
    assert store.names() == store.open_uploads() == list(memory.store) == []


def test_files_of_this_machine_are_written_as_those_of_paths(mesh, clean, tmp_path) -> None:
    path = tmp_path / "ball.nanite"
    mesh.save(path.as_uri())
    assert len(nrs.NaniteMesh.open(path)) == len(mesh)
    with pytest.raises(nrs.MissingFileError, match="none"):
        mesh.save((tmp_path / "none" / "x.nanite").as_uri())
    assert not list(clean.iterdir())


# -------------------------------------------------------------------------------------------- command line


@pytest.fixture
def surroundings(store, tmp_path, monkeypatch):
    """Credentials where obstore finds them, and a folder of one's own."""
    for name, value in store.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("memory", [[], ["--memory", "4MB", "--resume"]])
def test_command_line(store, surroundings, clean, capsys, memory) -> None:
    shape = "shape:displaced_icosphere:40000"
    assert cli.main(["build", shape, "-o", URL, "--check", "--quiet", *memory]) == 0
    assert cli.main(["build", shape, "-o", URL, *memory]) == 0
    assert f"{URL}: NaniteMesh(" in capsys.readouterr().out
    assert sorted(surroundings.iterdir()) == [clean]
    assert not list(clean.iterdir())
    assert cli.main(["info", URL, "--check"]) == 0
    out = capsys.readouterr().out
    faces = f"{len(nrs.NaniteMesh.open(URL)):,} faces"
    assert faces in out
    assert "requests" in out
    assert cli.main(["cut", URL, "-o", "small.ply", "--target-faces", "500"]) == 0
    assert 0 < len(nrs.NaniteMesh.from_file("small.ply")) <= 500


def test_command_line_says_what_went_wrong(store, surroundings, clean, capsys) -> None:
    assert cli.main(["build", "none.ply", "-o", "s3://nowhere/x.nanite"]) == 1
    assert "s3://nowhere/x.nanite: there is no such bucket" in capsys.readouterr().err
    assert cli.main(["build", "none.ply", "-o", "https://host/x.nanite"]) == 1
    assert "read and not written" in capsys.readouterr().err
    assert cli.main(["build", "none.ply", "-o", "s3://meshes/x.ply"]) == 1
    assert "must end in .nanite" in capsys.readouterr().err
    assert cli.main(["build", "none.ply", "-o", URL]) == 1
    assert "none.ply" in capsys.readouterr().err
    store.weather = lambda request: 403 * (request.method == "PUT")
    assert cli.main(["build", "shape:displaced_icosphere:2000", "-o", URL]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert len(nrs.NaniteMesh.open(kept(said.strip()))) > 1_000


# ----------------------------------------------------------------------------------------------- opening


@pytest.mark.parametrize("how", [nrs.NaniteMesh.open, nrs.NaniteMesh.file_info])
def test_opening_looks_at_signals(tmp_path, how) -> None:
    """In the second request, too: of a head that is longer than the first."""
    vertices, faces = nrs.shapes.icosphere(faces=2_000)
    path = tmp_path / "x.nanite"
    nrs.NaniteMesh.from_arrays(vertices, faces, channels={"long" * 100_000: vertices[:, 0]}).save(path)
    with Server({"x.nanite": path.read_bytes()}) as server:
        assert how(server.url("x.nanite"))
        assert len(server.requests) == 2
        server.weather = Weather(latency=1.0)
        threading.Timer(1.3, _thread.interrupt_main).start()
        start = time.perf_counter()
        with pytest.raises(KeyboardInterrupt):
            how(server.url("x.nanite"))
        assert time.perf_counter() - start < 1.9
        assert len(server.requests) == 4
