"""A process that is killed while it saves: the target is the old file or the new one, whole.

``make soak`` kills 200 of them. The signal cannot be caught, so nothing can be cleaned up either: what a killed
process leaves is one temporary file beside the target, as the docstring of ``save`` says.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

import nanite_rs as nrs

if TYPE_CHECKING:
    from pathlib import Path

KILLS = 200 if os.environ.get("NANITE_SOAK") else 12
# Of the time that saving takes: some processes have to be past it, also where the machine got slower meanwhile.
LATEST = 1.4

SAVE = """
import sys
import nanite_rs as nrs
mesh = nrs.NaniteMesh.open(sys.argv[1])
print("ready", flush=True)
mesh.save(sys.argv[2])
print("saved", flush=True)
sys.stdin.read()
"""


def saver(source: Path, target: Path) -> subprocess.Popen[bytes]:
    """A process that is about to save the one file over the other."""
    command = [sys.executable, "-c", SAVE, str(source), str(target)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"ready\n"
    return process


def end(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL; on Windows, its like."""
    process.kill()
    process.communicate()
    assert process.returncode != 0


@pytest.fixture(scope="module")
def versions(tmp_path_factory) -> dict[str, Path]:
    """Two files that differ in everything, the new one large enough to take a tenth of a second."""
    folder = tmp_path_factory.mktemp("versions")
    out = {"old": folder / "old.nanite", "new": folder / "new.nanite"}
    for path, faces in zip(out.values(), (50_000, 400_000), strict=True):
        vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces)
        nrs.NaniteMesh.from_arrays(vertices, triangles, progress=False).save(path)
        nrs.NaniteMesh.open(path).check()
    return out


def seconds_to_save(source: Path, target: Path) -> float:
    """From the last word of a process before it saves to the first one after it, the median of three."""
    seconds = []
    for _ in range(3):
        process = saver(source, target)
        start = time.perf_counter()
        assert process.stdout.readline() == b"saved\n"
        seconds.append(time.perf_counter() - start)
        end(process)
        # Saving gives the same bytes whichever process does it: without that, nothing below could be compared.
        assert target.read_bytes() == source.read_bytes()
    return sorted(seconds)[1]


def test_a_killed_save_leaves_the_old_file_or_the_new_one(versions, tmp_path) -> None:
    old, new = versions["old"].read_bytes(), versions["new"].read_bytes()
    target = tmp_path / "mesh.nanite"
    takes = seconds_to_save(versions["new"], target)
    rng = random.Random(12)
    found = {"old": 0, "new": 0}
    left = 0
    for kill in range(KILLS):
        target.write_bytes(old)
        process = saver(versions["new"], target)
        # At random, but every stretch of the time has its turn.
        time.sleep(takes * LATEST * (kill + rng.random()) / KILLS)
        end(process)
        data = target.read_bytes()
        assert data in (old, new), f"kill {kill}: {len(data)} bytes, neither {len(old)} nor {len(new)}"
        found["new" if data == new else "old"] += 1
        others = [path for path in tmp_path.iterdir() if path != target]
        assert all(p.name.startswith(".nanite-") and p.suffix == ".tmp" for p in others), others
        # A rename leaves no temporary file behind, and one process makes no second one.
        assert len(others) <= (data == old), others
        left += len(others)
        for path in others:
            path.unlink()
    print(f"\n{KILLS} kills within {takes * LATEST:.3f} s: {found}, {left} temporary files left")
    if KILLS >= 200:
        assert min(found.values()) > 0
        assert left > 0


def test_what_a_killed_save_leaves_is_in_nobodys_way(versions, tmp_path) -> None:
    """The next save succeeds beside such a file, and leaves it alone: it may be another process's."""
    target, stray = tmp_path / "mesh.nanite", tmp_path / ".nanite-stray0.tmp"
    stray.write_bytes(b"half a file")
    nrs.NaniteMesh.open(versions["old"]).save(target)
    assert target.read_bytes() == versions["old"].read_bytes()
    assert sorted(tmp_path.iterdir()) == [stray, target]
    assert stray.read_bytes() == b"half a file"
