"""Face data in the form of the core: one number for each face, and labels of the vertices around it.

The core keeps the lines between face materials exactly, at all levels. So each combination of a face's material and
its labels has a number of its own, which is the material there. Vertices between combinations are taken apart, and
each has the labels of its faces as channels: those of a face of any cut are the labels of its corners, which agree.

Both are found again in a file by the names of these channels, ``face/MxK:NAME``: number modulo M is the material,
of which there are none where M is 0, and K is how many combinations the material with the most has.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

MOST: Final = 4096
"""Most combinations: each has clusters of its own at all levels."""
_NAME: Final = re.compile(r"face/(\d+)x(\d+):(.*)", re.DOTALL)
_MOST_NUMBERS: Final = 1 << 16


class Layout(NamedTuple):
    """How numbers of the core are made."""

    materials: int
    """Numbers of materials; 0 where faces have none."""
    combinations: int
    """Most combinations of one of them."""

    def materials_of(self, numbers: NDArray[np.int32] | None) -> NDArray[np.int32] | None:
        """Return the materials that were given, of numbers of the core."""
        return None if numbers is None or not self.materials else numbers % np.int32(self.materials)

    def spread(self, looks: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return a look for each number of the core, of one for each material; the last stands for the rest."""
        if len(looks) == 1:
            return looks
        row = [looks[min(number, len(looks) - 1)] for number in range(max(self.materials, 1))]
        return row * self.combinations


def plain(name: str) -> str:
    """Return the name that a channel was given."""
    found = _NAME.fullmatch(name)
    return name if found is None else found[3]


def layout(names: Iterable[str]) -> tuple[Layout | None, tuple[str, ...]]:
    """Return how numbers are made, if faces carry anything, and the names of what they carry."""
    found = [match for match in map(_NAME.fullmatch, names) if match is not None]
    if not found:
        return None, ()
    return Layout(int(found[0][1]), int(found[0][2])), tuple(match[3] for match in found)


class Means:
    """Means at vertices of what the faces around them carry, weighted by their areas. Faces may come in parts."""

    def __init__(
        self, vertices: int, columns: int, zeros: Callable[[int], NDArray[np.float64]] = np.zeros
    ) -> None:
        self._total = zeros(vertices)
        self._sums = [zeros(vertices) for _ in range(columns)]

    def add(self, corners: NDArray[Any], faces: NDArray[Any], values: NDArray[Any]) -> None:
        """Add faces, by the positions of their (M, 3) corners."""
        corners = np.asarray(corners, np.float64)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        weights = np.repeat(np.linalg.norm(across, axis=1), 3)
        at = np.asarray(faces).reshape(-1)
        np.add.at(self._total, at, weights)
        rows = np.repeat(np.asarray(values, np.float64).reshape(len(faces), -1), 3, axis=0)
        for sums, row in zip(self._sums, rows.T, strict=True):
            np.add.at(sums, at, weights * row)

    def rows(self, part: slice) -> NDArray[np.float32]:
        """Return the means at some vertices, zero where there are no faces."""
        total = self._total[part]
        sums = np.stack([own[part] for own in self._sums], axis=1)
        return (sums / np.where(total > 0.0, total, 1.0)[:, None]).astype(np.float32)


def columns_of(values: NDArray[Any]) -> int:
    """Return how many numbers a face has."""
    return 1 if values.ndim == 1 else int(values.shape[1])


def averaged(vertices: NDArray[Any], faces: NDArray[Any], values: NDArray[Any]) -> NDArray[np.float32]:
    """Return the mean at each vertex of what the faces around it carry, weighted by their areas."""
    means = Means(len(vertices), columns_of(values))
    means.add(np.asarray(vertices)[faces], faces, values)
    rows = means.rows(slice(None))
    return rows[:, 0] if values.ndim == 1 else rows


def checked(given: object, faces: int) -> dict[str, NDArray[Any]]:
    """Arrays with a row for each face, by name."""
    if not isinstance(given, Mapping):
        raise DtypeError(
            f"face_channels: expected a mapping of names to arrays, not {_advice.name_of_type(given)}"
        )
    out = {}
    for name, value in given.items():
        array = np.asarray(value)
        if not isinstance(name, str):
            raise DtypeError(f"face_channels: names are strings, not {_advice.name_of_type(name)}")
        if array.ndim not in (1, 2) or len(array) != faces:
            raise ArgumentError(
                f"face_channels[{name!r}]: expected shape ({faces},) or ({faces}, K), found {array.shape}"
            )
        if array.dtype.kind not in "fiub":
            raise DtypeError(
                f"face_channels[{name!r}]: expected a floating-point, integer or bool dtype, not {array.dtype}"
            )
        out[name] = array
    return out


def without_floats(
    vertices: NDArray[Any], faces: NDArray[Any], face_channels: dict[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Split into labels, and channels of vertices made of the rest."""
    labels = {name: array for name, array in face_channels.items() if array.dtype.kind != "f"}
    blended = {
        name: averaged(vertices, faces, array) for name, array in face_channels.items() if name not in labels
    }
    return labels, blended


def combinations(columns: list[NDArray[Any]]) -> tuple[NDArray[np.int64], int]:
    """Return a number for each face, equal where all columns are, in their order, and how many there are."""
    number, count = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        for part in column.reshape(len(column), -1).T:
            values, own = np.unique(part, return_inverse=True)
            _, number = np.unique(number * len(values) + own.reshape(-1), return_inverse=True)
            number = number.reshape(-1)
            count = int(number.max(initial=-1)) + 1
    return number, count


def warn_of_floats(names: Iterable[str]) -> None:
    """Say what becomes of floating-point data of faces."""
    listed = ", ".join(names)
    if listed:
        _advice.warn(
            f"face_channels: {listed}: floating-point data of faces are averaged to vertices, where simplification "
            "can follow them; integers are kept as they are",
            UsageWarning,
        )


def taken_apart(
    faces: NDArray[Any], materials: NDArray[np.int32] | None, labels: dict[str, NDArray[Any]]
) -> Taken:
    """Take the faces of a mesh apart.

    Raises
    ------
    ArgumentError
        As of `Apart.look`.
    """
    apart = Apart()
    apart.look(materials, labels)
    return apart.taken(faces, materials, labels)


class Taken(NamedTuple):
    """Faces that were taken apart."""

    vertices: NDArray[np.int64]
    """The vertex that each new one is a copy of."""
    faces: NDArray[np.int64]
    """Faces of new vertices."""
    numbers: NDArray[np.int32]
    """Numbers of faces."""
    channels: dict[str, NDArray[Any]]
    """Channels of new vertices."""


class Apart:
    """Takes faces apart that may come in parts: all are looked at once before.

    Vertices come again in each part that uses them. Whoever welds them finds that they are equal.
    """

    def __init__(self) -> None:
        self._rows: NDArray[np.int64] = np.zeros((0, 0), np.int64)
        """All combinations in their order: materials, and what labels there are."""
        self._seen = 0

    def look(self, materials: NDArray[np.int32] | None, labels: Mapping[str, NDArray[Any]]) -> None:
        """Look at what some faces carry.

        Raises
        ------
        ArgumentError
            There are too many combinations, or face materials are no small numbers.
        """
        if materials is not None and materials.min(initial=0) < 0:
            row = int(materials.argmin())
            raise ArgumentError(
                f"face_materials[{self._seen + row}]: {materials[row]} is below 0, which face_channels do not go "
                "with"
            )
        _, rows = _rows_of(materials, labels)
        self._seen += len(next(iter(labels.values())))
        self._rows = np.unique(np.concatenate([self._rows.reshape(-1, rows.shape[1]), rows]), axis=0)
        if len(self._rows) > MOST:
            raise ArgumentError(
                f"face_channels: {len(self._rows):,} different rows of {', '.join(labels)}, at most {MOST:,} are "
                "kept apart"
            )

    def taken(
        self, faces: NDArray[Any], materials: NDArray[np.int32] | None, labels: Mapping[str, NDArray[Any]]
    ) -> Taken:
        """Take faces apart that were looked at.

        Raises
        ------
        ArgumentError
            Numbers of materials are too large for so many combinations.
        """
        own, count = self._rows[:, 0], len(self._rows)
        # Combinations of a material follow each other: it is the first column.
        rank = np.arange(count) - np.searchsorted(own, own)
        width, height = int(own.max(initial=0)) + 1, int(rank.max(initial=0)) + 1
        if width * height > _MOST_NUMBERS:
            raise ArgumentError(
                f"face_materials: numbers up to {width - 1:,} with {height:,} combinations of face_channels are "
                "too many; number the materials from 0"
            )
        number, rows = _rows_of(materials, labels)
        _, known = np.unique(np.concatenate([self._rows, rows]), axis=0, return_inverse=True)
        number = known.reshape(-1)[count:][number]
        corners = np.asarray(faces, np.int64).reshape(-1)
        pairs, at, back = np.unique(
            corners * count + np.repeat(number, 3), return_index=True, return_inverse=True
        )
        prefix = f"face/{0 if materials is None else width}x{height}:"
        channels = {prefix + name: values[at // 3] for name, values in labels.items()}
        core = (own + width * rank)[number].astype(np.int32)
        return Taken(pairs // count, back.reshape(-1, 3), core, channels)


def _rows_of(
    materials: NDArray[np.int32] | None, labels: Mapping[str, NDArray[Any]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of each face's combination among those of these faces, and their rows."""
    columns = list(labels.values())
    own = np.zeros(len(columns[0]), np.int64) if materials is None else materials.astype(np.int64)
    number, count = combinations([own, *columns])
    first = np.zeros(count, np.int64)
    first[number[::-1]] = np.arange(len(number))[::-1]
    parts = [column[first].reshape(count, -1).astype(np.int64) for column in (own, *columns)]
    return number, np.concatenate(parts, axis=1)


class FaceChannels(Mapping[str, "NDArray[Any]"]):
    """What the faces of a cut carry, by name: looked up at the first corner of each, as all corners agree."""

    __slots__ = ("_channels", "_faces", "_names")

    def __init__(
        self, channels: Mapping[str, NDArray[Any]], names: tuple[str, ...], faces: NDArray[np.int32]
    ) -> None:
        self._channels, self._names, self._faces = channels, names, faces

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a row for each face."""
        if name not in self._names:
            raise KeyError(name)
        values: NDArray[Any] = self._channels[name][self._faces[:, 0]]
        return values

    def __iter__(self) -> Iterator[str]:
        """Names, in the order in which they were given."""
        return iter(self._names)

    def __len__(self) -> int:
        """Return the number of channels."""
        return len(self._names)

    def __repr__(self) -> str:
        """Names."""
        return f"FaceChannels({list(self)})"
