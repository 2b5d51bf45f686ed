"""Panel folder of fitted bodies: the overlap of the silhouettes in each camera, and charts of the joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Final

import numpy as np

from mocapella.model.outline_colours import INSIDE, OUTSIDE, Colour, body_colour, css
from mocapella.model.scene import TrackedBody, TrackedBodyView
from mocapella.viewer.charts import Chart, groups
from mocapella.viewer.inputs import set_value
from mocapella.viewer.palette import AMBER, GREY, Rgb
from mocapella.viewer.part_panel import PanelPlace, PanelState

WINDOW_S: Final = 5.0
"""Time span of the charts [s]."""
CHARTS_EVERY_S: Final = 0.2
CHARTS: Final = ("knee flexion", "hip flexion")
"""Groups of joint angles charted at first (`mocapella.viewer.charts.groups`); without these, the body's first two."""
GOOD_OVERLAP: Final = 0.7
_PLAIN: Final = Rgb(222, 228, 238)


class BodyPanel:
    """The folder "Bodies" of one browser's panel, visible from the first tracked body on.

    Args:
        place: the browser's controls and the folder's position among the others.
    """

    def __init__(self, place: PanelPlace) -> None:
        self._gui = place.gui
        self._folder = place.gui.add_folder("Bodies", order=place.order, visible=False)
        with self._folder:
            self._outlines = place.gui.add_html("")
            self._whose = place.gui.add_dropdown("Angles of", ("–",), visible=False)
        self._charts: list[Chart] = []
        self._visible, self._charted_s = False, -CHARTS_EVERY_S
        self._had = False
        self._said = ""

    @property
    def whose(self) -> str:
        """Name of the body whose joint angles the charts show."""
        return str(self._whose.value)

    def show(self, state: PanelState) -> None:
        """Update the overlaps, and the charts at most every `CHARTS_EVERY_S`.

        ``state.parts`` are the scene's `TrackedBody` values. The charts have the last `WINDOW_S` of the chosen body;
        without bodies they do not change.
        """
        bodies: Sequence[TrackedBody] = state.parts
        self._had = self._had or bool(bodies)
        if (visible := state.visible and self._had) != self._visible:
            self._visible = self._folder.visible = visible
        if not visible:
            return
        said = outlines_html(bodies)
        if said != self._said:
            self._said = self._outlines.content = said
        names = tuple(called(body) for body in bodies)
        if names and names != tuple(self._whose.options):
            chosen = self._whose.value
            self._whose.options = names
            set_value(self._whose, chosen if chosen in names else names[0])
            self._whose.visible = len(names) > 1
        if bodies and state.now_s - self._charted_s >= CHARTS_EVERY_S:
            self._charted_s = state.now_s
            self._draw_charts(next((one for one in bodies if called(one) == self.whose), bodies[0]), state)

    def _draw_charts(self, body: TrackedBody, state: PanelState) -> None:
        if not body.joint_names:
            return
        if not self._charts:
            known = groups(body.joint_names)
            chosen = [name for name in CHARTS if name in known] or list(known)[:2]
            with self._folder:
                self._charts = [Chart(self._gui, body.joint_names, name) for name in chosen]
        times, scenes = state.lately(WINDOW_S)
        found = [(at_s, one) for at_s, scene in zip(times, scenes, strict=True) for one in scene.bodies]
        same = [(at_s, one) for at_s, one in found if (one.id, one.joint_names) == (body.id, body.joint_names)]
        if not same:
            return
        at_s, angles = np.array([at_s for at_s, _ in same]), np.array([one.angles for _, one in same])
        for chart in self._charts:
            chart.draw(body.joint_names, at_s, angles)


def called(body: TrackedBody) -> str:
    """Return a body's name, or ``body`` and its id if it has none."""
    return body.name or f"body {body.id}"


def outlines_html(bodies: Sequence[TrackedBody]) -> str:
    """Return the overlap of model and silhouette for each camera and body as HTML, with a legend of the lines.

    If a camera's image is not used, the reason is shown.
    """
    cameras = dict.fromkeys(view.camera for body in bodies for view in body.views)
    gone = ", ".join(escape(called(body)) for body in bodies if body.lost and body.name)
    missing = f'<div style="color:{AMBER.css}">not there: {gone}</div>' if gone else ""
    if not cameras:
        words = "" if bodies else f'<div style="color:{GREY.css}">No body is fitted.</div>'
        return _box(f"{words}{missing}")
    rows = ""
    if len(bodies) > 1:
        names = "".join(f'<td style="text-align:right">{_mark(k, called(one))}</td>' for k, one in enumerate(bodies))
        rows = f"<tr><td></td>{names}</tr>"
    for name in cameras:
        views = [_view(body, name) for body in bodies]
        rows += f"<tr><td>{escape(name)}</td>{''.join(map(_agreement, views))}</tr>"
        for reason in dict.fromkeys(view.left_out for view in views if view is not None and view.left_out):
            span = 1 + len(bodies)
            rows += f'<tr><td colspan="{span}" style="font-size:12px;color:{AMBER.css}">{escape(reason)}</td></tr>'
    models = " ".join(_line(body_colour(k), body.name or "model") for k, body in enumerate(bodies))
    return _box(
        f'{missing}<b>Outlines agree</b><table style="width:100%;border-spacing:0">{rows}</table>'
        f'<div class="mocapella-legend" style="font-size:12px;color:{GREY.css};margin-top:4px">{models}<br>'
        f"the image's outline is {_line(OUTSIDE, 'outside')} {_line(INSIDE, 'inside')} of the model's</div>"
    )


def overlap_colour(overlap: float) -> Rgb:
    """Return the colour of an overlap, 0 to 1: plain from `GOOD_OVERLAP` on, amber below it, grey for NaN (unknown)."""
    return GREY if np.isnan(overlap) else _PLAIN if overlap >= GOOD_OVERLAP else AMBER


def _view(body: TrackedBody, camera: str) -> TrackedBodyView | None:
    return next((view for view in body.views if view.camera == camera), None)


def _agreement(view: TrackedBodyView | None) -> str:
    if view is None:
        return "<td></td>"
    known = not np.isnan(view.overlap)
    told = f"{view.overlap:.0%}" if known else "left out" if view.left_out else "not in the image"
    colour = AMBER.css if view.left_out else overlap_colour(view.overlap).css
    return f'<td style="text-align:right;color:{colour}">{told}</td>'


def _box(content: str) -> str:
    return (
        '<div class="mocapella-overlaps" style="padding:2px 12px 8px;font-size:13px;line-height:1.45;'
        f'font-variant-numeric:tabular-nums">{content}</div>'
    )


def _mark(number: int, name: str) -> str:
    return f'<span style="color:{css(body_colour(number))}">{escape(name)}</span>'


def _line(colour: Colour, words: str) -> str:
    return f'<span style="white-space:nowrap"><span style="color:{css(colour)}">▬</span> {escape(words)}</span>'
