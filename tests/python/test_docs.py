"""The guides are true: their examples run, their links lead somewhere, and the reference has every public name."""

from __future__ import annotations

import importlib
import pkgutil
import re
import warnings
from pathlib import Path

import pytest

import nanite_rs as nrs
from nanite_rs import cli

ROOT = Path(__file__).resolve().parents[2]
GUIDES = sorted((ROOT / "docs").glob("*.md"))
REFERENCE = sorted((ROOT / "docs" / "reference").glob("*.rst"))
PAGES = [
    *GUIDES,
    ROOT / "README.md",
    ROOT / "ARCHITECTURE.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "benchmarks" / "README.md",
]


def code(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("path", [p for p in PAGES if code(p)], ids=lambda p: p.stem)
def test_code_runs(path, tmp_path, monkeypatch):
    """The blocks of a page run in order, as one script, without a warning of ours."""
    monkeypatch.chdir(tmp_path)
    # What README begins with.
    knot = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=20_000))
    knot.cut(error=0.0).export("dragon.ply")
    names: dict[str, object] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        for block in code(path):
            exec(compile(block, path.name, "exec"), names)


def test_guides_have_code():
    assert {"build", "cut", "render", "gpu", "materials", "streaming", "README"} <= {
        p.stem for p in PAGES if code(p)
    }


def anchors(path: Path) -> set[str]:
    """Targets of headings, as GitHub and MyST name them."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(path):
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), f"{path.name}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{path.name}: {link}"


def documented() -> set[str]:
    """Whole names of what the pages of the reference document."""
    names = set()
    for path in REFERENCE:
        module = ""
        for kind, name in re.findall(r"^\.\. (\w+):: (\S+)$", path.read_text(encoding="utf-8"), re.MULTILINE):
            if kind in ("currentmodule", "automodule"):
                module = name
                names |= {name} if kind == "automodule" else set()
            else:
                assert kind in ("autoclass", "autoexception", "autofunction", "autodata"), (
                    f"{path.name}: {kind}"
                )
                names.add(f"{module}.{name}")
    return names


def public() -> set[str]:
    """Whole names of all that users may import: what the package exports, and what only its modules do."""
    names = set()
    for name in nrs.__all__:
        value = getattr(nrs, name)
        if type(value).__name__ == "module":
            own = (n for n in value.__all__ if getattr(nrs, n, None) is not getattr(value, n))
            names |= {value.__name__} | {f"{value.__name__}.{n}" for n in own}
        elif name != "__version__":
            names.add(f"nanite_rs.{name}")
    return names


def test_reference_has_every_public_name_and_no_other():
    assert documented() == public()


def test_no_public_module_is_forgotten():
    """What a module without an underscore exports is to be had from the package, from a module that it exports,
    or named here."""
    behind = {"nanite_rs.cli", "nanite_rs.io"}
    reachable = {id(getattr(nrs, name)) for name in nrs.__all__}
    for found in pkgutil.iter_modules(nrs.__path__, "nanite_rs."):
        if found.name.rpartition(".")[2].startswith("_") or found.name in behind:
            continue
        module = importlib.import_module(found.name)
        if id(module) in reachable:
            continue
        classes = [
            n for n in module.__all__ if callable(getattr(module, n)) or isinstance(getattr(module, n), type)
        ]
        for name in classes:
            assert id(getattr(module, name)) in reachable, (
                f"{found.name}.{name} is in no page of docs/reference"
            )


def test_reference_has_every_command(capsys):
    assert cli.main(["--help"]) == 0
    commands = re.findall(
        r"^    (\w+) {2,}\S", capsys.readouterr().out.partition("COMMAND\n")[2], re.MULTILINE
    )
    text = (ROOT / "docs" / "reference" / "command-line.rst").read_text(encoding="utf-8")
    assert commands
    assert re.findall(r"^\.\. command-help:: (\w+)$", text, re.MULTILINE) == commands


def test_front_page_leads_to_every_page():
    trees = re.findall(r"```\{toctree\}\n(.*?)```", (ROOT / "docs" / "index.md").read_text(), re.DOTALL)
    entries = {line.rstrip(">").rpartition("<")[2] for tree in trees for line in tree.splitlines()}
    for path in [*GUIDES, *REFERENCE]:
        name = str(path.relative_to(ROOT / "docs").with_suffix(""))
        assert name in entries or name == "index", f"docs/index.md does not lead to {name}"
