"""Materials of Wavefront OBJ files, read from the MTL files beside them.

Colours are taken as linear, as trimesh and pyrender take them; ``Ns`` becomes a roughness as it does there.
"""

from __future__ import annotations

import codecs
import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs._asset import named
from nanite_rs._beside import Pictures, find, text
from nanite_rs._images import read_bytes
from nanite_rs.exceptions import FormatError
from nanite_rs.material import Material
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes

# Options of texture maps with a fixed number of words; those with one to three numbers are parsed by trying.
_OPTIONS: Final = {
    "-blendu": 1,
    "-blendv": 1,
    "-bm": 1,
    "-boost": 1,
    "-cc": 1,
    "-clamp": 1,
    "-imfchan": 1,
    "-mm": 2,
    "-texres": 1,
    "-type": 1,
}
_VECTORS: Final = {"-o": 0.0, "-s": 1.0, "-t": 0.0}
_MAPS: Final = ("map_kd", "map_ke", "map_d", "norm")
# Names may have a # within.
_COMMENT: Final = re.compile(rb"(?<=\S)\s+#.*", re.DOTALL)
_LEFT: Final = ("map_bump", "bump", "map_ns", "map_ks", "map_pr", "map_pm", "disp", "refl")


def read(
    name: str, libraries: list[bytes], folder: Path | None, *, drop_bad_textures: bool, notes: Notes
) -> dict[str, Material]:
    """Read the materials of an OBJ file by their names, out of what follows each of its ``mtllib``."""
    found: dict[str, Material] = {}
    pictures: dict[Path, Pictures] = {}
    for library in dict.fromkeys(libraries):
        for path in _files(library, folder, notes):
            own = pictures.setdefault(path.parent, Pictures(path.parent, drop_bad_textures, notes))
            for label, rows in _materials(read_bytes(path, f"{name}: mtllib")).items():
                found.setdefault(label, _Reader(name, label, own, notes).material(rows))
    return found


def label(raw: bytes) -> str:
    """Return the name of a material, as OBJ and MTL files both have it: the encodings of the two may differ."""
    return " ".join(text(raw).split())


def _files(library: bytes, folder: Path | None, notes: Notes) -> list[Path]:
    """The files that a ``mtllib`` names: one whose name has blanks, or several."""
    whole = text(library)
    if not whole:
        return []
    path = None if folder is None else find(folder, whole)
    if path is not None or folder is None:
        found = {whole: path}
    else:
        found = {word: find(folder, word) for word in whole.split()}
        if not any(found.values()):
            found = {whole: None}
    for name, path in found.items():
        if path is None:
            notes.add("materials of files that are missing", name)
    return [path for path in found.values() if path is not None]


def _materials(data: bytes) -> dict[str, dict[str, str]]:
    """Statements of each material by their first words, which are lowered."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8).replace(b"\0", b" ")
    materials: dict[str, dict[str, str]] = {}
    rows: dict[str, str] = {}
    before = b""
    for own in data.splitlines():
        line = before + own.strip()
        before = b""
        if line.startswith(b"#") or not line:
            continue
        if line.endswith(b"\\"):
            before = line[:-1] + b" "
            continue
        key, *rest = _COMMENT.sub(b"", line).split(None, 1)
        if key.lower() == b"newmtl":
            rows = materials.setdefault(label(b"".join(rest)), {})
        elif rest:
            rows[text(key).lower()] = text(rest[0]).strip()
    return materials


class _Reader:
    """The statements of one material."""

    def __init__(self, name: str, label: str, pictures: Pictures, notes: Notes) -> None:
        self._name, self._label, self._pictures, self._notes = name, label, pictures, notes

    def material(self, rows: dict[str, str]) -> Material:
        for key in _LEFT:
            if key in rows:
                self._notes.add(f"{key} of MTL files", self._label)
        painted, clear = self._texture(rows, "map_kd"), self._texture(rows, "map_d")
        glowing = self._texture(rows, "map_ke")
        alpha = self._numbers(rows, "d", 1)
        # Tr is transparency to some writers and opacity to others: nobody means a fully transparent material.
        through = self._numbers(rows, "tr", 1)
        if alpha is None and through is not None and through[0] < 1.0:
            alpha = 1.0 - through
        color = self._numbers(rows, "kd", 3)
        if color is None:
            color = np.full(3, 0.8 if painted is None else 1.0)
        glow = self._numbers(rows, "ke", 3)
        if glow is None:
            glow = np.zeros(3) if glowing is None else np.ones(3)
        shine = self._numbers(rows, "ns", 1)
        rough, metallic = self._numbers(rows, "pr", 1), self._numbers(rows, "pm", 1)
        if rough is None:
            rough = (2.0 / (np.maximum(np.zeros(1) if shine is None else shine, 0.0) + 2.0)) ** 0.25
        opacity = 1.0 if alpha is None else float(np.clip(alpha[0], 0.0, 1.0))
        if clear is not None:
            painted = self._with_alpha(painted, clear)
        with named(self._name, f"material {self._label!r}"):
            return Material(
                name=self._label,
                base_color=(*np.clip(color, 0.0, 1.0), opacity),
                metallic=0.0 if metallic is None else float(np.clip(metallic[0], 0.0, 1.0)),
                roughness=float(np.clip(rough[0], 0.0, 1.0)),
                emissive=np.maximum(glow, 0.0),
                base_color_texture=painted,
                normal_texture=self._texture(rows, "norm"),
                emissive_texture=glowing,
                alpha_mode="mask" if clear is not None else "blend" if opacity < 1.0 else "opaque",
            )

    def _numbers(self, rows: dict[str, str], key: str, count: int) -> NDArray[np.float64] | None:
        words = rows.get(key, "").split()
        if not words or words[0] in ("spectral", "xyz"):
            return None
        words = [word for word in words if word != "-halo"]
        try:
            values = np.array([float(word) for word in words[:count]])
        except ValueError:
            values = np.zeros(0)
        if len(values) == 1:
            values = np.repeat(values, count)
        if len(values) != count or not np.isfinite(values).all():
            where = f"{self._name}: material {self._label!r}: {key}"
            raise FormatError(f"{where}: expected {count} numbers, found {rows[key]!r:.40}")
        return values

    def _texture(self, rows: dict[str, str], key: str) -> Texture | None:
        if key not in rows:
            return None
        options: dict[str, Any] = dict.fromkeys(_VECTORS, np.zeros(3))
        options["-s"], options["wrap"] = np.ones(3), "repeat"
        file = _without_options(rows[key], options)
        # Some writers put options after the name, which may contain such words too.
        words, more = file.split(), dict(options)
        last = next((k for k in range(1, len(words)) if words[k].lower() in (*_OPTIONS, *_VECTORS)), None)
        names = [file]
        if last is not None and not _without_options(" ".join(words[last:]), more):
            names.append(" ".join(words[:last]))
            folder = self._pictures.folder
            if folder is None or find(folder, file) is None:
                names, options = names[::-1], more
        image = self._pictures.get(f"{self._name}: material {self._label!r}: {key}", *names)
        if image is None:
            return None
        wrap = options["wrap"]
        # Offsets of MTL count from below, those of `Texture` from above.
        (su, sv, _), (ou, ov, _) = options["-s"], options["-o"]
        return Texture(image, wrap=wrap, offset=(ou, 1.0 - sv - ov), scale=(su, sv))

    def _with_alpha(self, painted: Texture | None, clear: Texture) -> Texture:
        """Return colours with the alpha of another image, white where there are none."""
        holes = clear.image.pixels
        alpha = holes[..., -1 if holes.shape[2] in (2, 4) else 0]
        if painted is None:
            colors = np.full((*alpha.shape, 3), _one(alpha), alpha.dtype)
        elif painted.image is clear.image and holes.shape[2] in (2, 4):
            return painted
        else:
            colors = painted.image.pixels[..., :3]
            if colors.shape[2] < 3:
                colors = np.repeat(colors[..., :1], 3, axis=2)
        if colors.shape[:2] != alpha.shape or colors.dtype != alpha.dtype:
            self._notes.add("map_d of another size or type than map_Kd", self._label)
            return painted or clear
        rest: dict[str, Any] = {"wrap": clear.wrap, "offset": clear.offset, "scale": clear.scale}
        if painted is not None:
            rest = {"wrap": painted.wrap, "offset": painted.offset, "scale": painted.scale}
        return Texture(Image(np.dstack([colors, alpha])), **rest)


def _without_options(rest: str, options: dict[str, Any]) -> str:
    """Fill in the leading options; return the rest."""
    words = rest.split()
    while words and words[0].lower() in (*_OPTIONS, *_VECTORS):
        option = words.pop(0).lower()
        rest = rest.split(None, 1)[1] if words else ""
        taken = _OPTIONS.get(option, 0)
        if option in _VECTORS:
            values: list[float] = []
            while len(values) < min(3, len(words)) and _is_number(words[len(values)]):
                values.append(float(words[len(values)]))
            options[option] = np.array(values + [_VECTORS[option]] * (3 - len(values)))
            taken = len(values)
        elif option == "-clamp" and words[:1] == ["on"]:
            options["wrap"] = "clamp"
        del words[:taken]
        for _ in range(taken):
            rest = rest.split(None, 1)[1] if len(rest.split(None, 1)) > 1 else ""
    return rest.strip()


def _one(array: NDArray[Any]) -> float:
    return 1.0 if array.dtype.kind == "f" else float(np.iinfo(array.dtype).max)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
