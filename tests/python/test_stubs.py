"""The hand-written stub of the compiled module says what is there, and the package type-checks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str) -> None:
    result = subprocess.run(
        [sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_stub_matches_the_module():
    run("mypy.stubtest", "nanite_rs._core", "--ignore-disjoint-bases")


def test_package_type_checks_strictly():
    run("mypy")


def test_users_get_the_types(tmp_path):
    code = (
        "import nanite_rs as nrs\nmesh = nrs.NaniteMesh.open('x')\nreveal_type(mesh.cut(error=0.1).error)\n"
    )
    (tmp_path / "user.py").write_text(code)
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "user.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert 'Revealed type is "float"' in result.stdout.replace("builtins.", ""), result.stdout
    assert result.returncode == 0
