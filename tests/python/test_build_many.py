"""Builds of many files, and of blocks, on threads, processes and a cluster: some fail, some lose a worker."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs import cli

if TYPE_CHECKING:
    import numpy as np

#: Too little for the knot: it is built in blocks, as few as show something.
LITTLE = 1 << 20
SPAWN = multiprocessing.get_context("spawn")


def arrays() -> tuple[np.ndarray, np.ndarray]:
    return nrs.shapes.torus_knot(faces=25_000)


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> bytes:
    """The knot as it is built in blocks, one after the other."""
    path = tmp_path_factory.mktemp("expected") / "knot.nanite"
    nrs.build_file(arrays(), path, memory=LITTLE)
    return path.read_bytes()


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, processes=True, threads_per_worker=1, dashboard_address=None
    )
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        yield client


@pytest.fixture
def folder(tmp_path) -> Path:
    """Three balls, a file of which nothing can be made, and the name of one that is not there."""
    for k in range(3):
        trimesh.creation.icosphere(subdivisions=3, radius=k + 1.0).export(tmp_path / f"ball{k}.ply")
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    return tmp_path


NAMES = ("ball0.ply", "bad.obj", "ball1.ply", "none.ply", "ball2.ply")


def check(results: nrs.BuildResults, folder: Path) -> None:
    """Balls are built as by `build_file`, and each failure is that of its source."""
    assert [Path(result.source).name for result in results] == list(NAMES)
    assert [Path(result.source).name for result in results.failed] == ["bad.obj", "none.ply"]
    for result in results:
        assert Path(result.path).name == f"{Path(result.source).stem}.nanite"
        assert os.path.exists(result.path) == (result.error is None)
        assert result.seconds > 0
        if result.error is None:
            nrs.build_file(folder / result.source, folder / "alone.nanite")
            assert Path(result.path).read_bytes() == (folder / "alone.nanite").read_bytes()
            assert (result.faces, result.file_bytes) == (1280, os.path.getsize(result.path))
    assert results[1].error.startswith("FormatError: ")
    assert results[3].error.startswith("MissingFileError: ")
    assert "none.ply" in results[3].error


def left(folder: Path) -> set[str]:
    """What is in a folder, besides sources and files that were built."""
    return {p.name for p in folder.iterdir() if p.suffix not in (".ply", ".obj", ".nanite")}


def test_one_failure_stops_no_other(folder) -> None:
    steps: list[tuple[int, int]] = []
    results = nrs.build_many(
        [folder / name for name in NAMES], progress=lambda done, total: steps.append((done, total))
    )
    check(results, folder)
    assert steps == [(k, 5) for k in range(1, 6)]
    assert not left(folder)
    assert repr(results) == "BuildResults(3 built, 0 skipped, 2 failed)"
    lines = str(results).splitlines()
    assert len(lines) == 8
    assert lines[0].split() == ["source", "faces", "size", "time", "result"]
    assert f"failed: {results[1].error}" in lines[3]
    assert "1,280" in lines[2]
    assert results._repr_html_().count("<tr>") == 6


def test_threads_and_processes_build_the_same(folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    for executor in (ThreadPoolExecutor(2), ProcessPoolExecutor(2, SPAWN)):
        with executor:
            # Names are those of this process, wherever others are.
            check(nrs.build_many(NAMES, "built/deep", executor=executor), folder)
        assert left(folder) == {"built"}
        assert not left(folder / "built" / "deep")


def test_folders_that_are_not_there_are_failures_too(folder) -> None:
    nowhere = folder / "none" / "x.ply"
    with ThreadPoolExecutor(1) as executor:
        results = nrs.build_many([nowhere, folder / "ball0.ply"], executor=executor)
        assert [result.error is None for result in results] == [False, True]
        assert nrs.build_many([nowhere], executor=executor)[0].error.startswith("FileError: ")
    assert not left(folder)


def test_files_that_are_there_are_left(folder) -> None:
    sources = [folder / f"ball{k}.ply" for k in range(2)]
    nrs.build_many(sources[:1])
    before = (folder / "ball0.nanite").stat()
    results = nrs.build_many(sources, existing="skip")
    assert (folder / "ball0.nanite").stat().st_ino == before.st_ino
    assert [result.skipped for result in results] == [True, False]
    assert [result.faces for result in results] == [1280, 1280]
    assert "was there" in str(results)
    nrs.build_many(sources)
    assert (folder / "ball0.nanite").stat().st_ino != before.st_ino


def test_clashes_of_names_build_nothing(folder) -> None:
    (folder / "sub").mkdir()
    for twin in ("ball0.obj", "sub/ball0.ply", "ball0.ply.gz", "ball0.ply"):
        with pytest.raises(
            nrs.ArgumentError, match=r"ball0\.ply and .*ball0.* would both be .*ball0\.nanite"
        ):
            nrs.build_many([folder / "ball1.ply", folder / "ball0.ply", folder / twin], folder / "built")
    assert not (folder / "built").exists()
    assert not nrs.build_many([folder / "ball0.ply", folder / "sub" / "ball0.ply"])[0].error


def test_bad_arguments_say_what_is_wrong(folder) -> None:
    source = [folder / "ball0.ply"]
    for given, error, match in (
        ({"memory": "much"}, nrs.ArgumentError, "memory"),
        ({"options": {}}, nrs.ArgumentError, "options"),
        ({"existing": "keep"}, nrs.ArgumentError, "existing"),
        ({"resume": 1}, nrs.DtypeError, "resume"),
        ({"executor": map}, nrs.DtypeError, "expected one with submit"),
        ({"executor": 1, "client": 2}, nrs.ArgumentError, "give one"),
        ({"folder": folder / "ball0.ply" / "x"}, nrs.FileError, "ball0"),
    ):
        with pytest.raises(error, match=match):
            nrs.build_many(source, **given)
    for sources in ("ball0.ply", Path("ball0.ply")):
        with pytest.raises(nrs.DtypeError, match="expected several paths"):
            nrs.build_many(sources)
    assert nrs.build_many([]) == ()
    nrs.build_many(source)
    assert "is built already" in nrs.build_many([folder / "ball0.nanite"])[0].error


class Stop(Exception):
    pass


@pytest.mark.parametrize("error", [Stop, KeyboardInterrupt])
@pytest.mark.parametrize("threads", [0, 1])
def test_an_interrupt_stops_all(threads, error, folder) -> None:
    sources = [folder / f"ball{k}.ply" for k in range(3)]

    def stop(done, total):
        raise error

    executor = ThreadPoolExecutor(threads) if threads else None
    with pytest.raises(error):
        nrs.build_many(sources, executor=executor, progress=stop)
    if executor is not None:
        executor.shutdown()
    assert (folder / "ball0.nanite").exists()
    assert not (folder / "ball2.nanite").exists()
    assert not left(folder)


def test_progress_of_blocks_on_executors(tmp_path, expected) -> None:
    steps: dict[bool, list[int]] = {False: [], True: []}
    for pool, seen in steps.items():
        with ThreadPoolExecutor(2) as executor:
            nrs.build_file(
                arrays(),
                tmp_path / "x.nanite",
                memory=LITTLE,
                executor=executor if pool else None,
                progress=lambda done, _, seen=seen: seen.append(done),
            )
        assert seen == sorted(seen)
        assert (tmp_path / "x.nanite").read_bytes() == expected
    assert len(set(steps[True])) > 5
    assert max(steps[True]) == max(steps[False])


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_workers_find_folders_by_any_name(tmp_path, monkeypatch, expected) -> None:
    """What was read in pieces lies in the work folder, and is not written again while it is mapped."""
    vertices, faces = arrays()
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    monkeypatch.chdir(tmp_path / "real")
    for path in ("../real/x.nanite", tmp_path / "link" / "x.nanite"):
        with ThreadPoolExecutor(1) as executor:
            nrs.build_file([(vertices, faces)], path, memory=LITTLE, executor=executor)
        assert Path("x.nanite").read_bytes() == expected
        Path("x.nanite").unlink()


def test_blocks_that_run_are_cancelled(tmp_path) -> None:
    def stop(done, total):
        raise Stop

    with ThreadPoolExecutor(2) as executor:
        with pytest.raises(Stop):
            nrs.build_file(
                arrays(), tmp_path / "x.nanite", memory=LITTLE, executor=executor, progress=stop, resume=True
            )
        # Nothing runs, nothing waits, and nothing says that it is wanted.
        start = time.perf_counter()
        executor.submit(int).result()
        assert time.perf_counter() - start < 5
        found = sorted((tmp_path / "x.nanite.work").rglob("*"))
        assert not [path for path in found if "wanted" in path.name]
    assert found == sorted((tmp_path / "x.nanite.work").rglob("*"))


def test_a_broken_pool_says_how_to_go_on(tmp_path, expected) -> None:
    def kill(done, total):
        if list((tmp_path / "x.nanite.work").rglob("*.made")):
            os.kill(next(iter(executor._processes)), signal.SIGKILL)

    build = {"source": arrays(), "path": tmp_path / "x.nanite", "memory": LITTLE}
    for resume in (False, True):
        match = "a worker was lost.*the same call goes on" if resume else "with resume=True finished blocks"
        with ProcessPoolExecutor(2, SPAWN) as executor, pytest.raises(nrs.WorkerError, match=match):
            nrs.build_file(**build, executor=executor, progress=kill, resume=resume)
        assert (tmp_path / "x.nanite.work").exists() == resume
    made = {path.name: path.stat().st_ino for path in (tmp_path / "x.nanite.work").rglob("*.made")}
    assert made

    class Watching(ThreadPoolExecutor):
        def submit(self, *task):
            now = {path.name: path.stat().st_ino for path in (tmp_path / "x.nanite.work").rglob("*.made")}
            assert made.items() <= now.items()
            return super().submit(*task)

    with Watching(1) as executor:
        nrs.build_file(**build, executor=executor, resume=True)
    assert (tmp_path / "x.nanite").read_bytes() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["x.nanite"]


def test_a_broken_pool_fails_what_it_did_not_build(folder) -> None:
    def kill(done, total):
        if done == 1:
            os.kill(next(iter(executor._processes)), signal.SIGKILL)

    sources = [folder / f"ball{k}.ply" for k in range(3)]
    with ProcessPoolExecutor(1, SPAWN) as executor:
        results = nrs.build_many(sources, executor=executor, progress=kill)
    assert results[0].error is None
    assert results[2].error.startswith("WorkerError: a worker was lost")
    with ThreadPoolExecutor(1) as executor:
        again = nrs.build_many(sources, executor=executor, existing="skip")
    assert not again.failed
    assert again[0].skipped
    assert not left(folder)


def test_work_of_others_is_not_gone_on_with(tmp_path) -> None:
    """A task whose folder is not there, and one that is repeated after its stage, say so."""

    tasks: list[tuple] = []

    class Keeping(ThreadPoolExecutor):
        def submit(self, *task):
            tasks.append(task)
            return super().submit(*task)

    with Keeping(1) as executor:
        nrs.build_file(arrays(), tmp_path / "x.nanite", memory=LITTLE, executor=executor)
        function, *arguments = tasks[0]
        with pytest.raises(nrs.FileError, match="all workers must share"):
            function(*arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["x.nanite"]


def test_asynchronous_clients_are_refused(tmp_path) -> None:
    class Client:
        asynchronous = True

        def get_executor(self, **_):
            raise AssertionError

    with pytest.raises(nrs.ArgumentError, match="asynchronous=False"):
        nrs.build_file(arrays(), tmp_path / "x.nanite", executor=Client())


def test_a_cluster_builds_the_same(client, folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    check(nrs.build_many(NAMES, client=client), folder)
    assert not left(folder)


@pytest.mark.parametrize("repeated", [True, False])
def test_a_cluster_repeats_the_blocks_of_a_killed_worker(repeated, client, tmp_path, expected) -> None:
    def allow(failures, dask_scheduler):
        dask_scheduler.allowed_failures = failures

    client.wait_for_workers(2)
    client.run_on_scheduler(allow, 3 if repeated else 0)
    pids = client.run(os.getpid)
    killed: list[str] = []

    def kill(done, total):
        """Kill a worker that makes a block: one that is stopped is in the midst of what the scheduler knows of."""
        for address, pid in pids.items():
            if done and not killed:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(0.3)
                tasks = [key for key in client.processing().get(address, ()) if "make_block" in str(key)]
                if tasks:
                    killed.append(address)
                os.kill(pid, signal.SIGKILL if tasks else signal.SIGCONT)

    build = {"source": arrays(), "path": tmp_path / "x.nanite", "memory": LITTLE, "executor": client}
    if not repeated:
        with pytest.raises(nrs.WorkerError, match=r"a worker was lost: Attempted to run.*with resume=True"):
            nrs.build_file(**build, progress=kill)
        client.run_on_scheduler(allow, 3)
        assert killed
        assert not list(tmp_path.iterdir())
        return
    mesh = nrs.build_file(**build, progress=kill)
    assert killed
    assert mesh.check().borders > 0
    assert (tmp_path / "x.nanite").read_bytes() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["x.nanite"]


def test_a_cluster_stops_when_a_build_does(client, tmp_path) -> None:
    def stop(done, total):
        if done:
            raise Stop

    with pytest.raises(Stop):
        nrs.build_file(arrays(), tmp_path / "x.nanite", memory=LITTLE, executor=client, progress=stop)
    assert not list(tmp_path.iterdir())
    client.wait_for_workers(2)
    assert client.submit(int, pure=False).result(timeout=20) == 0
    assert not list(tmp_path.iterdir())


def test_the_command_builds_all_and_prints_a_table(folder, monkeypatch, capsys) -> None:
    monkeypatch.chdir(folder)
    assert cli.main(["build", *NAMES, "-o", "built", "--check"]) == 1
    out = capsys.readouterr().out
    assert "failed: FormatError" in out
    assert out.splitlines()[-1] == "BuildResults(3 built, 0 skipped, 2 failed)"
    assert {path.name for path in (folder / "built").iterdir()} == {f"ball{k}.nanite" for k in range(3)}
    assert cli.main(["build", "ball0.ply", "ball1.ply", "-o", "built", "--skip-existing"]) == 0
    assert "2 skipped" in capsys.readouterr().out
    # A pattern may find one file.
    assert cli.main(["build", "ball0.ply", "-o", "one/", "-q"]) == 0
    assert capsys.readouterr().out == ""
    assert (folder / "one" / "ball0.nanite").exists()
    for arguments, match in (
        (["ball0.ply", "ball1.ply", "-o", "x.nanite"], "built into a folder"),
        (["ball0.ply", "shape:soup:100"], "is built alone"),
        (["ball0.ply", "ball0.ply"], "would both be"),
    ):
        assert cli.main(["build", *arguments]) == 1
        assert match in capsys.readouterr().err


def test_the_command_builds_on_a_cluster(client, folder, monkeypatch, capsys, expected) -> None:
    monkeypatch.chdir(folder)
    scheduler = ["--scheduler", client.scheduler.address]
    assert cli.main(["build", "ball0.ply", "none.ply", "ball1.ply", "-o", "built", *scheduler]) == 1
    assert "2 built, 0 skipped, 1 failed" in capsys.readouterr().out
    vertices, faces = arrays()
    trimesh.Trimesh(vertices, faces, process=False).export("knot.ply")
    assert cli.main(["build", "knot.ply", "-o", "knot.nanite", "--memory", str(LITTLE), *scheduler]) == 0
    assert "knot.nanite: NaniteMesh" in capsys.readouterr().out
    assert Path("knot.nanite").stat().st_size > len(expected) // 2


def test_a_cluster_that_is_not_there(folder, monkeypatch, capsys) -> None:
    pytest.importorskip("distributed")
    command = ["build", str(folder / "ball0.ply"), "-o", f"{folder}/", "--scheduler"]
    assert cli.main([*command, "tcp:/nowhere"]) == 1
    assert capsys.readouterr().err.startswith("nanite-rs: --scheduler tcp:/nowhere: ")
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.main([*command, "tcp://127.0.0.1:1"]) == 1
    assert "pip install 'nanite_rs[dask]'" in capsys.readouterr().err
    assert not (folder / "ball0.nanite").exists()
