"""The field's words: no file, public name, shader head or heading has what only this project called so."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import nanite_rs as nrs

ROOT = Path(__file__).resolve().parents[2]
WORDS = dict(
    line.split(": ")
    for line in (ROOT / "tests/vocabulary.txt").read_text().splitlines()
    if line and not line.startswith("#")
)


def parts(name: str) -> str:
    """The parts of a name or of prose in lower case, with a space around each."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return f" {' '.join(re.findall(r'[a-z0-9]+', split.lower()))} "


def private(name: str) -> list[str]:
    return [f"{name!r}: say {say}" for word, say in WORDS.items() if f" {word} " in parts(name)]


def files() -> list[str]:
    folders = ("src", "shaders", "python", "docs", "tests", "benchmarks", "tools", "notebooks")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    return [path.relative_to(ROOT).as_posix() for path in found if "__pycache__" not in path.parts]


def rust_items() -> list[str]:
    item = re.compile(
        r"^\s*pub (?:const |unsafe )*(?:fn|struct|enum|trait|mod|const|static|type) (\w+)", re.M
    )
    return [name for path in (ROOT / "src").rglob("*.rs") for name in item.findall(path.read_text())]


def python_names() -> list[str]:
    out = [name for name in vars(nrs) if not name.startswith("_")]
    for kind in {value for value in vars(nrs).values() if inspect.isclass(value)}:
        out += [f"{kind.__name__}.{name}" for name in dir(kind) if not name.startswith("_")]
        out += [f"{kind.__name__}.{name}" for name in getattr(kind, "__annotations__", {})]
    for function in (value for value in vars(nrs).values() if inspect.isfunction(value)):
        out += [f"{function.__name__}({name})" for name in inspect.signature(function).parameters]
    return out


def shader_heads() -> list[str]:
    heads = []
    for path in (ROOT / "shaders").rglob("*.wgsl"):
        head = re.match(r"(?://[^\n]*\n)+", path.read_text())
        assert head, f"{path.name} says nothing of itself"
        heads.append(head[0])
    return heads


def headings() -> list[str]:
    guides = [*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")]
    lines = (line for path in guides for line in path.read_text().splitlines())
    return [line for line in lines if re.match(r"#+ ", line)]


@pytest.mark.parametrize("collect", [files, rust_items, python_names, shader_heads, headings])
def test_names_are_the_fields(collect) -> None:
    names = collect()
    assert len(names) > 40
    assert [found for name in names for found in private(name)] == []


def test_parts_of_names_are_found() -> None:
    assert private("shared/put_off.wgsl")
    assert private("PutOffList")
    assert private("View::two_phase")
    assert not private("phases_of_the_moon")
    assert not private("offput")
    assert not private("unmasked")


def test_kernels_say_what_an_invocation_handles() -> None:
    for path in (ROOT / "shaders").glob("*.wgsl"):
        head = re.match(r"(?://[^\n]*\n)+", path.read_text())[0]
        assert re.search(r"[Oo]ne (invocation|workgroup)|an instance for each", head), path.name
        assert "// Reads" in head, path.name
