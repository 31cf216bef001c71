"""OBJ in pieces: one pass over its statements, and one over the corners of its faces."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from nanite_rs import _colors, _core, _mtl
from nanite_rs._asset import fitted
from nanite_rs._piece_text import Lines
from nanite_rs._piece_vertices import FileVertices
from nanite_rs.exceptions import FormatError, MeshError
from nanite_rs.material import Material

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._pieces import Spool


#: What stands in a corner for a number that is not there, and no file can have.
_NOTHING: Final = 1 << 40
_NONE: Final = np.uint32(0xFFFFFFFF)
_BLANK: Final = np.zeros(256, bool)
_BLANK[[*b" \t\x0b\x0c\x00\x1a\n"]] = True
_KINDS: Final = {b"v": 1, b"vt": 2, b"vn": 3, b"f": 4, b"fo": 4}
_SLASHES: Final = re.compile(rb"/(?=[\s/])")


class _Obj:
    """One pass over the statements of an OBJ file: positions, UVs, normals and corners go to the spool.

    Faces may be before their vertices, so meshes are made of that in a second pass.
    """

    def __init__(self, path: str, spool: Spool, notes: Notes) -> None:
        self._path, self._spool, self._notes = path, spool, notes
        self.counts = [0, 0, 0]
        self.faces = 0
        self._corners = 0
        self.colored = False
        self.bytes = False
        self.has = [True, False, False]
        self._highest = [-1, -1, -1]
        self.libraries: list[bytes] = []
        self.materials: dict[bytes, int] = {}
        self._material = -1
        self._left: dict[str, int] = {}
        # Names of objects, groups and smoothing groups.
        self._said: dict[bytes, set[bytes]] = {b"o": set(), b"g": set(), b"s": set()}
        lines = Lines(path)
        while data := lines.block():
            # A statement goes on in the next line after a backslash.
            while re.search(rb"\\[ \t]*\n?$", data) and (more := lines.block()):
                data += more
            self._block(data, lines.line)
            lines.passed(data)
        for k, what in enumerate(("vertex", "texture vertex", "normal")):
            if self._highest[k] >= self.counts[k]:
                self._beyond(k, what)
        if self._said[b"o"] and len(self._said[b"g"]) > 1:
            notes.add("groups within objects")
        if len(self._said[b"s"]) > 1:
            notes.add("smoothing groups")
        for left, count in self._left.items():
            notes.add(f"{count} {left}")

    def _beyond(self, k: int, what: str) -> None:
        """Say which face refers to nothing."""
        start = 0
        for rows in self._spool.blocks(f"raw corner {k}"):
            bad = (rows != _NONE) & (rows >= self.counts[k])
            if bad.any():
                corner = start + int(np.argmax(bad))
                face = self._face_of(corner)
                number = int(rows[corner - start]) + 1
                raise FormatError(
                    f"{self._path}: faces[{face}]: there is no {what} {number}, only {self.counts[k]}"
                )
            start += len(rows)

    def _face_of(self, corner: int) -> int:
        face, before = 0, 0
        for counts in self._spool.blocks("raw counts"):
            ends = before + np.cumsum(counts, dtype=np.int64)
            if len(ends) and corner < ends[-1]:
                return face + int(np.searchsorted(ends, corner, side="right"))
            face, before = face + len(counts), int(ends[-1]) if len(ends) else before
        return face

    def _block(self, data: bytes, line: int) -> None:
        """Read the statements of some lines."""
        if not data.endswith(b"\n"):
            data += b"\n"
        if b"#" in data:
            # Names may have a # within.
            data = re.sub(
                rb"(^|[ \t])#[^\n]*|^([vf][tno]?[ \t][^\n#]*)#[^\n]*", rb"\1\2", data, flags=re.MULTILINE
            )
        # Line feeds go behind the statement, so that lines keep their numbers.
        if b"\\" in data:
            data = re.sub(
                rb"(?:[^\n]*\\[ \t]*\n)+[^\n]*\n",
                lambda m: re.sub(rb"\\[ \t]*\n", b" ", m[0]) + b"\n" * m[0][:-1].count(b"\n"),
                data,
            )
        if data[:1] in b" \t" or b"\n " in data or b"\n\t" in data:
            data = re.sub(rb"^[ \t]+", b"", data, flags=re.MULTILINE)
        text = np.frombuffer(data, np.uint8)
        ends = np.flatnonzero(text == 10) + 1
        starts = np.concatenate([[0], ends[:-1]])
        padded = np.concatenate([text, np.full(3, 10, np.uint8)])
        lower = np.where((padded >= 65) & (padded <= 90), padded + 32, padded)
        heads = [lower[starts + k] for k in range(3)]
        kinds = np.zeros(len(starts), np.uint8)
        for word, kind in _KINDS.items():
            is_word = _BLANK[heads[len(word)]]
            for k, letter in enumerate(word):
                is_word &= heads[k] == letter
            kinds[is_word] = kind
        other = np.flatnonzero((kinds == 0) & ~_BLANK[heads[0]])
        faces = np.flatnonzero(kinds == 4)
        materials = self._others(data, starts, ends, other, faces)
        of_byte = np.repeat(kinds, ends - starts)
        before = []
        for kind in (1, 2, 3):
            at = np.flatnonzero(kinds == kind)
            before.append(self.counts[kind - 1] + np.cumsum(kinds == kind)[faces])
            if len(at):
                rows = text[of_byte == kind].tobytes()
                self._numbers(kind, rows, at + line)
                self.counts[kind - 1] += len(at)
        if len(faces):
            self._faces(text[of_byte == 4].tobytes(), before, faces + line, materials)

    # ------------------------------------------------------------------------------------ statements

    def _others(
        self,
        data: bytes,
        starts: NDArray[np.int64],
        ends: NDArray[np.int64],
        other: NDArray[np.int64],
        faces: NDArray[np.int64],
    ) -> NDArray[np.int32]:
        """Read what is neither vertex nor face; return the material of each face."""
        at, numbers = [-1], [self._material]
        for row in other.tolist():
            word, _, rest = data[starts[row] : ends[row]].strip().replace(b"\t", b" ").partition(b" ")
            word, rest = word.lower(), rest.strip()
            if word == b"usemtl":
                self._material = self.materials.setdefault(rest, len(self.materials)) if rest else -1
                at.append(row)
                numbers.append(self._material)
            elif word == b"mtllib":
                self.libraries.append(rest)
            elif word in self._said:
                # Two are enough to tell that faces differ.
                if len(self._said[word]) < 2:
                    self._said[word].add(rest)
            elif word in (b"p", b"l"):
                self._leave("points and lines")
            else:
                self._leave(f"statements {word[:20].decode('utf-8', 'replace')!r}")
        places = np.searchsorted(np.array(at), faces, side="right") - 1
        return np.array(numbers, np.int32)[places]

    def _leave(self, what: str) -> None:
        what = what if what in self._left or len(self._left) < 16 else "further statements"
        self._left[what] = self._left.get(what, 0) + 1

    def _numbers(self, kind: int, text: bytes, lines: NDArray[np.int64]) -> None:
        """Read rows of numbers, each behind its word."""
        rows = np.frombuffer(text, np.uint8).copy()
        ends = np.flatnonzero(rows == 10) + 1
        starts = np.concatenate([[0], ends[:-1]])
        rows[starts] = 32
        if kind > 1:
            rows[starts + 1] = 32
        blank = _BLANK[rows]
        begins = ~blank[1:] & blank[:-1]
        total = np.concatenate([[0, 0], np.cumsum(begins, dtype=np.int32)])
        widths = total[ends] - total[starts]
        needed = (3, 1, 3)[kind - 1]
        if (widths < needed).any():
            row = int(np.argmax(widths < needed))
            raise FormatError(
                f"{self._path}: line {lines[row]}: expected {needed} numbers, found the end of the line"
            )
        found = np.zeros((len(starts), 8))
        for width in np.unique(widths).tolist():
            same = widths == width
            part = rows if same.all() else rows[np.repeat(same, ends - starts)]
            columns = self._columns(part.tobytes(), width, lines[same])
            for k, column in enumerate(columns[:8]):
                found[same, k] = column
        if kind == 1:
            self._positions(found, widths)
        elif kind == 2:
            self._spool.append("raw uv", found[:, :2].astype(np.float32))
            if found[:, 2].any():
                self._notes.add("third texture coordinates (vt)", self._path)
        else:
            self._spool.append("raw normal", found[:, :3].astype(np.float32))

    def _columns(self, text: bytes, width: int, lines: NDArray[np.int64]) -> list[NDArray[np.float64]]:
        head = "".join(f"property double {k}\n" for k in range(width))
        start = f"ply\nformat ascii 1.0\nelement v {len(lines)}\n{head}end_header\n".encode()
        try:
            ((_, _, columns),) = _core.read_ply(self._path, start + text)["elements"]
        except FormatError as error:
            # The rows are those of another text, and so are their numbers.
            row = re.search(r"line (\d+)", str(error))
            number = int(row[1]) - 1 - start.count(b"\n") if row is not None else 0
            what = re.search(r"found .*", str(error), re.DOTALL)
            found = f", {what[0]}" if what is not None else ""
            at = int(lines[min(max(number, 0), len(lines) - 1)])
            raise FormatError(f"{self._path}: line {at}: expected a number{found}") from None
        return [columns[str(k)][0] for k in range(width)]

    def _positions(self, found: NDArray[np.float64], widths: NDArray[np.int64]) -> None:
        """Append rows of x y z, x y z w, x y z r g b, x y z r g b a or x y z w r g b a."""
        self._spool.append("raw position", found[:, :3])
        weights = found[((widths == 4) | (widths == 8)), 3]
        if (weights != 1.0).any():
            self._notes.add("weights of vertices, which polygons have none of", self._path)
        if (~np.isin(widths, (3, 4, 6, 7, 8))).any():
            self._notes.add("numbers behind coordinates (v)", self._path)
        colored = (widths >= 6) & (widths <= 8)
        if not colored.any() and not self.colored:
            return
        colors = np.full((len(found), 4), np.nan, np.float32)
        for width, columns in ((6, 3), (7, 4), (8, 4)):
            first = 4 if width == 8 else 3
            rows = widths == width
            colors[rows, :columns] = found[rows, first : first + columns]
        if not self.colored:
            self._spool.append("raw rgba", colors[:0])
            self._spool.pad("raw rgba", self.counts[0], np.nan)
            self.colored = True
        self.bytes = self.bytes or bool((colors > 1.0).any())
        self._spool.append("raw rgba", colors)

    def _faces(
        self,
        text: bytes,
        before: list[NDArray[np.int64]],
        lines: NDArray[np.int64],
        materials: NDArray[np.int32],
    ) -> None:
        """Append corners, by numbers from 0 of positions, UVs and normals."""
        self.faces += len(lines)
        # The words of statements, of one letter or two, are none of the corners.
        rows = np.frombuffer(b"\n" + text, np.uint8).copy()
        starts = np.flatnonzero(rows[:-1] == 10) + 1
        rows[starts] = 32
        rows[starts[(rows[starts + 1] | 32) == 111] + 1] = 32
        if any(slash in text for slash in (b"//", b"/ ", b"/\t", b"/\n")):
            rows = np.frombuffer(_SLASHES.sub(b"/%d" % _NOTHING, rows.tobytes()), np.uint8)
        blank = _BLANK[rows]
        begins = np.flatnonzero(~blank[1:] & blank[:-1]) + 1
        ends = np.flatnonzero(blank[1:] & ~blank[:-1]) + 1
        feeds = np.flatnonzero(rows == 10)
        slashes = np.concatenate([[0], np.cumsum(rows == 47, dtype=np.int32)])
        parts = 1 + slashes[ends] - slashes[begins]
        of_line = np.searchsorted(feeds, begins) - 1
        counts = np.bincount(of_line, minlength=len(lines))
        values = _whole_numbers(np.where(rows == 47, np.uint8(32), rows).tobytes(), int(parts.sum()))
        if values is None or len(values) != parts.sum() or (parts > 3).any():
            raise self._bad_corner(rows.tobytes(), begins, ends, of_line, before, lines)
        at = np.cumsum(parts) - parts
        bad = np.zeros(len(begins), bool)
        for k in range(3):
            numbers = np.full(len(begins), _NOTHING, np.int64)
            there = parts > k
            numbers[there] = values[at[there] + k]
            known = numbers != _NOTHING
            base = before[k][of_line]
            places = np.where(numbers > 0, numbers - 1, base + numbers)
            bad |= known & ((numbers == 0) | (places < 0) | (places >= int(_NONE)))
            if k == 0:
                bad |= ~known
            if bad.any():
                raise self._bad_corner(rows.tobytes(), begins, ends, of_line, before, lines)
            if k and not known.any() and not self.has[k]:
                continue
            if not self.has[k]:
                self.has[k] = True
                self._spool.append(f"raw corner {k}", np.zeros(0, np.uint32))
                self._spool.pad(f"raw corner {k}", self._corners, _NONE)
            self._highest[k] = max(self._highest[k], int(places[known].max(initial=-1)))
            self._spool.append(f"raw corner {k}", np.where(known, places, int(_NONE)).astype(np.uint32))
        self._corners += len(begins)
        self._spool.append("raw counts", counts.astype(np.uint32))
        self._spool.append("raw material", materials)

    def _bad_corner(
        self,
        text: bytes,
        begins: NDArray[np.int64],
        ends: NDArray[np.int64],
        of_line: NDArray[np.int64],
        before: list[NDArray[np.int64]],
        lines: NDArray[np.int64],
    ) -> FormatError:
        """Return an error that says which corner is wrong."""
        nothing = str(_NOTHING).encode()
        for begin, end, row in zip(begins.tolist(), ends.tolist(), of_line.tolist(), strict=True):
            word = text[begin:end]
            parts = word.split(b"/")
            shown = repr(word.replace(nothing, b"").decode("utf-8", "replace")).replace("'", '"')
            where = f"{self._path}: line {lines[row]}"
            for k, part in enumerate(parts[:3]):
                if k and part == nothing:
                    continue
                number = int(part) if re.fullmatch(rb"[+-]?\d+", part) else 0
                count = int(before[k][row])
                if number == 0 or number < -count or number > int(_NONE):
                    what = ("a vertex", "a texture vertex", "a normal")[k]
                    return FormatError(f"{where}: expected the number of {what} of {count}, found {shown}")
            if len(parts) > 3:
                return FormatError(f"{where}: expected a corner such as 1/2/3, found {shown}")
        return FormatError(f"{self._path}: line {lines[0]}: a face behind it has corners that are no numbers")


def _whole_numbers(text: bytes, words: int) -> NDArray[np.int64] | None:
    """Return the numbers of a text; nothing where there are not so many, or some are none."""
    head = b"ply\nformat ascii 1.0\nelement f 1\nproperty list uint int64 i\nend_header\n"
    try:
        ((_, _, columns),) = _core.read_ply("", head + b"%d " % words + text.replace(b"\n", b" "))["elements"]
    except FormatError:
        return None
    values: NDArray[np.int64] = columns["i"][0]
    return values


def read(path: str, spool: Spool, notes: Notes) -> None:
    """Read OBJ: with UVs or normals each corner has a vertex of its own, and equal ones are welded by the core."""
    found = _Obj(path, spool, notes)
    if not found.faces:
        raise MeshError(f"{path}: there are no triangles in it")
    vertices = FileVertices(path, spool, notes)
    if found.colored:
        spool.pad("raw rgba", found.counts[0], np.nan)
    soup = found.has[1] or found.has[2]
    if not soup:
        for rows in spool.blocks("raw position"):
            vertices.add(rows)
        for rows in spool.blocks("raw rgba") if found.colored else ():
            spool.append("wide colors", _obj_colors(rows, found.bytes))
    numbers = _obj_materials(path, found, spool, notes)
    corner, face = 0, 0
    for counts in spool.blocks("raw counts"):
        end = corner + int(counts.sum())
        corners = np.asarray(spool.mapped("raw corner 0")[corner:end], np.int64)
        if soup:
            first = vertices.count()
            _add_corners(found, vertices, spool, corner, corners)
            corners = np.arange(first, first + len(corners))
        before = spool.rows("faces")
        polygons = vertices.add_faces(corners, counts)
        if numbers is not None:
            materials = spool.mapped("raw material")[face : face + len(counts)]
            spool.add_filled("face_materials", numbers[materials[polygons] + 1], before)
        corner, face = end, face + len(counts)
    for name in spool.names("raw "):
        spool.drop(name)
    if found.colored:
        vertices.narrow_colors(_colors.ANY_DIGITS)
    vertices.finish()
    if spool.rows("faces") == vertices.first_face:
        raise MeshError(f"{path}: there are no triangles in it")


def _add_corners(
    found: _Obj, vertices: FileVertices, spool: Spool, corner: int, positions: NDArray[np.int64]
) -> None:
    """Append a vertex for each of some corners, from one on, with what it has."""
    first, end = vertices.first + vertices.count(), corner + len(positions)
    vertices.add(spool.mapped("raw position")[positions])
    for k, raw, name in ((1, "raw uv", "uvs 0"), (2, "raw normal", "normals")):
        if not found.has[k]:
            continue
        spool.pad(f"raw corner {k}", end, _NONE)
        own = np.asarray(spool.mapped(f"raw corner {k}")[corner:end])
        rows = np.zeros((len(own), 2 if k == 1 else 3), np.float32)
        known = own != _NONE
        if known.any():
            rows[known] = spool.mapped(raw)[own[known]]
        vertices.add_attribute(name, rows, first)
    if found.colored:
        spool.append("wide colors", _obj_colors(spool.mapped("raw rgba")[positions], found.bytes))


def _obj_colors(rows: NDArray[np.float32], in_bytes: bool) -> NDArray[np.float32]:
    """Return colours from 0 to 1, those from 0 to 255 too; white where there are none."""
    scaled = rows / np.float32(255) if in_bytes else rows
    return np.asarray(np.where(np.isnan(scaled), 1.0, np.clip(scaled, 0.0, 1.0)), np.float32)


def _obj_materials(path: str, found: _Obj, spool: Spool, notes: Notes) -> NDArray[np.int32] | None:
    """Return the number of each material's look, that of none first; nothing where nothing is said."""
    if not found.materials:
        return None
    materials = _mtl.read(path, found.libraries, Path(path).parent, drop_bad_textures=True, notes=notes)
    rest = Material(base_color=(1.0, 1.0, 1.0)) if found.colored else Material()
    table: dict[Material, int] = {}
    looks = []
    for raw in found.materials:
        look = materials.get(_mtl.label(raw))
        looks.append(rest if look is None else fitted(look, _mtl.label(raw), int(found.has[1]), notes))
    numbers = [table.setdefault(look, len(table)) for look in looks]
    none = table.setdefault(rest, len(table))
    if len(set(numbers)) < 2 and none == numbers[0]:
        return None
    spool.add_looks(table)
    return np.array([none, *numbers], np.int32)
