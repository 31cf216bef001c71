"""Meshes with a URL of a server that many use."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import nanite_rs as nrs

if TYPE_CHECKING:
    from collections.abc import Iterator

pytest.importorskip("obstore")

#: Where `make test` puts it.
FETCHED = Path(__file__).resolve().parents[2] / "target" / "nginx" / "usr" / "sbin"
NGINX = shutil.which("nginx", path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", str(FETCHED)]))
pytestmark = pytest.mark.skipif(NGINX is None, reason="nginx is not installed; tools/nginx fetches it")

CONFIGURATION = """
daemon off; master_process off;
pid {folder}/pid; error_log {folder}/errors;
events {{}}
http {{
    access_log {folder}/requests;
    client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
    uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
    server {{
        listen 127.0.0.1:{port};
        root {folder}/files;
        location /compressed/ {{ alias {folder}/files/; gzip on; gzip_types *; gzip_min_length 1; }}
        location /slow/ {{ alias {folder}/files/; limit_rate 400k; }}
        location /whole/ {{ alias {folder}/files/; max_ranges 0; }}
        location /untagged/ {{ alias {folder}/files/; etag off; }}
        location /closed/ {{ deny all; }}
        location /moved/ {{ rewrite ^/moved/(.*)$ /$1 redirect; }}
    }}
}}
"""


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=100_000), progress=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, mesh) -> Path:
    folder = tmp_path_factory.mktemp("nginx")
    (folder / "files").mkdir()
    mesh.save(folder / "files" / "sphere.nanite")
    return folder


@pytest.fixture(scope="module")
def url(folder) -> Iterator[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (folder / "nginx.conf").write_text(CONFIGURATION.format(folder=folder, port=port))
    command = [str(NGINX), "-p", str(folder), "-c", str(folder / "nginx.conf"), "-e", str(folder / "errors")]
    with subprocess.Popen(command) as server:
        for _ in range(200):
            with socket.socket() as asked:
                if asked.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert server.poll() is None, (folder / "errors").read_text()
            time.sleep(0.05)
        yield f"http://127.0.0.1:{port}"
        server.terminate()


@pytest.mark.parametrize("place", ["", "compressed/", "slow/", "untagged/", "moved/"])
def test_cuts_are_those_of_the_local_file(url, folder, place) -> None:
    local = nrs.NaniteMesh.open(folder / "files" / "sphere.nanite")
    far = nrs.NaniteMesh.open(f"{url}/{place}sphere.nanite")
    for error in (0.01, 0.0):
        ours, theirs = far.cut(error=error), local.cut(error=error)
        assert np.array_equal(ours.vertices, theirs.vertices)
        assert np.array_equal(ours.faces, theirs.faces)
    assert far.traffic.failed_requests == 0
    assert far.check() == local.check()


def test_what_is_counted_is_what_the_server_sent(url, folder) -> None:
    log = folder / "requests"
    before = len(log.read_text().splitlines())
    far = nrs.NaniteMesh.open(f"{url}/sphere.nanite")
    far.cut(target_faces=2_000)
    time.sleep(0.2)
    lines = [line.split('"')[2].split() for line in log.read_text().splitlines()[before:]]
    assert far.traffic.requests == len(lines)
    assert all(status == "206" for status, _ in lines)
    assert far.traffic.read_bytes == sum(int(size) for _, size in lines)


def test_pictures_are_those_of_the_local_file(url, folder) -> None:
    camera, pose = nrs.PerspectiveCamera(yfov=0.8), np.eye(4)
    pose[2, 3] = 3.0
    colors = []
    for where in (folder / "files" / "sphere.nanite", f"{url}/slow/sphere.nanite"):
        scene = nrs.Scene(ambient_light=(1, 1, 1))
        scene.add(nrs.NaniteMesh.open(where))
        with nrs.Renderer(160, 120, backend="cpu", streaming=True, pool_bytes=8 << 20) as renderer:
            colors.append(renderer.render(scene, camera, pose).color)
    assert np.array_equal(*colors)


@pytest.mark.parametrize("place", ["", "untagged/"])
def test_a_file_that_changes_is_an_error(url, folder, mesh, place) -> None:
    path = folder / "files" / f"changing{len(place)}.nanite"
    mesh.save(path)
    far = nrs.NaniteMesh.open(f"{url}/{place}{path.name}")
    nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=100_000), progress=False).save(path)
    # Without tags it is the time that tells, of which servers say whole seconds.
    os.utime(path, (0, path.stat().st_mtime + 10))
    with pytest.raises(nrs.ChangedFileError, match="the file changed after it was opened"):
        far.cut(error=0.0)


@pytest.mark.parametrize(
    ("place", "error", "match"),
    [
        ("none/", nrs.MissingFileError, "404"),
        ("closed/", nrs.AccessError, "403"),
        ("whole/", nrs.ServerError, "ranges"),
    ],
)
def test_errors_are_typed(url, place, error, match) -> None:
    with pytest.raises(error, match=match):
        nrs.NaniteMesh.open(f"{url}/{place}sphere.nanite").cut(error=0.0)
