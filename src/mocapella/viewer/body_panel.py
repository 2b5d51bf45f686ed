"""What stands beside followed bodies: how it goes, how well each camera agrees, angles over time, and the controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Final

import msgspec
import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from mocapella.model.outline_colours import INSIDE, OUTSIDE, Colour, body_colour, css
from mocapella.viewer.body_stage import ShownBody, overlap_colour
from mocapella.viewer.palette import AMBER, BLUE, GREEN, GREY
from mocapella.viewer.picture_plane import Encoded

Float64 = NDArray[np.float64]

WINDOW_S: Final = 5.0
"""So much of the angles is shown."""
ALL: Final = "bodies and pictures"
CHARTS: Final = ("knee flexion", "hip flexion")
"""What is shown at first, where the model has it."""
_COLOURS: Final = ("#5eb0ff", "#ff9f1c", "#9ae648", "#ff5ca8", "#b084ff", "#ffe240")


class EncodedPicture(msgspec.Struct, frozen=True, eq=False):
    """A camera's picture as a file."""

    image: bytes
    format: str = "jpeg"


class BodyViewFrame(msgspec.Struct, frozen=True, eq=False):
    """What is shown of one frame.

    Attributes:
        frame: its number in the videos.
        time_s: of capture.
        bodies: by name; the empty one where nobody named the only one.
        pictures: by camera.
    """

    frame: int
    time_s: float
    bodies: Mapping[str, ShownBody]
    pictures: Mapping[str, Encoded]

    @property
    def lost(self) -> bool:
        """Whether nobody is there."""
        return all(one.lost for one in self.bodies.values())


def groups(joint_names: Sequence[str]) -> dict[str, list[int]]:
    """Joints that belong in one chart: left and right of the same name, or one alone; in the model's order."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(joint_names):
        plain = name.removeprefix("left ").removeprefix("right ")
        found.setdefault(plain, []).append(k)
    return found


class Chart:
    """Angles [°] of one group of one body's joints over time."""

    def __init__(self, gui: viser.GuiApi, names: Sequence[str], first: str) -> None:
        self._gui, self._names, self._groups = gui, tuple(names), groups(names)
        self._folder = gui.add_folder(_title(first), expand_by_default=True)
        with self._folder:
            self._choice = gui.add_dropdown("Angle", tuple(self._groups), initial_value=first)
            self._handle: viser.GuiUplotHandle | None = None
        self._shown: tuple[str, tuple[str, ...]] = ("", ())

    def draw(self, names: Sequence[str], at_s: Float64, angles: Float64) -> None:
        """Show these: (n,) [s] and (n, joints) [rad] of joints of those names."""
        if tuple(names) != self._names:
            self._names, self._groups = tuple(names), groups(names)
            self._choice.options = tuple(self._groups)  # one that it does not have becomes the first that it has
        chosen = str(self._choice.value)
        columns = self._groups[chosen]
        data = (at_s, *(np.degrees(angles[:, k]) for k in columns))
        if (chosen, self._names) == self._shown and self._handle is not None:
            self._handle.data = data
            return
        if self._handle is not None:
            self._handle.remove()
        self._shown = chosen, self._names
        self._folder.label = _title(chosen)
        series = [uplot.Series(label="s")]
        for k, colour in zip(columns, _COLOURS, strict=False):
            label = self._names[k].removesuffix(chosen).strip() or "angle"
            series.append(uplot.Series(label=label, stroke=colour, width=2))
        axis = uplot.Axis(stroke="#8a97ab", grid=uplot.Axis_Grid(stroke="#2c384c"), size=42)
        with self._folder:
            self._handle = self._gui.add_uplot(
                data, tuple(series), scales={"x": uplot.Scale(time=False)}, axes=(axis, axis), aspect=2.1,
                legend=uplot.Legend(show=True), padding=(10, 8, 0, 0),
            )  # fmt: skip


class BodyPanel:
    """Its handles; callbacks leave wishes, which the loop that draws takes.

    Attributes:
        wish: the place among the frames that somebody chose, until it is taken; None: nobody did.
        playing: whether it goes on by itself.
        aim: what to look at: `ALL`, or one camera's picture.

    Args:
        gui: of the page.
        joint_names: of each body, by its name.
        cameras: of the pictures.
    """

    def __init__(self, gui: viser.GuiApi, joint_names: Mapping[str, Sequence[str]], cameras: Sequence[str]) -> None:
        self.wish: int | None = None
        self.playing = True
        self._said: tuple[str, str] = ("", "")
        self._status = gui.add_html(status_html("Getting ready", None, 0, 0))
        self._button = gui.add_button("Pause")
        self._slider = gui.add_slider("Frame", 0, 1, 1, 0)
        self.aim = gui.add_dropdown("Look at", (ALL, *cameras), initial_value=ALL)
        self._cameras = gui.add_html("")
        self._joint_names = joint_names
        self._whose = gui.add_dropdown("Angles of", tuple(joint_names)) if len(joint_names) > 1 else None
        names = next(iter(joint_names.values()))
        known = groups(names)
        chosen = [name for name in CHARTS if name in known] or list(known)[:2]
        self._charts = [Chart(gui, names, name) for name in chosen]
        self._button.on_click(lambda _event: self._toggle())
        self._slider.on_update(self._moved)

    def draw(self, headline: str, shown: BodyViewFrame, place: int, count: int, cameras: Sequence[str]) -> None:
        """Show a frame: the ``place``-th of ``count``."""
        said = status_html(headline, shown, place, count), cameras_html(shown, cameras)
        if said != self._said:
            self._said = said
            self._status.content, self._cameras.content = said
        if self._slider.max != max(count - 1, 1):
            self._slider.max = max(count - 1, 1)
        if self._slider.value != place:
            self._slider.value = place
        label = "Pause" if self.playing else "Play"
        if self._button.label != label:
            self._button.label = label

    @property
    def whose(self) -> str:
        """The name of the body whose angles are shown."""
        return next(iter(self._joint_names)) if self._whose is None else str(self._whose.value)

    def draw_charts(self, at_s: Float64, angles: Float64) -> None:
        """Show the angles' course, (n,) [s] and (n, joints) [rad], of `whose`."""
        for chart in self._charts:
            chart.draw(self._joint_names[self.whose], at_s, angles)

    def _toggle(self) -> None:
        self.playing = not self.playing

    def _moved(self, event: viser.GuiEvent[viser.GuiSliderHandle[int]]) -> None:
        if event.client is not None:  # somebody, not the loop
            self.playing, self.wish = False, int(event.target.value)


def status_html(headline: str, shown: BodyViewFrame | None, place: int, count: int) -> str:
    """The state in large letters, which frame it is, and who of several is not there; None before the first frame."""
    title, colour, missing = headline, GREEN.css, ""
    if shown is None:
        colour, facts = BLUE.css, "the first pictures are waited for"
    else:
        if shown.lost:
            title, colour = "Nobody is there", AMBER.css
        elif headline == "End":
            colour = BLUE.css
        facts = f"frame {shown.frame} · {shown.time_s:.2f} s · {place + 1} of {count}"
        gone = "" if shown.lost else ", ".join(escape(name) for name, one in shown.bodies.items() if one.lost)
        missing = (
            f'<div style="font-size:13px;margin-top:4px;color:{AMBER.css}">not there: {gone}</div>' if gone else ""
        )
    return (
        '<div class="mocapella-status" style="padding:10px 14px 4px">'
        f'<div style="font-size:30px;line-height:1.15;font-weight:650;letter-spacing:-0.01em;color:{colour}">'
        f"{escape(title)}</div>"
        f'<div style="font-size:13px;margin-top:6px;color:{GREY.css};font-variant-numeric:tabular-nums">{facts}</div>'
        f"{missing}</div>"
    )


def cameras_html(shown: BodyViewFrame, cameras: Sequence[str]) -> str:
    """Each camera's overlap with each body, or why it does not count; what the lines in the pictures are."""
    rows = ""
    if len(shown.bodies) > 1:
        names = "".join(f'<td style="text-align:right">{_mark(k, name)}</td>' for k, name in enumerate(shown.bodies))
        rows = f"<tr><td></td>{names}</tr>"
    for name in cameras:
        rows += f"<tr><td>{escape(name)}</td>{''.join(_agreement(one, name) for one in shown.bodies.values())}</tr>"
        for reason in dict.fromkeys(one.left_out[name] for one in shown.bodies.values() if name in one.left_out):
            span = 1 + len(shown.bodies)
            rows += f'<tr><td colspan="{span}" style="font-size:12px;color:{AMBER.css}">{escape(reason)}</td></tr>'
    models = " ".join(_line(body_colour(k), name or "model") for k, name in enumerate(shown.bodies))
    return (
        '<div class="mocapella-overlaps" style="padding:2px 12px 8px;font-size:13px;line-height:1.45;'
        'font-variant-numeric:tabular-nums"><b>Outlines agree</b>'
        f'<table style="width:100%;border-spacing:0">{rows}</table>'
        f'<div class="mocapella-legend" style="font-size:12px;color:{GREY.css};margin-top:4px">{models}<br>'
        f"the image's outline is {_line(OUTSIDE, 'outside')} {_line(INSIDE, 'inside')} of the model's</div></div>"
    )


def _title(joint: str) -> str:
    return f"{joint.capitalize()} [°]"


def _agreement(body: ShownBody, camera: str) -> str:
    overlap = body.overlap.get(camera)
    reason = body.left_out.get(camera, "")
    told = f"{overlap:.0%}" if overlap is not None else "left out" if reason else "not in the image"
    colour = AMBER.css if reason else overlap_colour(overlap).css
    return f'<td style="text-align:right;color:{colour}">{told}</td>'


def _mark(number: int, name: str) -> str:
    return f'<span style="color:{css(body_colour(number))}">{escape(name)}</span>'


def _line(colour: Colour, words: str) -> str:
    return f'<span style="white-space:nowrap"><span style="color:{css(colour)}">▬</span> {escape(words)}</span>'
