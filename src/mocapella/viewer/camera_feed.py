"""Request camera images from the cameras' nodes, only while a browser shows them, and once for all browsers.

Nothing blocks: separate threads send the requests, and the drawing loop uses the answers that have arrived.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from mocapella.errors import MocapellaError
from mocapella.model.camera_controls import ControlDescription
from mocapella.settings import check


class CameraAnswer(Protocol):
    """Interface of a camera node's answer to a request (`mocapella.wire.questions.NodeAnswer`)."""

    @property
    def ok(self) -> bool:
        """Whether the request succeeded."""

    @property
    def message(self) -> str:
        """Description of the result; after a failure, also of the remedy."""

    @property
    def time_ns(self) -> int:
        """Capture time of the image, on the camera's clock [ns]."""

    @property
    def size_px(self) -> tuple[int, int] | None:
        """(width, height) of the camera's image before it was scaled; None without an image."""

    @property
    def image(self) -> bytes:
        """The encoded image."""

    @property
    def format(self) -> str:
        """Format of ``image``: jpeg or png."""

    @property
    def names(self) -> list[str] | None:
        """Names of the markers that the node detects; None if unknown."""

    @property
    def positions_px(self) -> list[tuple[float, float] | None] | None:
        """x, y of each marker in the camera's image before scaling [px]; None for a marker that is not seen."""

    @property
    def report(self) -> dict[str, Any] | None:
        """Report of the node: counts, ``problems`` as sentences, and whether marker colours are ``unsaved``.

        None in the answer to another request.
        """

    @property
    def controls(self) -> dict[str, Any] | None:
        """Values of the camera's controls, and the ``saved`` values; None in the answer to another request."""

    @property
    def descriptions(self) -> list[ControlDescription] | None:
        """The camera's controls with their ranges; None in the answer to another request."""

    @property
    def separability(self) -> dict[str, Any] | None:
        """Result of learning marker colours: ``kept``, the recognised share of each colour's pixels; ``problems``.

        None in the answer to another request.
        """


Ask = Callable[[str, dict[str, Any], float], CameraAnswer]
"""Sends a request to a camera's node and waits for the answer: (camera, request, timeout [s]).

It raises a `MocapellaError` if no answer arrives.
"""

Done = Callable[[CameraAnswer | None, str], None]
"""Receives a node's answer and an empty text, or None and the reason of the failure."""


class FeedMode(StrEnum):
    """Type of image that a browser shows of a camera: none, the camera image, or the mask of the markers."""

    OFF = "off"
    PICTURE = "picture"
    MASK = "mask"


_REPORT, _CONTROLS = "report", "controls"


@dataclass(frozen=True)
class FeedSettings:
    """Rates and limits of the requests to the cameras' nodes.

    Attributes:
        rate_hz: highest rate of requests, for all browsers and cameras together [Hz].
        timeout_s: longest time to wait for an answer [s].
        patience_s: interval between two requests after a failure [s].
        report_s: interval between two requests for the report, or for the controls, of a camera that is shown [s].
        wanted_s: an image is requested until this long after a browser last called `CameraFeed.want` for it [s].
        workers: largest number of simultaneous requests.

    Raises:
        SettingsError: a value is out of range.
    """

    rate_hz: float = 5.0
    timeout_s: float = 3.0
    patience_s: float = 2.0
    report_s: float = 2.0
    wanted_s: float = 0.5
    workers: int = 4

    def __post_init__(self) -> None:
        check(0 < self.rate_hz <= 30, "rate_hz", self.rate_hz, "above 0, at most 30 Hz")
        for name in ("timeout_s", "patience_s", "report_s", "wanted_s"):
            value = getattr(self, name)
            check(0 < value <= 60, name, value, "above 0, at most 60 s")
        check(1 <= self.workers <= 32, "workers", self.workers, "from 1 to 32")


@dataclass
class FeedImage:
    """The newest image, mask or report of one camera.

    Attributes:
        answer: the last successful answer; None before the first.
        problem: reason why the last request failed; empty if it succeeded.
        number: number of answers so far, including failures.
    """

    answer: CameraAnswer | None = None
    problem: str = ""
    number: int = 0


@dataclass
class _Wish:
    at_s: float = -1e9
    width_px: float = 0.0


class CameraFeed:
    """Requests camera images for all browsers. Call the methods from the drawing loop only.

    Args:
        ask: sends a request to a camera's node and returns the answer; may block.
        settings: rates and limits of the requests; None for the defaults of `FeedSettings`.
    """

    def __init__(self, ask: Ask, settings: FeedSettings | None = None) -> None:
        self._ask, self.settings = ask, settings or FeedSettings()
        self._pool = ThreadPoolExecutor(self.settings.workers, thread_name_prefix="view-pictures")
        self._orders = ThreadPoolExecutor(self.settings.workers, thread_name_prefix="view-colours")
        self._cameras: set[str] = set()
        self._plain: set[str] = set()
        self._answering: set[str] = set()
        self._shots: dict[tuple[str, str], FeedImage] = {}
        self._wishes: dict[tuple[str, str], _Wish] = {}
        self._asked_s: dict[tuple[str, str], float] = {}
        self._under_way: set[tuple[str, str]] = set()
        self._next_s = -1e9

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras whose nodes answer requests, sorted."""
        return tuple(sorted(self._cameras & self._answering))

    def looks(self, camera: str) -> bool:
        """Whether the camera's node detects coloured markers, so that their colours can be learnt."""
        return camera not in self._plain

    def want(self, camera: str, shown: FeedMode, width_px: float, now_s: float) -> FeedImage:
        """Register that a browser shows a camera's image; return the newest one, or an empty one before the first.

        The result does not change later. If several browsers want the image, the largest width counts.

        Args:
            camera: name of the camera.
            shown: type of the image.
            width_px: width of the image in the browser [px]; the node scales it accordingly.
            now_s: the present time on this process's monotonic clock [s]; without another call, requests for the image
                end after ``FeedSettings.wanted_s``.
        """
        key = camera, shown.value
        wish = self._wishes.setdefault(key, _Wish())
        wish.width_px, wish.at_s = max(wish.width_px, width_px), now_s
        return self._shots.setdefault(key, FeedImage())

    def want_controls(self, camera: str, now_s: float) -> FeedImage:
        """Register that a browser shows a camera's controls; return the newest answer with them, as `want` does."""
        key = camera, _CONTROLS
        self._wishes.setdefault(key, _Wish()).at_s = now_s
        return self._shots.setdefault(key, FeedImage())

    def report(self, camera: str) -> dict[str, Any]:
        """Return the newest `CameraAnswer.report` of a camera's node; an empty mapping before the first."""
        shot = self._shots.get((camera, _REPORT))
        return {} if shot is None or shot.answer is None else shot.answer.report or {}

    def beat(self, cameras: Collection[str], now_s: float, plain: Collection[str] = ()) -> None:
        """Send one due request for an image or report, the one sent longest ago; do not wait for its answer.

        Call it in every update while a browser is connected. It sends at most one request: none before
        1 / `FeedSettings.rate_hz` has passed since the last, and none while `FeedSettings.workers` are unanswered.

        Args:
            cameras: names of the cameras that have a node now. A camera's report is requested until the node has
                answered once, later only while an image of the camera is shown.
            now_s: the present time on this process's monotonic clock [s].
            plain: names of cameras whose nodes detect nothing in images; requests are the same, but `looks` is False.
        """
        self._cameras, self._plain = set(cameras), set(plain)
        if now_s < self._next_s or len(self._under_way) >= self.settings.workers:
            return
        due = [key for key in self._due(now_s) if key not in self._under_way]
        if due:
            self._next_s = now_s + 1 / self.settings.rate_hz
            self._send(min(due, key=lambda key: self._asked_s.get(key, -1e9)), now_s)

    def order(self, camera: str, question: dict[str, Any], done: Done, timeout_s: float = 30.0) -> None:
        """Send one request to a camera's node at once, beside the regular ones.

        Args:
            camera: name of the camera.
            question: the request (`mocapella.wire.questions`).
            done: is called once with the answer or the failure, on another thread; never if `close` comes first.
            timeout_s: longest time to wait for the answer [s].
        """
        self._orders.submit(self._carry_out, camera, question, done, timeout_s).add_done_callback(_raise_again)

    def hasten(self, camera: str) -> None:
        """Request a camera's report and controls with the next `beat`, because their content has changed."""
        self._asked_s.pop((camera, _REPORT), None)
        self._asked_s.pop((camera, _CONTROLS), None)

    def close(self) -> None:
        """Send no more requests, and drop the waiting ones."""
        for pool in (self._pool, self._orders):
            pool.shutdown(wait=False, cancel_futures=True)

    def _due(self, now_s: float) -> list[tuple[str, str]]:
        s, due = self.settings, []
        shown = {key[0] for key, wish in self._wishes.items() if not self._stale(wish, now_s)}
        for key, wish in self._wishes.items():
            patience = s.report_s if key[1] == _CONTROLS else 0.0
            if (shot := self._shots.get(key)) is not None and shot.problem:
                patience = s.patience_s
            if not self._stale(wish, now_s) and now_s - self._asked_s.get(key, -1e9) >= patience:
                due.append(key)
        for camera in self._cameras:
            key = camera, _REPORT
            known = camera in self._answering
            if known and camera not in shown and key in self._asked_s:
                continue
            if now_s - self._asked_s.get(key, -1e9) >= (s.report_s if known else s.patience_s):
                due.append(key)
        return due

    def _send(self, key: tuple[str, str], now_s: float) -> None:
        question: dict[str, Any] = {"ask": key[1]}
        if key[1] not in (_REPORT, _CONTROLS):
            question |= {"scale": self._scale(key), "format": "jpeg"}
        if key[1] == FeedMode.PICTURE:
            question["keep"] = False  # the node keeps the image that the user points at; this one would replace it
        self._asked_s[key] = now_s
        self._under_way.add(key)
        self._pool.submit(self._fetch, key, question).add_done_callback(_raise_again)

    def _fetch(self, key: tuple[str, str], question: dict[str, Any]) -> None:
        try:
            self._carry_out(key[0], question, lambda answer, problem: self._take(key, answer, problem), None)
        finally:
            self._under_way.discard(key)

    def _carry_out(self, camera: str, question: dict[str, Any], done: Done, timeout_s: float | None) -> None:
        try:
            answer = self._ask(camera, question, timeout_s or self.settings.timeout_s)
        except MocapellaError as error:
            done(None, str(error))
            return
        problem = "" if answer.ok else answer.message or "refused, and not said why"
        if answer.ok and question["ask"] in (FeedMode.PICTURE, FeedMode.MASK) and not _is_picture(answer):
            problem = f"{camera}: its answer has no picture"
        self._answering.add(camera)
        done(None if problem else answer, problem)

    def _take(self, key: tuple[str, str], answer: CameraAnswer | None, problem: str) -> None:
        before = self._shots.get(key, FeedImage())
        self._shots[key] = FeedImage(answer or before.answer, problem, before.number + 1)

    def _scale(self, key: tuple[str, str]) -> float:
        """Return the scale for the largest width wanted since the last request; 0.5 while the size is unknown."""
        wish, answer = self._wishes[key], self._shots.get(key, FeedImage()).answer
        width_px, wish.width_px = wish.width_px, 0.0
        if answer is None or answer.size_px is None:
            return 0.5
        return round(min(1.0, max(0.05, width_px / answer.size_px[0])), 3)

    def _stale(self, wish: _Wish, now_s: float) -> bool:
        return now_s - wish.at_s > self.settings.wanted_s


def _is_picture(answer: CameraAnswer) -> bool:
    size = answer.size_px
    return bool(answer.image) and answer.format in ("jpeg", "png") and size is not None and min(size) >= 1


def _raise_again(done: Future[None]) -> None:
    """Raise an unexpected error of a task, so that it is logged."""
    if not done.cancelled():
        done.result()
