"""Imports among the files of the package point one way, those inside functions too."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import nanite_rs as nrs

FOLDER = Path(nrs.__file__).parent
PACKAGE = "nanite_rs"


def _module(path: Path) -> str:
    """The name of a module within the package; that of a folder for its ``__init__``."""
    parts = path.relative_to(FOLDER).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


# The compiled module has no file here; it imports nothing but `exceptions`, by name.
MODULES = {_module(path) for path in FOLDER.rglob("*.py")} | {"_core"}


def _of_types(node: ast.AST) -> bool:
    """Whether it is an ``if TYPE_CHECKING:``, and not an ``if not``."""
    if not isinstance(node, ast.If) or not isinstance(node.test, ast.Name | ast.Attribute):
        return False
    return ast.unparse(node.test).endswith("TYPE_CHECKING")


def _names(node: ast.AST) -> list[str]:
    """Dotted names of the modules that a statement may import, and those of readers, which are strings."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        origin = ".".join(filter(None, [PACKAGE if node.level else "", node.module]))
        return [f"{origin}.{alias.name}" for alias in node.names]
    if isinstance(node, ast.Constant) and re.fullmatch(rf"{PACKAGE}\.\w+", str(node.value)):
        return [str(node.value)]
    return []


def imported(source: str) -> set[str]:
    """Modules of the package that a file imports anywhere, except for type checkers alone."""
    found, todo = set(), [ast.parse(source)]
    while todo:
        node = todo.pop()
        for name in _names(node):
            package, *rest = name.split(".")
            if package == PACKAGE:
                # The longest of its beginnings that is a module.
                known = [module for k in range(len(rest), 0, -1) if (module := ".".join(rest[:k])) in MODULES]
                found.add(known[0] if known else "__init__")
        todo += node.orelse if _of_types(node) else ast.iter_child_nodes(node)
    return found


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """The first cycle, from a module back to itself; empty where there is none."""
    done: set[str] = set()

    def walk(path: list[str]) -> list[str]:
        for used in sorted(graph.get(path[-1], ())):
            if used in path:
                return [*path[path.index(used) :], used]
            if used not in done and (found := walk([*path, used])):
                return found
        done.add(path[-1])
        return []

    for module in sorted(graph):
        if module not in done and (found := walk([module])):
            return found
    return []


def test_no_import_cycle() -> None:
    graph = {_module(path): imported(path.read_text(encoding="utf-8")) for path in FOLDER.rglob("*.py")}
    assert sum(map(len, graph.values())) > 150, "the test reads the imports of the package"
    assert not (found := cycle(graph)), " imports ".join(found)


def test_a_cycle_would_be_seen() -> None:
    assert imported("from nanite_rs._tiles import of_mesh\nimport nanite_rs._tiles.write") == {
        "_tiles.of_mesh",
        "_tiles.write",
    }
    assert imported("from nanite_rs._tiles.of_mesh import export") == {"_tiles.of_mesh"}
    assert imported("from nanite_rs import io, mesh as m") == {"io", "mesh"}
    assert imported("import nanite_rs._core\nfrom .cut import Cut") == {"_core", "cut"}
    assert imported("def f():\n    from nanite_rs.mesh import NaniteMesh") == {"mesh"}
    assert imported("from nanite_rs import Cut\nimport nanite_rs") == {"__init__"}
    assert imported('READERS = {"ply": "nanite_rs._ply"}') == {"_ply"}
    of_types = "if TYPE_CHECKING:\n    import nanite_rs.cut\nelse:\n    import nanite_rs.io"
    assert imported(of_types) == {"io"}
    assert imported("if not TYPE_CHECKING:\n    import nanite_rs.cut") == {"cut"}
    assert cycle({"a": {"b", "d"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
