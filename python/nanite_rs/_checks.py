"""Values of arguments: each check returns the value as Python's own, or raises the error that names its argument.

Ranges are those that Rust refuses by: tests hold both together.
"""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Precision: TypeAlias = Literal["auto", "exact"] | float
Color: TypeAlias = "Sequence[float] | NDArray[Any]"
Rgb: TypeAlias = tuple[float, float, float]


def number(value: Any, name: str) -> float:
    """Return a number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise DtypeError(f"{name}: expected a number, not {type(value).__name__}")
    return float(value)


def _single(value: Any, name: str) -> float:
    """A number rounded to single precision, as Rust takes it."""
    with np.errstate(over="ignore"):
        return float(np.float32(number(value, name)))


def finite(value: Any, name: str) -> float:
    """Return a finite number."""
    if not math.isfinite(_single(value, name)):
        raise ArgumentError(f"{name}: must be finite, not {value}")
    return float(value)


def not_negative(value: Any, name: str) -> float:
    """Return a finite number from 0."""
    if not 0.0 <= _single(value, name) < math.inf:
        raise ArgumentError(f"{name}: must be finite and not negative, not {value}")
    return float(value)


def unit(value: Any, name: str) -> float:
    """Return a number from 0 to 1."""
    if not 0.0 <= _single(value, name) <= 1.0:
        raise ArgumentError(f"{name}: must be between 0 and 1, not {value}")
    return float(value)


def reduction(value: Any, name: str = "target_reduction") -> float:
    """Return the part of the triangles to remove, 0 to 1."""
    part = number(value, name)
    if not 0.0 <= part <= 1.0:
        percent = f"; {part:g} % is {part / 100:g}" if 1.0 < part <= 100.0 else ""
        raise ArgumentError(f"{name}: must be between 0 and 1, not {part}{percent}")
    return part


def whole(value: Any, name: str, least: int, most: int | None = None) -> int:
    """Return a whole number from one to another."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise DtypeError(f"{name}: expected an integer, not {type(value).__name__}")
    if value < least or (most is not None and value > most):
        allowed = f"{least} or more" if most is None else f"between {least} and {most}"
        raise ArgumentError(f"{name}: must be {allowed}, not {value}")
    return int(value)


def truth(value: Any, name: str) -> bool:
    """Return True or False."""
    if not isinstance(value, bool | np.bool_):
        raise DtypeError(f"{name}: expected True or False, not {type(value).__name__}")
    return bool(value)


def choice(value: Any, name: str, allowed: Sequence[str]) -> str:
    """Return one of some names; an error suggests the nearest."""
    if value not in allowed:
        *others, last = (f'"{one}"' for one in allowed)
        found = f'"{value}"' if isinstance(value, str) else repr(value)
        raise _advice.near(ArgumentError(f"{name}: must be {', '.join(others)} or {last}, not {found}"))
    return str(value)


def rgb(value: Color, name: str) -> Rgb:
    """Three floats; a fourth (alpha) is accepted and ignored, as pyrender's users are used to give it."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise DtypeError(f"{name}: expected three numbers, not {value!r}") from None
    if array.shape not in {(3,), (4,)}:
        raise ArgumentError(f"{name}: expected three numbers, found shape {array.shape}")
    return float(array[0]), float(array[1]), float(array[2])


def bright(value: Color, name: str) -> Rgb:
    """The same of what may exceed 1."""
    found = rgb(value, name)
    if _advice.is_of_bytes(found):
        _advice.warn(f"{name}: {found} looks like 0 to 255; colours are 0 to 1: divide by 255", UsageWarning)
    return found


def numbers(value: Any, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    """Return a copy of finite numbers of a shape."""
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise DtypeError(f"{name}: expected numbers of shape {shape}, not {value!r}") from None
    if array.shape != shape:
        raise ArgumentError(f"{name}: expected shape {shape}, found {array.shape}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: must be finite")
    return array


def precision(value: Precision) -> tuple[str, float | None]:
    """Return what positions of a file are rounded to as the core takes it: a name, or a step."""
    return (value, None) if isinstance(value, str) else ("auto", number(value, "precision"))


def path_of(value: object, name: str = "path") -> str:
    """Return a path as a string.

    Raises
    ------
    DtypeError
        It is no path.
    """
    if isinstance(value, str | bytes | os.PathLike):
        try:
            path = os.fsdecode(value)
        except (TypeError, ValueError) as error:
            raise DtypeError(f"{name}: {error}") from None
        if not path:
            raise ArgumentError(f"{name}: the name is empty")
        return path
    raise DtypeError(f"{name}: expected a path, not {_advice.name_of_type(value)}")
