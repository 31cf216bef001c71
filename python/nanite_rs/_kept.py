"""A pickled frame: its arrays, without the memory from which others could be made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from nanite_rs import _core

_ALWAYS: Final = ("color", "rgba", "depth", "normal", "instance_id", "cluster_id", "triangle_id")
"""What goes along whether it was looked at or not."""

_ARRAYS: Final = (
    *_ALWAYS,
    "linear",
    "base_color",
    "shading_normal",
    "orm",
    "emissive",
    "face_id",
    "overdraw",
    "shadow",
    "motion",
)


def kept(
    core: _core.Frame | KeptFrame, made: dict[str, Any], asked_for: Iterable[str], *, depth_only: bool
) -> KeptFrame:
    """Keep of a frame what is always kept, what was ``made``, and what was asked for when it was rendered."""
    names = ("depth",) if depth_only else (*_ALWAYS, *(name for name in asked_for if name in _ARRAYS))
    arrays = {name: made[name] if name in made else getattr(core, name)() for name in dict.fromkeys(names)}
    arrays |= {name: made[name] for name in _ARRAYS if name in made}
    return KeptFrame(
        arrays, core.size, core.stages(), core.stream(), core.totals(), core.shadows(), core.assemblies()
    )


class KeptFrame:
    """Stands where a frame of the core stood."""

    def __init__(
        self,
        arrays: dict[str, NDArray[Any]],
        size: tuple[int, int],
        stages: Any,
        stream: Any,
        totals: Any,
        shadows: Any,
        assemblies: Any,
    ) -> None:
        self._arrays, self.size = arrays, size
        self._counts = stages, stream, totals, shadows, assemblies

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all there is."""
        return KeptFrame, (self._arrays, self.size, *self._counts)

    def stages(self) -> Any:
        """As the frame had it."""
        return self._counts[0]

    def stream(self) -> Any:
        """As the frame had it."""
        return self._counts[1]

    def totals(self) -> Any:
        """As the frame had it."""
        return self._counts[2]

    def shadows(self) -> Any:
        """As the frame had it."""
        return self._counts[3]

    def assemblies(self) -> Any:
        """As the frame had it."""
        return self._counts[4]

    def view(self, name: str, *_: Any) -> NDArray[Any]:
        """Refuse: views are made of the renderer's memory."""
        raise _absent(f"view({name!r})")

    def deep_color(self) -> NDArray[Any]:
        """Refuse: it is made of the renderer's memory."""
        raise _absent("16 bits")

    def deep_rgba(self) -> NDArray[Any]:
        """Refuse: it is made of the renderer's memory."""
        raise _absent("16 bits")

    def __getattr__(self, name: str) -> Callable[[], NDArray[Any]]:
        if name not in _ARRAYS:
            raise AttributeError(name)
        if name not in self._arrays:
            raise _absent(name)
        return lambda: self._arrays[name]


def _absent(name: str) -> ArgumentError:
    return ArgumentError(
        f"{name}: this frame was pickled without it; render with outputs=, or look at it before it is pickled"
    )
