"""Things that must agree between files: versions, requirements, commands, names."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import nanite_rs as nrs
from conftest import SOAKED
from nanite_rs import exceptions

ROOT = Path(__file__).resolve().parents[2]


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_one_version():
    cargo = re.search(r'^version = "(.*)"', read("Cargo.toml"), re.MULTILINE)
    assert cargo is not None
    assert nrs.__version__ == cargo[1]
    assert f"## {cargo[1]}" in read("CHANGELOG.md")


@pytest.mark.parametrize("name", [name for name in exceptions.__all__ if not name.endswith("Warning")])
def test_errors_have_two_bases(name):
    error = getattr(exceptions, name)
    assert issubclass(error, exceptions.NaniteError)
    assert getattr(nrs, name) is error
    if name != "NaniteError":
        builtin = (ValueError, TypeError, OSError, RuntimeError, ImportError)
        assert issubclass(error, builtin)


def test_every_make_target_is_documented():
    makefile = read("Makefile")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    phony = set(re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[1].split())
    assert phony <= targets
    for target in ("demo", "test", "lint", "docs", "bench", "soak", "clean"):
        assert f"make {target}" in makefile.split("SHELL :=")[0]
    for target in ("demo", "test"):
        assert f"make {target}" in read("README.md")


def test_what_is_left_to_soak_is_there():
    for file, tests in SOAKED.items():
        text = read(f"tests/python/test_{file}.py")
        for test in set(tests) - {"*"}:
            assert f"\ndef {test}(" in text, f"{file}: {test}"


def test_requirements_are_pinned():
    for name in ("build", "test", "docs", "pyrender", "error"):
        for line in read(f"requirements/{name}.txt").splitlines():
            if line and not line.startswith(("#", "-r")):
                assert re.match(r"^[\w.-]+==[\w.]+( *;.*)?$", line), f"{name}.txt: {line}"


def test_architecture_names_every_module():
    text = read("ARCHITECTURE.md")
    for path in (ROOT / "src").iterdir():
        if path.is_dir() and any(path.glob("*.rs")):
            assert f"`{path.name}/`" in text, f"ARCHITECTURE.md does not mention src/{path.name}/"
    for path in (ROOT / "python" / "nanite_rs").glob("*.py"):
        if not path.name.startswith("_"):
            assert f"`{path.name}`" in text, f"ARCHITECTURE.md does not mention python/nanite_rs/{path.name}"


def test_import_is_quick_and_quiet():
    """What costs time is imported when it is needed."""
    late = ("trimesh", "PIL", "scipy", "OpenImageIO", "matplotlib", "rendercanvas", "IPython", "tqdm")
    late += ("obstore", "fsspec")
    code = f"import sys, nanite_rs; print([m for m in {late} if m in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"
    assert result.stderr == ""


def test_no_machine_paths_in_the_sources():
    names = []
    if shutil.which("git"):
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
        names = [name for name in listed.stdout.split() if (ROOT / name).exists()]
    if not names:
        names = [str(p.relative_to(ROOT)) for p in (ROOT / "python").rglob("*.py")]
    bad = re.compile(r"(?<![\w.])/(work|root|home)/[a-z]")
    for name in names:
        path = ROOT / name
        if path.suffix in {".py", ".rs", ".md", ".toml", ".txt", ".pyi"} or path.name in {"Makefile", "run"}:
            for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
                assert not bad.search(line), f"{name}:{number}: {line}"
