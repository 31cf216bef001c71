"""The controls around a canvas in Jupyter: menu, slider, buttons and text, by ipywidgets."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from nanite_rs import _overlay

if TYPE_CHECKING:
    from nanite_rs._canvas import Binding
    from nanite_rs.viewer import Viewer

HINT = "drag turns, shift and drag moves, the wheel zooms once clicked, a double click centres, a click picks"


def around(viewer: Viewer, binding: Binding) -> Any:
    """The canvas of a viewer with its widgets, which follow the viewer and steer it."""
    import ipywidgets as w

    menu = w.Dropdown(options=viewer.views, value=viewer.view, layout=w.Layout(width="130px"))
    slider = w.FloatLogSlider(
        value=_on_slider(viewer.pixel_error),
        base=2.0,
        min=_overlay.LEAST,
        max=_overlay.MOST,
        step=0.25,
        description="pixel error",
        continuous_update=False,
        readout_format=".3g",
        layout=w.Layout(width="320px"),
    )
    freeze = w.ToggleButton(value=viewer.frozen, description="Freeze", icon="snowflake-o")
    reset, save = w.Button(description="Reset", icon="home"), w.Button(description="Save", icon="download")
    for button in (freeze, reset, save):
        button.layout = w.Layout(width="92px")
    status, picked = w.HTML(), w.HTML(_lines([HINT]))

    # Each control sets the viewer and follows it: assigning an equal value does nothing.
    menu.observe(lambda change: setattr(viewer, "view", change["new"]), "value")
    slider.observe(lambda change: _slide(viewer, change["new"]), "value")
    freeze.observe(lambda change: setattr(viewer, "frozen", change["new"]), "value")
    reset.on_click(lambda _: viewer.reset())
    save.on_click(lambda _: binding.save())

    def follow() -> None:
        menu.value, freeze.value = viewer.view, viewer.frozen
        slider.value = _on_slider(viewer.pixel_error)

    def after_picture() -> None:
        status.value = _lines([" · ".join(binding.status())])
        picked.value = _lines(binding.picked() or [HINT])

    viewer.changed.append(follow)
    binding.moved.append(after_picture)
    follow()
    return w.VBox([w.HBox([menu, slider, freeze, reset, save]), binding.canvas, status, picked])


def _on_slider(pixel_error: float) -> float:
    return float(min(max(pixel_error, 2.0**_overlay.LEAST), 2.0**_overlay.MOST))


def _slide(viewer: Viewer, value: float) -> None:
    # The slider shows its end for values beyond it.
    if value != _on_slider(viewer.pixel_error):
        viewer.pixel_error = value


def _lines(lines: list[str]) -> str:
    return f"<div style='line-height:1.4;font-family:monospace'>{'<br>'.join(map(escape, lines))}</div>"
