"""Vertices and faces of a file that is read in pieces, in the form that the core takes."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors
from nanite_rs._asset import UV_SETS, as_labels
from nanite_rs._faces import fits_word, largest, triangulated, wide_colors, zero_where_not_finite
from nanite_rs._pieces import CHANNEL, Spool, core_words
from nanite_rs.exceptions import MeshError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes


class FileVertices:
    """What is to be known of all vertices of a file before they have the form of the core."""

    def __init__(self, path: str, spool: Spool, notes: Notes) -> None:
        self._path, self._spool, self._notes = path, spool, notes
        self.first = spool.rows("vertices")
        self.first_face = spool.rows("faces")
        self._most: list[float] = []
        # For each property whether it is finite, has room in 32 bits, and is whole as labels are.
        self._sound: dict[str, list[bool]] = {}
        self._of_faces: dict[str, list[bool]] = {}
        self._bad: list[NDArray[np.int64]] = []

    def count(self) -> int:
        """Return how many vertices of the file there are so far."""
        return self._spool.rows("vertices") - self.first

    def faces(self) -> int:
        """Return how many faces of all files there are so far."""
        return self._spool.rows("faces")

    def add_face_property(self, name: str, rows: NDArray[Any], first: int) -> None:
        """Append a property of faces from one on that may become a channel."""
        self._look(self._of_faces, name, rows)
        self._spool.add_filled(f"raw face property {name}", rows, first - self.first_face)

    def add_materials(self, rows: NDArray[np.int32], first: int) -> None:
        """Append materials of faces from one on. Without them it is 0."""
        if rows.any() or "face_materials" in self._spool.names():
            self._spool.add_filled("face_materials", rows, first)

    def add(self, rows: NDArray[Any]) -> None:
        """Append positions."""
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            self._bad.append(bad + self._spool.rows("vertices"))
        self._spool.add_narrowed(rows)

    def add_attribute(self, name: str, rows: NDArray[Any], first: int) -> None:
        """Append normals or UVs, as float32 that are finite."""
        rows = np.asarray(rows, np.float32)
        if not np.isfinite(rows).all():
            what = "normals that are not finite, computed instead"
            if name != "normals":
                what = "texture coordinates that are not finite, zero instead"
            self._notes.add(what, self._path)
            rows = zero_where_not_finite(rows)
        self._spool.add_filled(name, rows, first)

    def add_colors(self, columns: list[NDArray[Any]]) -> None:
        """Append columns of colours, whose range is known at the end."""
        self._most = self._most or [0.0] * len(columns)
        for k, column in enumerate(columns):
            self._most[k] = max(self._most[k], largest(column))
            self._spool.append(f"raw color {k}", column)

    def add_property(self, name: str, rows: NDArray[Any]) -> None:
        """Append a property that may become a channel."""
        self._look(self._sound, name, rows)
        self._spool.append(f"raw property {name}", rows)

    def _look(self, known: dict[str, list[bool]], name: str, rows: NDArray[Any]) -> None:
        sound = known.setdefault(name, [True, True, True])
        sound[0] = sound[0] and bool(rows.dtype.kind != "f" or np.isfinite(rows).all())
        sound[1] = sound[1] and fits_word(rows)
        sound[2] = sound[2] and as_labels(name, rows).dtype.kind in "iu"

    def finish(self) -> None:
        """Give all the form of the core."""
        self.settle()
        self._settle_positions()

    def settle(self) -> None:
        """Give all but positions the form of the core."""
        self._settle_colors()
        for name in self._sound:
            at = self.first
            for rows in self._settled("vertices", name):
                _, kind, words = core_words(name, rows)
                self._spool.add_channel(name, kind, words, at)
                at += len(words)
        for name in self._of_faces:
            at = self.first_face
            for rows in self._settled("faces", name):
                self._spool.add_face_channel(name, rows, at)
                at += len(rows)

    def _settled(self, of: str, name: str) -> Iterator[NDArray[Any]]:
        """Yield a property that can be a channel, and drop it; what cannot is noted."""
        known, raw = self._sound, f"raw property {name}"
        if of == "faces":
            known, raw = self._of_faces, f"raw face property {name}"
        finite, narrow, whole = known[name]
        if not finite:
            self._notes.add(f"properties of {of} that are not finite", name)
        elif not narrow:
            self._notes.add(f"properties of {of} that need 64 bits", name)
        else:
            for rows in self._spool.blocks(raw):
                yield rows.astype(np.int32) if whole and rows.dtype.kind == "f" else rows
        self._spool.drop(raw)

    def _settle_colors(self) -> None:
        spool, count = self._spool, len(self._most)
        if not count:
            return
        names = [f"raw color {k}" for k in range(count)]
        for columns in zip(*(spool.blocks(name) for name in names), strict=True):
            spool.append("wide colors", wide_colors(list(columns), self._most))
        for name in names:
            spool.drop(name)
        self.narrow_colors(_colors.ANY_DIGITS)

    def narrow_colors(self, digits: float) -> None:
        """Make colours of the narrowest type out of the array ``wide colors``."""
        spool, narrow = self._spool, None
        if spool.dtype("wide colors") == np.float32:
            for dtype in (np.uint8, np.uint16):
                if all(
                    _colors.stepped(rows, dtype, digits) is not None for rows in spool.blocks("wide colors")
                ):
                    narrow = dtype
                    break
        at = self.first
        for rows in spool.blocks("wide colors"):
            made = rows if narrow is None else _colors.stepped(rows, narrow, digits)
            spool.add_colors(rows if made is None else made, at)
            at += len(rows)
        spool.drop("wide colors")

    def _settle_positions(self) -> None:
        """Give vertices without finite positions a finite one, if no face has them."""
        if not self._bad:
            return
        bad = np.concatenate(self._bad)
        spool = self._spool
        at = 0
        for faces in spool.blocks("faces"):
            used = np.isin(faces, bad).any(axis=1)
            if used.any():
                row = int(np.argmax(used))
                corner = int(faces[row][np.isin(faces[row], bad)][0]) - self.first
                raise MeshError(
                    f"{self._path}: vertices[{corner}] is not finite, and "
                    f"faces[{at + row - self.first_face}] refers to it"
                )
            at += len(faces)
        points = np.memmap(
            spool.file("vertices"), spool.dtype("vertices"), "r+", shape=(spool.rows("vertices"), 3)
        )
        for faces in spool.blocks("faces"):
            if len(faces):
                points[bad] = points[int(faces[0, 0])]
                break
        points.flush()

    def add_faces(self, corners: NDArray[Any], counts: NDArray[Any]) -> NDArray[np.uint32] | slice:
        """Append polygons as triangles; return which of them each triangle is of.

        Corners count the vertices of the file, which are there already unless all polygons are triangles.
        """
        corners = np.asarray(corners, np.uint32)
        polygons: NDArray[np.uint32] | slice = slice(None)
        if (counts == 3).all():
            triangles = corners.reshape(-1, 3)
        else:
            known = self._spool.mapped("vertices")[self.first :]
            points = known[corners].astype(np.float64)
            numbers, polygons, without = triangulated(
                self._path, points, np.arange(len(corners), dtype=np.uint32), np.asarray(counts, np.uint32)
            )
            if without:
                self._notes.add("faces of fewer than three corners", self._path)
            triangles = corners[numbers]
        self._spool.append("faces", (triangles.astype(np.int64) + self.first).astype(np.uint32))
        return polygons


class Corners:
    """Corners of a file's polygons as vertices of their own, where faces say what vertices cannot.

    Equal ones are welded again by the build.
    """

    def __init__(self, path: str, spool: Spool, notes: Notes, vertices: FileVertices) -> None:
        self._path, self._spool, self._notes, self._vertices = path, spool, notes, vertices
        folder = spool.folder / "corners"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        self._side = Spool(folder)
        #: Vertices as the file has them, all of which come before faces.
        self.source = FileVertices(path, self._side, notes)

    def add_faces(
        self, corners: NDArray[np.uint32], counts: NDArray[Any], first: int
    ) -> NDArray[np.uint32] | slice:
        """Append polygons as triangles; return which of them each is of. ``first`` is the number of the first."""
        points = np.asarray(self._side.mapped("vertices")[corners])
        bad = ~np.isfinite(points).all(axis=1)
        if bad.any():
            row = int(np.argmax(bad))
            polygon = first + int(np.searchsorted(np.cumsum(counts), row, side="right"))
            raise MeshError(
                f"{self._path}: vertices[{corners[row]}] is not finite, and faces[{polygon}] refers to it"
            )
        numbers, polygons, without = triangulated(
            self._path,
            points.astype(np.float64),
            np.arange(len(corners), dtype=np.uint32),
            np.asarray(counts, np.uint32),
        )
        if without:
            self._notes.add("faces of fewer than three corners", self._path)
        first_vertex = self._spool.rows("vertices")
        self._vertices.add(points)
        self._spool.append("faces", (numbers.astype(np.int64) + first_vertex).astype(np.uint32))
        self._side.append("corners", corners)
        return polygons

    def add_uvs(self, rows: NDArray[np.float32]) -> None:
        """Append texture coordinates of the corners that came last; those before have zeros if none were given."""
        self._side.add_filled("wedges", rows, self._side.rows("corners") - len(rows))

    def finish(self) -> None:
        """Give corners what their vertices carry."""
        self.source.settle()
        side, spool, first = self._side, self._spool, self._vertices.first
        count, wedges = side.rows("corners"), "wedges" in side.names()
        if wedges:
            side.pad("wedges", count, 0)
        arrays = {
            name: side.mapped(name) for name in side.names() if name not in ("vertices", "corners", "wedges")
        }
        start = 0
        for corners in side.blocks("corners"):
            at = first + start
            if wedges:
                rows = side.mapped("wedges")[start : start + len(corners)]
                self._vertices.add_attribute("uvs 0", rows, at)
            for name, values in arrays.items():
                rows = values[corners]
                if name.startswith(CHANNEL):
                    _, kind, label = name.split(" ", 2)
                    spool.add_channel(label, kind, rows, at)
                elif name == "colors":
                    spool.add_colors(rows, at)
                elif name.startswith("uvs "):
                    number = int(name[4:]) + wedges
                    if number < UV_SETS:
                        spool.add_filled(f"uvs {number}", rows, at)
                else:
                    spool.add_filled(name, rows, at)
            start += len(corners)
        shutil.rmtree(side.folder)
