"""Materials of Wavefront OBJ files, read from the MTL files beside them: trimesh is silent on what it cannot read.

Colours are taken as linear, as trimesh and pyrender take them; ``Ns`` becomes a roughness as it does there.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice
from nanite_rs._accessors import beside
from nanite_rs._asset import named
from nanite_rs._images import read_bytes, read_image
from nanite_rs.exceptions import FileError, FormatError, MissingFileError
from nanite_rs.material import TRANSPARENCY, Material
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes

# Options of texture maps that take so many words; those of up to three numbers are told apart by looking.
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
_LEFT: Final = ("map_bump", "bump", "map_ns", "map_ks", "map_pr", "map_pm", "disp", "refl")


def read(
    name: str, text: bytes, folder: Path, *, drop_bad_textures: bool, notes: Notes
) -> dict[str, Material]:
    """Read the materials that an OBJ file refers to, by their names."""
    found: dict[str, Material] = {}
    images: dict[Path, Image | None] = {}
    for line in re.findall(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", text, re.MULTILINE):
        library = line.decode("utf-8", "replace")
        path = beside(folder, library, *library.split())
        try:
            content = read_bytes(path, f"{name}: mtllib")
        except MissingFileError:
            notes.add("materials of files that are missing", library)
            continue
        for label, rows in _materials(content.decode("utf-8", "replace")).items():
            reader = _Reader(name, label, path.parent, images, drop_bad_textures, notes)
            found[label] = reader.material(rows)
    return found


def _materials(text: str) -> dict[str, dict[str, str]]:
    """Statements of each material by their first words, which are lowered."""
    materials: dict[str, dict[str, str]] = {}
    rows: dict[str, str] = {}
    for line in text.splitlines():
        key, _, rest = line.strip().partition(" " if "\t" not in line.strip().split(" ")[0] else "\t")
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            rows = materials.setdefault(" ".join(rest.split()), {})
        elif rest and not key.startswith("#"):
            rows[key] = rest
    return materials


class _Reader:
    """The statements of one material."""

    def __init__(
        self, name: str, label: str, folder: Path, images: dict[Path, Image | None], drop: bool, notes: Notes
    ) -> None:
        self._name, self._label, self._folder = name, label, folder
        self._images, self._drop, self._notes = images, drop, notes

    def material(self, rows: dict[str, str]) -> Material:
        for key in _LEFT:
            if key in rows:
                self._notes.add(f"{key} of MTL files", self._label)
        painted, clear = self._texture(rows, "map_kd"), self._texture(rows, "map_d")
        glowing = self._texture(rows, "map_ke")
        alpha = self._numbers(rows, "d", 1)
        # Some write transparency into Tr, some opacity: nobody means what is all transparent.
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
        if opacity < 1.0:
            self._notes.add(TRANSPARENCY, self._label)
        if clear is not None:
            painted = self._with_alpha(painted, clear)
        with named(self._name, f"material {self._label!r}"):
            return Material(
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
        words, options = rows[key].split(), dict.fromkeys(_VECTORS, np.zeros(3))
        options["-s"], wrap = np.ones(3), "repeat"
        while words and words[0].lower() in (*_OPTIONS, *_VECTORS):
            option = words.pop(0).lower()
            if option in _VECTORS:
                values: list[float] = []
                while words and len(values) < 3 and _is_number(words[0]):
                    values.append(float(words.pop(0)))
                options[option] = np.array(values + [_VECTORS[option]] * (3 - len(values)))
                continue
            wrap = "clamp" if option == "-clamp" and words[:1] == ["on"] else wrap
            del words[: _OPTIONS[option]]
        image = self._image(" ".join(words), key)
        if image is None:
            return None
        # Those of MTL count from below, those of `Texture` from above.
        (su, sv, _), (ou, ov, _) = options["-s"], options["-o"]
        return Texture(image, wrap=wrap, offset=(ou, 1.0 - sv - ov), scale=(su, sv))  # type: ignore[arg-type]

    def _image(self, file: str, key: str) -> Image | None:
        path = beside(self._folder, file, file.replace("\\", "/").rsplit("/", 1)[-1])
        if path not in self._images:
            what = f"{self._name}: material {self._label!r}: {key}"
            try:
                self._images[path] = Image(read_image(read_bytes(path, what), f"{what}: {path}"))
            except (FileError, FormatError) as error:
                if not self._drop:
                    raise _advice.advised(error, _advice.WITHOUT_TEXTURE) from None
                self._images[path] = None
                self._notes.add("textures left out, as they cannot be read", str(error))
        return self._images[path]

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


def _one(array: NDArray[Any]) -> float:
    return 1.0 if array.dtype.kind == "f" else float(np.iinfo(array.dtype).max)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
