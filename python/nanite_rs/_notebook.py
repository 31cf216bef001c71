"""Display in notebooks: tables, and pictures by the function that is registered for a class.

Tables are plain HTML, without colours, so that they read well on any background.
"""

from __future__ import annotations

from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING

from nanite_rs.exceptions import InternalError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

__all__ = ["pairs", "png", "table"]


@singledispatch
def png(shown: object) -> bytes | None:
    """Return a small picture of a mesh or a cut; None, so that the text is shown, where there is none.

    DESIGN: drawing needs a scene and a renderer, which need meshes and cuts. So `_preview`, which has all of them,
    registers what draws each class, and the classes ask here.
    """
    raise InternalError(f"notebook: nothing draws {type(shown).__name__}")


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Names on the left, what they are on the right."""
    body = (f"<tr>{_cell(name, 'th', 'left')}{_cell(value, 'td', 'left')}</tr>" for name, value in rows)
    return f"<table>{''.join(body)}</table>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Collection[int] = ()) -> str:
    """Rows below names of columns: numbers flush right, the columns of ``text`` flush left."""
    sides = ["left" if column in text else "right" for column in range(len(head))]

    def row(cells: Sequence[str], tag: str) -> str:
        inner = (_cell(cell, tag, side) for cell, side in zip(cells, sides, strict=True))
        return f"<tr>{''.join(inner)}</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    return f"<table><thead>{row(head, 'th')}</thead><tbody>{body}</tbody></table>"


def _cell(content: str, tag: str, side: str) -> str:
    # Notebooks have sides of their own; only what is said in the cell holds everywhere.
    return f'<{tag} style="text-align: {side}; padding: 0.1em 0.6em">{escape(content)}</{tag}>'
