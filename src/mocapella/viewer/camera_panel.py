"""Panel folder with a camera's image or mask in one browser; the user clicks on markers to learn their colours."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Any, Final

import viser

from mocapella.errors import SettingsError
from mocapella.viewer import camera_html
from mocapella.viewer.camera_feed import CameraAnswer, CameraFeed, FeedImage, FeedMode
from mocapella.viewer.camera_sliders import CameraSliders
from mocapella.viewer.inputs import set_value
from mocapella.viewer.pointing import MARKERS, SKIN, Point, Pointing, asks_for, read_names

NONE: Final = "–"
_PANEL_PX, _LARGE_PX = 480, 1280
"""Width of the requested image in the panel, and of the large image [px]."""
_MOST_BACKGROUNDS: Final = 6
"""Largest number of images without the hand, because a node keeps only a few images."""

Say = Callable[[str, str, bool], None]
"""Shows a short notice: title, text, and False for an error."""


class Lesson(Enum):
    """Step of learning colours: none; fetching a frozen image; the user points; the node learns; learnt, not saved."""

    NONE = auto()
    FREEZING = auto()
    POINTING = auto()
    LEARNING = auto()
    LEARNT = auto()


@dataclass(frozen=True, eq=False)
class Large:
    """A camera image shown large, in front of the 3D scene.

    Attributes:
        answer: the node's answer with the image.
        points: x, y of the circled markers in the camera's image by name [px].
        words: text above the image.
        named: whether the circles are labelled with the markers' names.
    """

    answer: CameraAnswer
    points: dict[str, Point]
    words: str
    named: bool


class CameraPanel:
    """The folder "Cameras". Callbacks of the browser only leave requests, which `show` carries out.

    Args:
        gui: controls of the browser.
        feed: requests camera images.
        say: shows a short notice in the browser.
        learns: whether the browser may let cameras learn colours; if not, it only looks.

    Attributes:
        large: the image to show large in front of the 3D scene; None for none.
    """

    def __init__(self, gui: viser.GuiApi, feed: CameraFeed, say: Say, *, learns: bool) -> None:
        self._feed, self._say, self._learns = feed, say, learns
        self.large: Large | None = None
        self._wishes: deque[Callable[[], None]] = deque()
        self._lesson = Lesson.NONE
        self._pupil, self._turn = "", 0
        self._pointing = Pointing()
        self._frozen: CameraAnswer | None = None
        self._backgrounds: list[int] = []
        self._chosen = False
        self._problem = self._typed = self._learnt = ""
        self._add(gui)

    @property
    def wants_clicks(self) -> bool:
        """Whether the panel waits for clicks on markers in the large image."""
        return self._lesson is Lesson.POINTING and self.large is not None

    @property
    def _camera(self) -> str:
        """The camera whose colours are learnt, or else the chosen camera; empty if there is none."""
        if self._lesson is not Lesson.NONE:
            return self._pupil
        return "" if self._cameras.value == NONE else str(self._cameras.value)

    def click(self, at: Point) -> None:
        """Accept a click into the large image at x, y [px] of the camera's image; may be called from any thread."""
        self._wish(lambda: self._point(self._pointing.click(at)))

    def leave(self) -> None:
        """Stop showing the large image; called when the browser's camera has moved away from it."""
        set_value(self._enlarge, False)

    def show(self, now_s: float) -> None:
        """Carry out the user's requests, and update the folder from the newest answers.

        Args:
            now_s: the present time on this process's monotonic clock [s].
        """
        while self._wishes:
            self._wishes.popleft()()
        at_work = self._lesson in (Lesson.FREEZING, Lesson.POINTING, Lesson.LEARNING)
        shown = FeedMode.OFF if at_work else FeedMode(self._shown.value)
        self._show_cameras(busy=self._lesson is not Lesson.NONE or shown is not FeedMode.OFF)
        camera, shot = self._camera, None
        if camera and shown is not FeedMode.OFF:
            shot = self._feed.want(camera, shown, _LARGE_PX if self._enlarge.value else _PANEL_PX, now_s)
            if camera not in self._feed.cameras:
                shot = FeedImage(
                    shot.answer, shot.problem or f"{camera}: its node is gone, or does not answer", shot.number
                )
        report = self._feed.report(camera) if camera else {}
        looks = self._feed.looks(camera)
        self._view.content = camera_html.picture_html(shot, shown, report, large=bool(self._enlarge.value), looks=looks)
        self._show_lesson(bool(report.get("unsaved")), looks=looks)
        self._sliders.show(camera if camera in self._feed.cameras else "", now_s)
        answer = None if shot is None else shot.answer
        self.large = self._large(camera, shown, answer) if self._enlarge.value else None
        self._enlarge.disabled = shown is FeedMode.OFF and self._frozen is None

    def _large(self, camera: str, shown: FeedMode, answer: CameraAnswer | None) -> Large | None:
        if self._lesson in (Lesson.POINTING, Lesson.LEARNING) and self._frozen is not None:
            words = "Learning …" if self._lesson is Lesson.LEARNING else asks_for(self._pointing.next)
            return Large(self._frozen, self._pointing.points, words, True)
        if answer is None:  # the present image stays until the first of the new type arrives
            return None if self.large is None else replace(self.large, points={}, words=f"{camera} · {shown} …")
        return Large(
            answer, camera_html.found(answer) if shown is FeedMode.PICTURE else {}, f"{camera} · {shown}", False
        )

    def _show_cameras(self, *, busy: bool) -> None:
        cameras = self._feed.cameras
        self._folder.visible = bool(cameras) or busy
        options = tuple(sorted({*cameras, self._camera} - {""} if busy else set(cameras))) or (NONE,)
        if options != tuple(self._cameras.options):
            chosen = self._cameras.value
            self._cameras.options = options
            set_value(self._cameras, chosen if chosen in options and (busy or self._chosen) else options[0])
        self._cameras.disabled = self._lesson is not Lesson.NONE
        self._begin.disabled = not cameras

    def _show_lesson(self, unsaved: bool, *, looks: bool) -> None:
        lesson, pointing = self._lesson, self._pointing
        at_work, learnt = lesson is Lesson.POINTING, lesson is Lesson.LEARNT
        if at_work and self._markers.value != self._typed:
            self._rename()
        self._steps.content = {
            Lesson.NONE: camera_html.unsaved_html(self._camera) if unsaved else "",
            Lesson.FREEZING: camera_html.waiting_html("The picture is frozen …"),
            Lesson.POINTING: camera_html.pointing_html(pointing, self._problem, self._note()),
            Lesson.LEARNING: camera_html.waiting_html("The colours are learnt …"),
            Lesson.LEARNT: self._learnt,
        }[lesson]
        self._begin.visible = lesson is Lesson.NONE and looks and self._learns
        self._shown.disabled = lesson not in (Lesson.NONE, Lesson.LEARNT)
        for handle in (self._markers, self._moves, self._learn, self._background):
            handle.visible = at_work
        self._learn.disabled = not pointing.enough
        self._background.disabled = len(self._backgrounds) >= _MOST_BACKGROUNDS
        self._cancel.visible = lesson in (Lesson.FREEZING, Lesson.POINTING)
        self._repeat.visible = learnt
        savable = learnt or (unsaved and lesson is Lesson.NONE)
        self._save.visible = self._discard.visible = savable and self._learns

    def _note(self) -> str:
        if not self._enlarge.value:
            return "Tick Large to see the picture that is to be clicked in."
        count = len(self._backgrounds)
        if count:
            return f"{count} {'picture' if count == 1 else 'pictures'} without the hand."
        return "The wheel zooms; a picture without the hand, if you add one, makes colours safer."

    def _rename(self) -> None:
        self._typed = str(self._markers.value)
        try:
            self._point(self._pointing.named(read_names(self._typed)))
        except SettingsError as error:
            self._problem = str(error)

    def _point(self, pointing: Pointing) -> None:
        if self._lesson is Lesson.POINTING:
            self._pointing, self._problem = pointing, ""

    def _freeze(self) -> None:
        if self._lesson is not Lesson.NONE or not self._camera:
            return
        self._pupil = self._camera
        self._lesson, self._problem, self._backgrounds, self._frozen = Lesson.FREEZING, "", [], None
        set_value(self._enlarge, True)
        self._order({"ask": "picture", "format": "jpeg", "keep": True}, self._begin_pointing)

    def _begin_pointing(self, answer: CameraAnswer | None, problem: str) -> None:
        if answer is None:
            self._stop()
            self._say("Learn colours: not begun", problem, False)
            return
        self._frozen, self._lesson = answer, Lesson.POINTING
        names = tuple(name for name in answer.names or () if name != SKIN) or MARKERS
        self._typed = ", ".join(names)
        set_value(self._markers, self._typed)
        self._pointing = Pointing((*names, SKIN))

    def _send_clicks(self) -> None:
        if self._lesson is not Lesson.POINTING or not self._pointing.enough or self._frozen is None:
            return
        self._lesson = Lesson.LEARNING
        clicks = {"time_ns": self._frozen.time_ns, "points": self._pointing.points}
        self._order({"ask": "learn", "clicks": [clicks], "backgrounds": self._backgrounds}, self._take_learnt)

    def _take_learnt(self, answer: CameraAnswer | None, problem: str) -> None:
        if answer is None:
            self._lesson, self._problem = Lesson.POINTING, problem
            return
        self._lesson = Lesson.LEARNT
        self._learnt = camera_html.separability_html(answer.separability or {})
        set_value(self._shown, FeedMode.MASK)
        self._feed.hasten(self._camera)

    def _add_background(self) -> None:
        def take(answer: CameraAnswer | None, problem: str) -> None:
            if answer is None:
                self._problem = problem
            else:
                self._backgrounds.append(answer.time_ns)

        if self._lesson is Lesson.POINTING:
            self._order({"ask": "picture", "scale": 0.1, "keep": True}, take)

    def _finish(self, verb: str, title: str) -> None:
        """Save or discard the learnt colours."""

        def take(answer: CameraAnswer | None, problem: str) -> None:
            self._say(title if answer else f"{title}: not done", answer.message if answer else problem, bool(answer))
            self._feed.hasten(self._camera)
            if answer is not None:
                self._stop()

        if self._lesson in (Lesson.LEARNT, Lesson.NONE):
            self._order({"ask": verb}, take)

    def _again(self) -> None:
        if self._lesson is Lesson.LEARNT and self._frozen is not None:
            self._lesson, self._problem = Lesson.POINTING, ""

    def _stop(self) -> None:
        self._turn += 1  # answers still under way come too late
        self._lesson, self._frozen, self._problem = Lesson.NONE, None, ""
        set_value(self._enlarge, False)

    def _order(self, question: dict[str, Any], done: Callable[[CameraAnswer | None, str], None]) -> None:
        turn = self._turn

        def take(answer: CameraAnswer | None, problem: str) -> None:
            self._wish(lambda: done(answer, problem) if turn == self._turn else None)

        self._feed.order(self._camera, question, take)

    def _wish(self, wish: Callable[[], None]) -> None:
        if self._learns:
            self._wishes.append(wish)

    def _add(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Cameras", visible=False) as self._folder:
            self._cameras = gui.add_dropdown("Camera", (NONE,), hint="Whose picture is shown")
            self._shown = gui.add_dropdown(
                "Show",
                tuple(FeedMode),
                hint="The image, or the mask of each colour; off requests nothing",
            )
            self._enlarge = gui.add_checkbox("Large", False, hint="Before the stages, as large as the window")
            self._view = gui.add_html("")
            self._steps = gui.add_html("")
            self._markers = gui.add_text(
                "Markers", "", hint="Their names in the order of pointing, with commas between"
            )
            self._moves = gui.add_button_group("Pointing", ("Back", "Skip", "Again"))
            self._background = gui.add_button(
                "Add picture without hand", color="gray", icon=viser.Icon.PHOTO,
                hint="Take the hand out of the image first: everything then visible is background",
            )  # fmt: skip
            self._begin = gui.add_button(
                "Learn colours…", icon=viser.Icon.COLOR_PICKER, color="gray",
                hint="Freezes the picture; then click on each marker in it",
            )  # fmt: skip
            self._learn = gui.add_button("Learn", icon=viser.Icon.WAND, color="teal")
            self._save = gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY, color="teal", hint="Into its profile")
            self._repeat = gui.add_button("Point again", icon=viser.Icon.COLOR_PICKER, color="gray")
            self._discard = gui.add_button(
                "Discard", icon=viser.Icon.TRASH, color="gray", hint="Back to the colours it had before"
            )
            self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, color="gray")
            self._sliders = CameraSliders(gui, self._feed, self._say, sets=self._learns)
        for button, act in (
            (self._begin, self._freeze),
            (self._learn, self._send_clicks),
            (self._background, self._add_background),
            (self._save, lambda: self._finish("save", "Save colours")),
            (self._discard, lambda: self._finish("discard", "Discard colours")),
            (self._repeat, self._again),
            (self._cancel, self._stop),
        ):
            self._connect(button, act)

        @self._cameras.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            self._chosen |= event.client is not None

        @self._moves.on_click
        async def _(_: viser.GuiEvent[Any]) -> None:
            move = {"Back": Pointing.back, "Skip": Pointing.skip, "Again": Pointing.again}[self._moves.value]
            self._wish(lambda: self._point(move(self._pointing)))

    def _connect(self, button: viser.GuiButtonHandle, act: Callable[[], None]) -> None:
        @button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._wish(act)
