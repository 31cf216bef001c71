"""Tiles whose folder is in a store: the same files, and the tileset comes last."""

from __future__ import annotations

import pytest

import nanite_rs as nrs
from nanite_rs._tiles import target

pytest.importorskip("fsspec")
pytest.importorskip("obstore")
pytest.importorskip("moto.server")

from oracles.store import Store

FOLDER = "s3://meshes/scans/ball"


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
    monkeypatch.setattr(target.tempfile, "tempdir", str(folder))
    yield
    assert not list(folder.iterdir())


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000), progress=False)


def content(store) -> dict[str, bytes]:
    names = store.client.list_objects_v2(Bucket=store.bucket)["Contents"]
    read = lambda key: store.client.get_object(Bucket=store.bucket, Key=key)["Body"].read()  # noqa: E731
    return {row["Key"].removeprefix("scans/ball/"): read(row["Key"]) for row in names}


def test_a_bucket_has_the_files_of_a_folder(store, mesh, tmp_path) -> None:
    how = {"triangles": 2_000, "preview": True}
    mesh.to_3dtiles(tmp_path / "t", **how)
    report = mesh.to_3dtiles(FOLDER, storage_options=store.options, workers=3, **how)
    assert report.path == f"{FOLDER}/tileset.json"
    root = tmp_path / "t"
    here = {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
    assert content(store) == here


def test_what_is_there_is_replaced_when_asked(store, mesh) -> None:
    mesh.to_3dtiles(FOLDER, triangles=2_000, storage_options=store.options)
    with pytest.raises(nrs.FileError, match="holds a tileset; give overwrite=True"):
        mesh.to_3dtiles(FOLDER, storage_options=store.options)
    before = len(content(store))
    mesh.to_3dtiles(FOLDER, storage_options=store.options, overwrite=True)
    assert set(content(store)) == {"tileset.json", "content/0/0.glb"}
    assert before > 2


def test_a_store_that_refuses_is_an_error_and_leaves_no_tileset(store, mesh) -> None:
    store.weather = lambda request: 403 if request.method == "PUT" else 0
    try:
        with pytest.raises(nrs.FileError):
            mesh.to_3dtiles(FOLDER, triangles=2_000, storage_options=store.options)
    finally:
        store.weather = lambda _: 0
    assert "Contents" not in store.client.list_objects_v2(Bucket=store.bucket)


def test_files_of_fsspec(mesh, tmp_path) -> None:
    mesh.to_3dtiles(tmp_path / "t", triangles=2_000)
    mesh.to_3dtiles(f"file://{tmp_path}/u", triangles=2_000)
    a, b = (
        {str(p.relative_to(r)): p.read_bytes() for p in r.rglob("*") if p.is_file()}
        for r in (tmp_path / "t", tmp_path / "u")
    )
    assert a == b
