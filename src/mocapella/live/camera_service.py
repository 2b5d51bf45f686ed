"""Answer a camera node's queries in a thread of their own, so that frames are not delayed."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from dataclasses import replace as changed
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from msgspec.structs import replace

from mocapella.errors import NotNowError, SettingsError
from mocapella.live.live_controls import LiveControls
from mocapella.live.marker_work import DetectedPicture
from mocapella.live.question_thread import QuestionThread
from mocapella.model.board import parse_board
from mocapella.sensing.boards import BoardDetector, why_not_found
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import ColourProfile, save_profile
from mocapella.sensing.colour_table import separability
from mocapella.sensing.marker_mask import encode_image, mask_image
from mocapella.sensing.markers import MarkerDetector
from mocapella.settings import check
from mocapella.sources.acquisition import Acquisition
from mocapella.wire.questions import (
    AskBoard,
    AskControls,
    AskDiscard,
    AskLearn,
    AskMask,
    AskPicture,
    AskReport,
    AskSave,
    AskSaveControls,
    AskSet,
    NodeAnswer,
    read_question,
    write_answer,
)  # fmt: skip

_SAVED: Final = "saved"
"""Value in place of the previous colours if all learnt colours are saved."""
SCALES: Final = (0.05, 2.0)
"""Smallest and largest scale of an image in an answer, relative to the camera's."""
LONGEST_NAME: Final = 80
"""Longest name of a marker, in characters."""


@dataclass(frozen=True)
class CameraServiceSettings:
    """Limits on queries, and on the images that are kept for them.

    Attributes:
        waiting: largest number of waiting queries; further ones are refused.
        a_second: largest number of queries within a second; further ones are refused.
        pictures: number of images to keep, the newest that were sent for `AskPicture` with ``keep``. `AskLearn` refers
            to them, by the clicks of the user; it is refused if it refers to an image that is no longer kept.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    waiting: int = 8
    a_second: int = 20
    pictures: int = 16

    def __post_init__(self) -> None:
        check(1 <= self.waiting <= 1000, "waiting", self.waiting, "from 1 to 1000")
        check(1 <= self.a_second <= 1000, "a_second", self.a_second, "from 1 to 1000")
        check(1 <= self.pictures <= 1000, "pictures", self.pictures, "from 1 to 1000")


class PictureWork(Protocol):
    """A node's processing of a camera's images, as far as `CameraService` needs it to answer queries.

    Attributes:
        camera: the camera's name.
        acquisition: source of the images.
        detector: detects the markers; None if no colours are learnt.
        newest: the last processed image; None before the first.
    """

    camera: str
    acquisition: Acquisition
    detector: MarkerDetector | None
    newest: DetectedPicture | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers to detect."""

    def use(self, profile: ColourProfile) -> None:
        """Detect these colours from now on."""

    def report(self) -> dict[str, Any]:
        """Return counts and problems, in the form of ``--json``."""

    def words(self) -> str:
        """Return the main counts of `report` as one line for the user."""


class CameraService(QuestionThread):
    """Answers queries (`mocapella.wire.questions`) on a thread of its own, which the constructor starts.

    A context manager; leaving it ends the thread.

    Args:
        work: the node's processing, which has the newest image and the colours.
        profile_file: file that `AskSave` and `AskSaveControls` write; None refuses them.
        settings: limits; the defaults if None.
        say: receives messages about changes.
        clock: the monotonic clock, in seconds.
    """

    def __init__(
        self,
        work: PictureWork,
        profile_file: Path | None = None,
        settings: CameraServiceSettings | None = None,
        *,
        say: Callable[[str], None] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._work, self._file, self.settings = work, profile_file, settings or CameraServiceSettings()
        self._say, self._clock = say, clock
        self._asked_s: deque[float] = deque(maxlen=self.settings.a_second)
        self._lock = threading.Lock()
        self._shown: OrderedDict[int, DetectedPicture] = OrderedDict()
        self._board: tuple[str, BoardDetector] | None = None
        self._before: ColourProfile | Literal["saved"] | None = _SAVED
        super().__init__(self.settings.waiting, say)

    def ask(self, question: bytes, reply: Callable[[bytes], None]) -> None:
        """Queue a query, or refuse it beyond the limits; return at once.

        Args:
            question: the query as JSON.
            reply: called once with the answer as JSON: on the service's thread, or at once with a refusal. It is not
                called for queries that still wait at `close`.
        """
        now_s, refusal = self._clock(), ""
        with self._lock:
            recent = self._asked_s
            if len(recent) == recent.maxlen and now_s - recent[0] < 1.0:
                refusal = f"more than {recent.maxlen} questions a second; ask again in a second"
            else:
                recent.append(now_s)
        if not refusal and not self._queue(question, reply):
            refusal = f"{self.settings.waiting} questions wait already; ask again when they are answered"
        if refusal:
            reply(write_answer(NodeAnswer(False, refusal)))

    def _answers(self, data: bytes) -> NodeAnswer:  # noqa: PLR0911 - one return per query
        match read_question(data):
            case AskPicture(scale=scale, format=kind, keep=keep):
                look = self._newest(keep=keep)
                return self._pictured(look, look.image, kind, scale)
            case AskMask(scale=scale, format=kind):
                look = self._newest()
                if look.detector is None:
                    raise NotNowError("no colours are learnt yet; ask for an image, and learn the colours in it")
                painted = mask_image(look.image, look.detector.profile, look.detector.table, look.frame)
                return self._pictured(look, painted, kind, scale)
            case AskControls():
                return self._controls()
            case AskSet(values=values, automatic=automatic):
                return self._controls("; ".join(self._live.set(values, automatic)))
            case AskSaveControls():
                return self._save_controls()
            case AskReport():
                unsaved = {"unsaved": self._before != _SAVED, "unsaved_controls": self._live.unsaved}
                own = {**unsaved, "errors": self._errors.counts}
                report = {**self._work.report(), **own}
                return NodeAnswer(True, self._work.words(), report=report)
            case AskLearn() as wanted:
                return self._learn(wanted)
            case AskSave():
                return self._save()
            case AskDiscard():
                return self._discard()
            case AskBoard(board=text, explain=explain):
                return self._find_board(text, explain=explain)

    def _newest(self, *, keep: bool = False) -> DetectedPicture:
        look = self._work.newest
        if look is None:
            raise NotNowError("there is no image yet; ask again when the camera gives one")
        if keep:
            self._shown[look.picture.time_ns] = look
            while len(self._shown) > self.settings.pictures:
                self._shown.popitem(last=False)
        return look

    def _pictured(self, look: DetectedPicture, image: Any, kind: Literal["jpeg", "png"], scale: float) -> NodeAnswer:
        if not SCALES[0] <= scale <= SCALES[1]:
            raise SettingsError(f"scale is {scale:g}; it must be from {SCALES[0]:g} to {SCALES[1]:g}")
        frame = look.frame
        return NodeAnswer(
            True,
            time_ns=look.picture.time_ns,
            size_px=look.picture.size_px,
            image=encode_image(image, kind, scale),
            format=kind,
            names=list(frame.names),
            positions_px=[
                (float(x), float(y)) if found else None
                for (x, y), found in zip(frame.positions_px, frame.found, strict=True)
            ],
        )

    @cached_property
    def _live(self) -> LiveControls:
        return LiveControls(self._work.acquisition)

    def _controls(self, problem: str = "") -> NodeAnswer:
        """Answer with the controls; refuse with ``problem`` if it is not empty."""
        acquisition, live = self._work.acquisition, self._live
        state, report = acquisition.state, acquisition.report()
        controls = {
            **asdict(live.present()),
            "saved": asdict(live.saved),
            "fps": report.fps,
            "asked_fps": report.asked_fps,
            "size_px": state.size_px,
            "problems": state.problems,
            "times": acquisition.source.times,
            "source": acquisition.source.name,
        }
        return NodeAnswer(not problem, problem, controls=controls, descriptions=list(live.descriptions()))

    def _learn(self, wanted: AskLearn) -> NodeAnswer:
        samples = [ColourSample(self._kept(part.time_ns), part.points) for part in wanted.clicks]
        if not any(sample.clicks for sample in samples):
            raise SettingsError("clicks has no point; click on every marker, and on skin")
        for name in {name for sample in samples for name in sample.clicks}:
            if not 0 < len(name) <= LONGEST_NAME:
                raise SettingsError(f"marker {name[:40]!r}: a name has 1 to {LONGEST_NAME} characters")
        profile = learn_colours(
            self._work.camera,
            samples,
            backgrounds=[self._kept(time_ns) for time_ns in wanted.backgrounds],
            controls=self._live.present(),
        )
        how = separability(profile)
        if self._before == _SAVED:
            detector = self._work.detector
            self._before = None if detector is None else detector.profile
        self._work.use(profile)
        self._say(f"{profile.camera}: detects {', '.join(profile.names)} now")
        message = f"learnt {', '.join(profile.names)}" + ("; not saved yet" if self._file else "")
        return NodeAnswer(
            True,
            message,
            names=list(profile.names),
            separability={
                "kept": how.kept,
                "in_background": how.in_background,
                "distances": how.distances.tolist(),
                "problems": list(how.problems),
            },
        )

    def _kept(self, time_ns: int) -> Any:
        if time_ns not in self._shown:
            raise SettingsError(
                f"time_ns {time_ns}: no image of that time is kept; ask for an image, and click in that one "
                f"(the last {self.settings.pictures} are kept)"
            )
        return self._shown[time_ns].image

    def _save(self) -> NodeAnswer:
        file = self._profile_file("colours")
        if self._work.detector is None:
            raise NotNowError("no colours are learnt yet; there is nothing to save")
        profile = self._save_with_controls(file, self._work.detector.profile)
        self._before = _SAVED
        self._say(f"{profile.camera}: colours saved to {self._file}")
        return NodeAnswer(True, f"saved to {self._file}", names=list(profile.names))

    def _save_controls(self) -> NodeAnswer:
        file = self._profile_file("camera settings", " (node markers), or give them at its start (--set exposure=…)")
        detector = self._work.detector
        if not self._live.descriptions():
            raise NotNowError(f"{self._work.acquisition.source.name} has no controls that can be set; nothing to save")
        if self._before == _SAVED and detector is not None:
            profile = detector.profile
        elif isinstance(self._before, ColourProfile):
            profile = self._before
        else:
            raise NotNowError("camera settings are saved with colours, and none are saved yet; learn and save them")
        self._save_with_controls(file, profile)
        self._say(f"{profile.camera}: camera settings saved to {file}")
        return NodeAnswer(True, f"camera settings saved to {file}")

    def _profile_file(self, what: str, other: str = "") -> Path:
        if self._file is None:
            raise NotNowError(f"this node was started without --profile FILE; start it with one to keep {what}{other}")
        return self._file

    def _save_with_controls(self, file: Path, profile: ColourProfile) -> ColourProfile:
        """Write a profile with the present controls, where they can be set, and return it."""
        if self._live.descriptions():
            profile = changed(profile, controls=self._live.present())
        save_profile(file, profile)
        self._live.saved = self._live.present()
        return profile

    def _discard(self) -> NodeAnswer:
        if self._before == _SAVED:
            raise NotNowError("all learnt colours are saved; there is nothing to discard")
        before, self._before = self._before, _SAVED
        if isinstance(before, ColourProfile):
            self._work.use(before)
        else:
            self._work.detector = None
        message = "uses the previous colours again" if before else "no colours are in use, as before"
        self._say(f"{self._work.camera}: {message}")
        return NodeAnswer(True, message, names=list(self._work.names))

    def _find_board(self, text: str, *, explain: bool) -> NodeAnswer:
        if self._board is None or self._board[0] != text:
            self._board = (text, BoardDetector(parse_board(text)))
        detector, look = self._board[1], self._newest()
        seen = detector.update(look.image, self._work.camera, look.picture.number)
        there = NodeAnswer(True, time_ns=look.picture.time_ns, size_px=look.picture.size_px)
        corners: dict[str, Any] = {"ids": [], "corners_px": [], "edge_px": None}
        if seen is None:
            message = why_not_found([look.image], detector.board) if explain else "the board is not seen"
            return replace(there, message=message, corners=corners)
        edge = seen.edge_px if seen.edge_px == seen.edge_px else None  # NaN is no JSON
        corners = {"ids": seen.ids.tolist(), "corners_px": seen.corners_px.tolist(), "edge_px": edge}
        return replace(there, message=f"{len(seen.ids)} corners", corners=corners)
