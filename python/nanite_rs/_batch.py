"""Many small pictures in one call: chunks of views of one scene, shared out among threads that draw alone."""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _core
from nanite_rs.camera import Camera
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

Item = tuple[Scene, Camera, Any]

# Views of a chunk, and pixels, at most: what is drawn is copied while it is in the cache.
_VIEWS: Final = 64
_PIXELS: Final = 1 << 19


def checked(items: Iterable[Any]) -> list[Item]:
    """The items, each a scene, a camera and a pose; an error says which is not."""
    found: list[Item] = []
    for place, item in enumerate(items):
        if not (isinstance(item, tuple | list) and len(item) == 3):
            raise DtypeError(f"items[{place}]: expected a scene, a camera and a pose, not {item!r:.80}")
        scene, camera, pose = item
        if not isinstance(scene, Scene):
            raise DtypeError(f"items[{place}]: expected a Scene, not {_advice.name_of_type(scene)}")
        if not isinstance(camera, Camera):
            raise DtypeError(f"items[{place}]: expected a camera, not {_advice.name_of_type(camera)}")
        try:
            _core.check_pose(pose)
        except ArgumentError as error:
            raise ArgumentError(f"items[{place}]: {error}") from None
        found.append((scene, camera, pose))
    return found


def _chunks(items: Sequence[Item], start: int, most: int) -> Iterator[slice]:
    """Items from one on that follow each other and show one scene."""
    for end in range(start + 1, len(items) + 1):
        # What assemblies become is one choice for all views of a call.
        alone = items[start][0]._core.assembly_count > 0
        if end == len(items) or end - start == most or items[end][0] is not items[start][0] or alone:
            yield slice(start, end)
            start = end


def _array(frame: _core.Frame, name: str) -> NDArray[Any]:
    """An output: pictures of debug views are no methods."""
    method = getattr(frame, name, None)
    array: NDArray[Any] = frame.view(name) if method is None else method()
    return array


class Arrays:
    """One array for each output, made when the first picture says of which shape, or given by the caller."""

    def __init__(self, count: int, outputs: Sequence[str], given: Mapping[Any, Any] | None) -> None:
        self._count, self._outputs = count, outputs
        self.made: dict[str, NDArray[Any]] = {}
        """In the order of the outputs, once there was a picture."""
        self._given = dict(given or {})
        for name, array in self._given.items():
            if name not in outputs:
                raise ArgumentError(f"out[{name!r}]: outputs= does not name it")
            if not isinstance(array, np.ndarray):
                raise DtypeError(f"out[{name!r}]: expected an array, not {_advice.name_of_type(array)}")
            if not array.flags.writeable:
                raise ArgumentError(f"out[{name!r}]: is read-only")

    def make(self, frame: _core.Frame) -> None:
        """Make those that are missing, and check the others, by a first picture."""
        for name in self._outputs:
            one, array = _array(frame, name), self._given.get(name)
            shape = (self._count, *one.shape)
            if array is None:
                array = np.empty(shape, one.dtype)
            elif array.shape != shape or array.dtype != one.dtype:
                raise ArgumentError(
                    f"out[{name!r}]: expected {one.dtype} of shape {shape}, not {array.dtype} of {array.shape}"
                )
            self.made[name] = array

    def put(self, at: slice, frames: list[_core.Frame]) -> None:
        """Copy pictures to where they belong."""
        for number, frame in zip(range(at.start, at.stop), frames, strict=True):
            for name, array in self.made.items():
                array[number] = _array(frame, name)


def render(
    items: list[Item],
    arrays: Arrays,
    options: dict[str, Any],
    pixels: int,
    renderers: Callable[[], list[_core.Renderer]],
) -> dict[str, NDArray[Any]]:
    """Draw all items, each chunk by whichever renderer is free."""

    def frames(renderer: _core.Renderer, at: slice) -> list[_core.Frame]:
        views: list[_core._View] = [
            (camera._spec(), pose, place, None, None, None, None)
            for place, (_, camera, pose) in enumerate(items[at])
        ]
        return renderer.render(items[at.start][0]._core, views, options)

    if not items:
        return {}
    crew = renderers()
    # The first says of which shape arrays are.
    first = frames(crew[0], slice(0, 1))
    arrays.make(first[0])
    arrays.put(slice(0, 1), first)
    waiting = deque(_chunks(items, 1, max(1, min(_VIEWS, _PIXELS // pixels))))

    def work(renderer: _core.Renderer) -> None:
        while True:
            try:
                own = waiting.popleft()
            except IndexError:
                return
            arrays.put(own, frames(renderer, own))

    if len(crew) == 1:
        work(crew[0])
    else:
        with ThreadPoolExecutor(len(crew)) as pool:
            for done in [pool.submit(work, renderer) for renderer in crew]:
                done.result()
    return arrays.made
