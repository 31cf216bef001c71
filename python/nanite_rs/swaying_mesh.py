"""`SwayingMesh`: a virtual mesh whose vertices follow waves, as leaves follow wind."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from nanite_rs import _advice, _checks
from nanite_rs._geometry import Geometry, Moving
from nanite_rs.exceptions import DtypeError
from nanite_rs.mesh import NaniteMesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike
    from typing_extensions import Self

    from nanite_rs._core import Waves as CoreWaves

__all__ = ["SwayingMesh", "Wave"]


@dataclass(frozen=True)
class Wave:
    """A displacement of vertices that comes and goes: a · w · sin 2π (f · t + p + κ · x).

    Parameters
    ----------
    amplitude : (3,)
        a: how far a vertex of weight 1 goes at most, and which way, in the mesh's units.
    frequency : float
        f: how often it comes and goes, hertz, with t in seconds; of any sign.
    vector : (3,)
        κ: turns per unit of length along each axis, as waves that run through the mesh have them, towards −κ where
        the frequency is above 0. By default all vertices turn together.
    weight : str, optional
        w: a floating-point channel of one column; 1 without one.
    offset : str, optional
        p: a floating-point channel of one column, turns, from −4,096 to 4,096; 0 without one.

    Raises
    ------
    ArgumentError, DtypeError
        Not finite, or of another shape.
    """

    amplitude: tuple[float, float, float]
    frequency: float = 1.0
    vector: tuple[float, float, float] = (0.0, 0.0, 0.0)
    weight: str | None = None
    offset: str | None = None

    def __post_init__(self) -> None:
        """Check what was given."""
        for name in ("amplitude", "vector"):
            object.__setattr__(self, name, _vector(getattr(self, name), name))
        object.__setattr__(self, "frequency", _checks.finite(self.frequency, "frequency"))
        for name in ("weight", "offset"):
            if not isinstance(getattr(self, name), str | None):
                raise DtypeError(
                    f"{name}: expected the name of a channel, not {type(getattr(self, name)).__name__}"
                )


class SwayingMesh(Geometry, Moving):
    """A mesh of any size with levels of detail, whose vertices follow waves.

    A vertex at x goes to x + Σ aₖ wₖ sin 2π (fₖ t + pₖ + κₖ · x), where weights w and offsets p are channels of
    the mesh, which building carries along as it does colours: what engines call world position offset. `move`
    sets the time t; cuts and frames then show the mesh as it is there. What they state of their error holds at
    any time: it is the error at rest, times one more than `lipschitz`, and what the channels of the level
    deviate, as far as they move points (docs/numerics.md). Boxes are grown by how far their vertices go at
    most, so that groups, boxes and errors are the same at all times. Frames move those clusters alone that are
    seen. Normals stay those at rest. The CPU moves clusters on both backends; to a device go the positions of
    all clusters with each time.

    ``copy.copy`` gives one with a time of its own, which costs no measuring: for trees of a forest that do not sway
    as one.

    Parameters
    ----------
    mesh : NaniteMesh
        The mesh at rest, with its looks.
    waves : sequence of Wave
        What moves it; none lets it rest.

    Raises
    ------
    ArgumentError
        A channel is not there, is none of one floating-point column, or has offsets beyond 4,096 turns; the waves
        take the mesh beyond what float64 holds.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
    >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, channels={"up": np.clip(vertices[:, 2], 0, 1)})
    >>> body = nrs.SwayingMesh(mesh, [nrs.Wave((0.5, 0, 0), frequency=0.25, weight="up")])
    >>> body.move(1.0)
    >>> bool(abs(body.cut(error=0.01).vertices[:, 0].max() - 1.118) < 0.02)
    True
    """

    __slots__ = ("_measured", "_rest", "_time", "_waves")

    _measured: CoreWaves
    _rest: NaniteMesh
    _time: float
    _waves: tuple[Wave, ...]

    @_advice.teaches(otherwise="give SwayingMesh(mesh, [nrs.Wave((0.1, 0, 0), weight='channel')])")
    def __init__(self, mesh: NaniteMesh, waves: Iterable[Wave]) -> None:
        if not isinstance(mesh, NaniteMesh):
            raise DtypeError(f"mesh: expected a NaniteMesh, not {type(mesh).__name__}")
        if not isinstance(waves, Iterable):
            raise DtypeError(f"waves: expected a sequence of Wave, not {type(waves).__name__}")
        given = tuple(waves)
        for number, wave in enumerate(given):
            if not isinstance(wave, Wave):
                raise DtypeError(f"waves[{number}]: expected a Wave, not {type(wave).__name__}")
        raw = [(wave.amplitude, wave.frequency, wave.vector, wave.weight, wave.offset) for wave in given]
        self._start(mesh, given, mesh._core.waves(raw), 0.0)

    def _start(self, mesh: NaniteMesh, waves: tuple[Wave, ...], measured: CoreWaves, time: float) -> None:
        self._measured, self._rest, self._waves, self._time = measured, mesh, waves, time
        self._materials = mesh.materials
        self._core = measured.at(time)
        self._scenes = weakref.WeakSet()

    @property
    def rest(self) -> NaniteMesh:
        """The mesh at rest."""
        return self._rest

    @property
    def waves(self) -> tuple[Wave, ...]:
        """What moves it."""
        return self._waves

    @property
    def time(self) -> float:
        """The time it is at, seconds."""
        return self._time

    @property
    def largest(self) -> float:
        """How far any vertex goes at most, at any time, in the mesh's units: an upper bound."""
        return self._measured.largest

    @property
    def lipschitz(self) -> float:
        """How much farther apart two points with the same channels may be at any time, as a part of their distance.

        An upper bound: Σ 2π ‖aₖ‖ · max ‖wₖ‖ · ‖κₖ‖.
        """
        return self._measured.lipschitz

    def move(self, time: float) -> None:
        """Set the time: all instances in all scenes show it from now on.

        Frames that were rendered before keep theirs.

        Parameters
        ----------
        time : float
            Seconds, of any sign.

        Raises
        ------
        ArgumentError, DtypeError
            Not a finite number. The mesh stays as it was.
        """
        given = _checks.finite(time, "time")
        self._move(self._measured.at(given))
        self._time = given

    def __copy__(self) -> Self:
        """Return one with a time of its own; what was measured is shared."""
        copied = object.__new__(type(self))
        copied._start(self._rest, self._waves, self._measured, self._time)
        return copied

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _from_parts, (self._rest, self._waves, self._time)

    def __repr__(self) -> str:
        """Sizes."""
        return f"SwayingMesh({len(self):,} faces, {len(self._waves):,} waves, {self._time:g} s)"


def _vector(value: ArrayLike, name: str) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in _checks.numbers(value, (3,), name))
    return x, y, z


def _from_parts(mesh: NaniteMesh, waves: tuple[Wave, ...], time: float) -> SwayingMesh:
    swaying = SwayingMesh(mesh, waves)
    swaying.move(time)
    return swaying
