"""Ctrl-C during long work: in a process of its own, by a real signal."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

import nanite_rs as nrs

if TYPE_CHECKING:
    from pathlib import Path

CODE = """
import signal
import sys
# In the background of a shell SIGINT is ignored, and children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
import nanite_rs as nrs
{prepare}
print("ready", flush=True)
try:
    {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
    {after}
    sys.exit(0)
print("finished", flush=True)
"""

BUILD = CODE.format(
    prepare="v, f = nrs.shapes.displaced_icosphere(faces=4_000_000)",
    work="nrs.NaniteMesh.from_arrays(v, f, progress=False)",
    after="",
)
MEASUREMENT = CODE.format(
    prepare="a, b = nrs.shapes.displaced_icosphere(faces=200_000), nrs.shapes.icosphere(faces=20_000)",
    work="nrs.measure.surface_distance(a, b, samples=2_000_000_000)",
    after="",
)

#: Reads of files end only while the file $HANGS is not there.
HANGING_DISK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <unistd.h>

typedef ssize_t Read(int, void *, size_t, off_t);

ssize_t pread64(int file, void *to, size_t bytes, off_t at) {
    Read *read = (Read *)dlsym(RTLD_NEXT, "pread64");
    while (access(getenv("HANGS"), F_OK) == 0) usleep(1000);
    return read(file, to, bytes, at);
}
"""

#: From far away a picture, then the disk hangs.
OPENED = """
import os
from pathlib import Path
import numpy as np
folder, hangs = Path(os.environ["FOLDER"]), Path(os.environ["HANGS"])
mesh = nrs.NaniteMesh.open(folder / "ball.nanite")
scene = nrs.Scene()
scene.add(mesh)
lens, near, far = nrs.PerspectiveCamera(yfov=0.8), np.eye(4), np.eye(4)
near[2, 3], far[2, 3] = 1.6, 60.0
renderer = nrs.Renderer(160, 120, backend="cpu", streaming={streaming})
if {streaming}:
    renderer.render(scene, lens, far)
hangs.touch()
"""

#: When the disk is well again, so is the renderer.
WELL_AGAIN = """
    hangs.unlink()
    frame = renderer.render(scene, lens, near)
    whole = nrs.Renderer(160, 120, backend="cpu").render(scene, lens, near)
    assert np.array_equal(frame.color, whole.color) and np.array_equal(frame.triangle_id, whole.triangle_id)
    print("drawn", flush=True)
"""


def interrupted(code: str, environment: dict[str, str] | None = None) -> list[str]:
    """What a process prints that gets a Ctrl-C a second after it is ready; it has five more to end."""
    command = [sys.executable, "-c", code]
    environment = {**os.environ, **(environment or {})}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout.readline().strip() == "ready"
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
            start = time.monotonic()
            out, _ = process.communicate(timeout=60)
            assert process.returncode == 0
            assert time.monotonic() - start < 5
            return out.split()
        finally:
            process.kill()


@pytest.mark.parametrize("code", [BUILD, MEASUREMENT], ids=["build", "measurement"])
def test_control_c_stops_long_work_soon(code: str) -> None:
    assert interrupted(code) == ["interrupted"]


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process whose disk hangs when it says so."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("a disk that hangs takes Linux and a C compiler")
    folder = tmp_path_factory.mktemp("disk")
    nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=100_000), progress=False).save(
        folder / "ball.nanite"
    )
    (folder / "disk.c").write_text(HANGING_DISK)
    command = [compiler, "-shared", "-fPIC", "-o", "disk.so", "disk.c", "-ldl"]
    subprocess.run(command, cwd=folder, check=True)
    return {"FOLDER": str(folder), "LD_PRELOAD": str(folder / "disk.so")}


RENDER = "renderer.render(scene, lens, near)"


@pytest.mark.parametrize(
    ("streaming", "work", "after", "prints"),
    [
        (True, RENDER, WELL_AGAIN, ["interrupted", "drawn"]),
        (False, RENDER, WELL_AGAIN, ["interrupted", "drawn"]),
        # The disk does not come back; the process ends none the less.
        (True, RENDER, "", ["interrupted"]),
        (False, "mesh.cut(error=0.001)", "", ["interrupted"]),
        (False, "mesh.cut(target_faces=1000)", "", ["interrupted"]),
        (False, "mesh.check()", "", ["interrupted"]),
        (False, 'mesh.save(folder / "again.nanite")', "", ["interrupted"]),
    ],
    ids=["streaming", "rendering", "leaving", "cut", "faces", "check", "save"],
)
def test_control_c_ends_waiting_for_a_disk(
    disk: dict[str, str], tmp_path: Path, streaming: bool, work: str, after: str, prints: list[str]
) -> None:
    code = CODE.format(prepare=OPENED.format(streaming=streaming), work=work, after=after)
    assert interrupted(code, {**disk, "HANGS": str(tmp_path / "hangs")}) == prints
