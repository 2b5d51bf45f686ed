"""Sliders for a camera's exposure, gain, white balance and others, each in the camera's own range, in one browser."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from html import escape
from typing import Any, Final

import viser

from mocapella.model.camera_controls import ControlDescription
from mocapella.viewer.camera_feed import CameraAnswer, CameraFeed
from mocapella.viewer.inputs import set_value
from mocapella.viewer.palette import AMBER, GREY, RED

SEND_EVERY_S: Final = 0.15
"""Least time between two requests while a slider is moved [s]: a node answers 20 questions a second."""
_AFTER_SLIDERS: Final = 1000.0
_WORDS: Final = {"white_balance_red": "Red balance", "white_balance_blue": "Blue balance"}
"""Labels that are shorter than the names, because the panel is narrow."""
_MOST: Final = 24
"""Largest number of sliders, because a node could describe any number of controls."""

Say = Callable[[str, str, bool], None]
"""Shows a short notice: title, text, and False for an error."""


class CameraSliders:
    """Sliders of one camera's controls, to be put into a folder; callbacks only leave requests, `show` sends them.

    A slider that is moved keeps the user's value until the node has answered; otherwise sliders follow the node, so
    that all browsers agree.

    Args:
        gui: controls of the browser; the widgets are added to its current container.
        feed: sends requests to the cameras' nodes.
        say: shows a short notice in the browser.
        sets: whether the browser may set controls; if not, it only looks.
    """

    def __init__(self, gui: viser.GuiApi, feed: CameraFeed, say: Say, *, sets: bool) -> None:
        self._gui, self._feed, self._say, self._sets = gui, feed, say, sets
        self._camera = ""
        self._shape: tuple[Any, ...] = ()
        self._sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        self._modes: dict[str, viser.GuiCheckboxHandle] = {}
        self._values: dict[str, float] = {}
        self._automatic: dict[str, bool] = {}
        self._wishes: deque[Callable[[], None]] = deque()
        self._known: tuple[ControlDescription, ...] = ()
        self._saved: dict[str, Any] = {}
        self._under_way, self._next_s, self._seen, self._turn = False, -1e9, -1, 0
        self._problem = ""
        self.open = gui.add_checkbox(
            "Camera settings", False, hint="Exposure, gain, white balance and more, in the camera's own ranges"
        )
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._note = gui.add_html("", order=_AFTER_SLIDERS)
            self._save = gui.add_button(
                "Save settings", icon=viser.Icon.DEVICE_FLOPPY, color="teal", order=_AFTER_SLIDERS + 1,
                hint="Into its profile, for the next start",
            )  # fmt: skip
            self._undo = gui.add_button(
                "Undo changes", icon=viser.Icon.ARROW_BACK_UP, color="gray", order=_AFTER_SLIDERS + 2,
                hint="Back to the saved settings",
            )  # fmt: skip
            self._defaults = gui.add_button(
                "Defaults", icon=viser.Icon.RESTORE, color="gray", order=_AFTER_SLIDERS + 3,
                hint="All values as the camera has them by default",
            )  # fmt: skip
        for button, act in ((self._save, self._keep), (self._undo, self._go_back), (self._defaults, self._reset)):
            self._connect(button, act)

    def show(self, camera: str, now_s: float) -> None:
        """Send the user's requests, and update the sliders from the node's newest answer.

        Args:
            camera: the chosen camera; empty for none.
            now_s: the present time on this process's monotonic clock [s].
        """
        if camera != self._camera:
            self._change_camera(camera)
        while self._wishes:
            self._wishes.popleft()()
        self._folder.visible = bool(self.open.value and camera)
        if not self._folder.visible:
            return
        shot = self._feed.want_controls(camera, now_s)
        if shot.answer is not None and shot.number != self._seen:
            self._seen = shot.number
            if not self._busy:  # else it is older than what the user does
                self._take(shot.answer)
        self._write_note(shot.problem, waiting=shot.answer is None)
        if (self._values or self._automatic) and not self._under_way and now_s >= self._next_s:
            self._next_s = now_s + SEND_EVERY_S
            self._send()

    @property
    def _busy(self) -> bool:
        """Whether the node has not yet answered all that the user did; older answers would move sliders back."""
        return bool(self._under_way or self._values or self._automatic)

    @property
    def _changed(self) -> bool:
        saved = self._saved
        on = {control.mode for control in self._known if control.automatic}
        had = saved.get("automatic")
        modes = {control.mode for control in self._known if control.mode}
        if on != ({str(mode) for mode in had} & modes if isinstance(had, list | tuple) else set()):
            return True
        return any(
            isinstance(was := saved.get(control.name), int | float) and abs(control.value - was) > 0.5 * control.step
            for control in self._known
            if not control.automatic
        )

    def _change_camera(self, camera: str) -> None:
        self._turn += 1  # answers still under way are of the camera before
        self._camera, self._seen, self._under_way, self._problem = camera, -1, False, ""
        self._known, self._saved = (), {}
        self._values.clear()
        self._automatic.clear()
        self._build(())

    def _take(self, answer: CameraAnswer) -> None:
        self._known = tuple({control.name: control for control in answer.descriptions or ()}.values())[:_MOST]
        saved = (answer.controls or {}).get("saved")
        self._saved = saved if isinstance(saved, dict) else {}
        shape = tuple((c.name, c.unit, c.least, c.most, c.step, c.mode, c.read_only) for c in self._known)
        if shape != self._shape:
            self._build(shape)
        for control in self._known:
            slider = self._sliders[control.name]
            slider.disabled = not self._sets or control.automatic or control.read_only
            if abs(float(slider.value) - control.value) > 1e-9:
                set_value(slider, min(max(control.value, control.least), control.most))
            if control.mode and self._modes[control.mode].value != control.automatic:
                set_value(self._modes[control.mode], control.automatic)

    def _build(self, shape: tuple[Any, ...]) -> None:
        """Make the sliders anew, because another camera has other controls."""
        for slider in self._sliders.values():
            slider.remove()
        for box in self._modes.values():
            box.remove()
        self._sliders, self._modes, self._shape = {}, {}, shape
        with self._folder:
            for order, control in enumerate(self._known if shape else ()):
                words = _WORDS.get(control.name, control.name.replace("_", " ").capitalize())
                label = f"{words}, {control.unit}" if control.unit else words
                if control.mode and control.mode not in self._modes:
                    self._add_mode(control.mode, order)
                value = min(max(control.value, control.least), control.most)
                slider = self._gui.add_slider(
                    label, control.least, max(control.most, control.least + control.step), control.step, value,
                    order=order + 0.5, hint=f"{control.range_text}; default {control.default:g}",
                )  # fmt: skip
                self._sliders[control.name] = slider
                self._connect_slider(slider, control.name)

    def _add_mode(self, mode: str, order: float) -> None:
        box = self._gui.add_checkbox(
            f"Auto {mode.replace('_', ' ')}", False, order=order, disabled=not self._sets,
            hint="Let the camera set it; colours are found more reliably without",
        )  # fmt: skip
        self._modes[mode] = box

        @box.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                wanted = bool(box.value)
                self._wish(lambda: self._automatic.update({mode: wanted}))

    def _connect_slider(self, slider: viser.GuiSliderHandle[float], name: str) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # not of `_take`
                value = float(slider.value)
                self._wish(lambda: self._values.update({name: value}))

    def _connect(self, button: viser.GuiButtonHandle, act: Callable[[], None]) -> None:
        @button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._wish(act)

    def _wish(self, wish: Callable[[], None]) -> None:
        if self._sets:
            self._wishes.append(wish)

    def _send(self) -> None:
        question = {"ask": "set", "values": dict(self._values), "automatic": dict(self._automatic)}
        self._values.clear()
        self._automatic.clear()
        self._order(question, self._answered)

    def _answered(self, answer: CameraAnswer | None, problem: str) -> None:
        self._problem = problem
        if answer is not None and not self._busy:
            self._take(answer)
        self._feed.hasten(self._camera)

    def _keep(self) -> None:
        def done(answer: CameraAnswer | None, problem: str) -> None:
            title = "Save settings" if answer else "Save settings: not done"
            self._say(title, answer.message if answer else problem, bool(answer))
            self._feed.hasten(self._camera)

        self._order({"ask": "save_controls"}, done)

    def _go_back(self) -> None:
        had = self._saved.get("automatic")
        had = had if isinstance(had, list | tuple) else ()
        self._automatic = {control.mode: control.mode in had for control in self._known if control.mode}
        values = {
            control.name: self._saved.get(control.name)
            for control in self._known
            if control.mode not in had and not control.read_only
        }
        self._values = {name: float(value) for name, value in values.items() if isinstance(value, int | float)}

    def _reset(self) -> None:
        self._automatic = {control.mode: False for control in self._known if control.mode}
        self._values = {control.name: control.default for control in self._known if not control.read_only}

    def _order(self, question: dict[str, Any], done: Callable[[CameraAnswer | None, str], None]) -> None:
        turn, self._under_way = self._turn, True

        def carry_out(answer: CameraAnswer | None, problem: str) -> None:
            if turn == self._turn:
                self._under_way = False
                done(answer, problem)

        self._feed.order(
            self._camera, question, lambda answer, problem: self._wishes.append(lambda: carry_out(answer, problem))
        )

    def _write_note(self, unanswered: str, *, waiting: bool) -> None:
        changed = self._changed and not self._busy
        for button in (self._save, self._undo, self._defaults):
            button.visible = bool(self._sliders) and self._sets
        self._save.disabled = self._undo.disabled = not changed
        lines = []
        if unanswered or self._problem:
            lines.append((self._problem or unanswered, RED.css))
        elif waiting:
            lines.append(("Waiting for the camera …", GREY.css))
        elif not self._sliders:
            lines.append(("This source has no settings that can be changed while it runs.", GREY.css))
        if changed:
            lines.append(("Changed, and not saved yet. Learn the colours again if markers get lost.", AMBER.css))
        self._note.content = "".join(
            f'<div class="mocapella-camera-settings" style="padding:2px 12px 4px;font-size:13px;color:{colour};'
            f'overflow-wrap:anywhere">{escape(text)}</div>'
            for text, colour in lines
        )
