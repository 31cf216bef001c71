"""Builds whose work folder is in a store: the same bytes, by workers that share no disk, and on another machine."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs import _work_store, cli

pytest.importorskip("fsspec")
pytest.importorskip("obstore")
pytest.importorskip("moto.server")

from oracles.store import Store

#: Too little for the knot: it is built in blocks, as few as show something.
LITTLE = 1 << 20
FOLDER = "s3://meshes/blocks"


@pytest.fixture(scope="module")
def store():
    with Store() as store:
        yield store


@pytest.fixture(autouse=True)
def clean(store, tmp_path, monkeypatch):
    """An empty bucket, and a folder for temporary files, of which nothing stays."""
    store.clear()
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(_work_store.tempfile, "tempdir", str(folder))
    yield
    assert not list(folder.iterdir())


@pytest.fixture(scope="module")
def knot():
    return nrs.shapes.torus_knot(faces=25_000)


@pytest.fixture(scope="module")
def expected(knot, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("expected") / "knot.nanite"
    nrs.build_file(knot, path, memory=LITTLE)
    return path.read_bytes()


def threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(2)


def processes() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, multiprocessing.get_context("spawn"))


@pytest.mark.parametrize("executor", [None, threads, processes])
def test_a_bucket(store, executor, knot, expected, tmp_path) -> None:
    path = tmp_path / "knot.nanite"
    how = {"memory": LITTLE, "folder": FOLDER, "storage_options": store.options}
    if executor is None:
        nrs.build_file(knot, path, **how)
    else:
        with executor() as workers:
            nrs.build_file(knot, path, executor=workers, **how)
    assert path.read_bytes() == expected
    assert store.names() == []
    assert {path.name for path in tmp_path.iterdir()} == {"knot.nanite", "temporary"}


def test_both_in_a_bucket(store, knot, expected) -> None:
    how = {"memory": LITTLE, "folder": FOLDER, "storage_options": store.options}
    with threads() as workers:
        mesh = nrs.build_file(knot, "s3://meshes/knot.nanite", executor=workers, **how)
    assert len(mesh) == len(knot[1])
    assert store.get("knot.nanite") == expected
    assert store.names() == ["knot.nanite"]


def test_a_file_system_of_fsspec(knot, expected, tmp_path) -> None:
    """That of the disk: what fsspec has in memory is not for several threads."""
    with threads() as workers:
        folder = f"file://{tmp_path}/work"
        nrs.build_file(knot, tmp_path / "knot.nanite", memory=LITTLE, folder=folder, executor=workers)
    assert (tmp_path / "knot.nanite").read_bytes() == expected
    assert not list((tmp_path / "work").iterdir())


@pytest.mark.parametrize("executor", [None, threads])
def test_another_machine_goes_on(store, executor, knot, expected, tmp_path) -> None:
    class Stop(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done > 0.6 * total:
            raise Stop

    how = {"memory": LITTLE, "folder": FOLDER, "storage_options": store.options, "resume": True}
    how["executor"] = None if executor is None else executor()
    with pytest.raises(Stop):
        nrs.build_file(knot, tmp_path / "knot.nanite", progress=stop, **how)
    kept = [name for name in store.names() if name.endswith(".made")]
    assert kept
    # Nothing is on this disk.
    assert {path.name for path in tmp_path.iterdir()} == {"temporary"}
    made = []
    send = _work_store.WorkStore.send

    def counted(self, names) -> None:
        names = list(names)
        made.extend(name for name in names if name.endswith(".made"))
        send(self, names)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_work_store.WorkStore, "send", counted)
        nrs.build_file(knot, tmp_path / "knot.nanite", **how)
    assert made
    assert not set(made) & {name.partition(".work/")[2] for name in kept}
    assert (tmp_path / "knot.nanite").read_bytes() == expected
    assert store.names() == []


def test_the_command(store, knot, expected, tmp_path, monkeypatch, capsys) -> None:
    for name, value in store.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    trimesh.Trimesh(*knot, process=False).export("knot.ply")
    arguments = ["build", "knot.ply", "-o", "knot.nanite", "--memory", str(LITTLE), "--work", FOLDER]
    assert cli.main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert (tmp_path / "knot.nanite").read_bytes() == expected
    assert store.names() == []


def test_what_is_in_the_way_stays(store, knot, tmp_path) -> None:
    store.put("blocks/knot.nanite.work/mine", b"mine")
    how = {"memory": LITTLE, "folder": FOLDER, "storage_options": store.options}
    with pytest.raises(nrs.FileError, match=r"s3://meshes/blocks/knot.nanite.work: in the way"):
        nrs.build_file(knot, tmp_path / "knot.nanite", **how)
    assert store.get("blocks/knot.nanite.work/mine") == b"mine"


def test_folders_that_are_none(store, knot, tmp_path) -> None:
    path = tmp_path / "knot.nanite"
    with pytest.raises(nrs.FileError, match="is read and not written"):
        nrs.build_file(knot, path, folder="https://localhost/work")
    with pytest.raises(nrs.MissingFileError):
        nrs.build_file(knot, path, folder="s3://nowhere/work", storage_options=store.options)
