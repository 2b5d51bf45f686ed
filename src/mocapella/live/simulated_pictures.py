"""Answer queries for the images of a simulated camera that has a detector of keypoints."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Final

from mocapella.errors import NotNowError
from mocapella.live.question_thread import QuestionThread
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypointCamera
from mocapella.wire.questions import AskPicture, AskReport, NodeAnswer, read_question, write_answer

_WAITING: Final = 8
"""Largest number of waiting queries; further ones are refused."""
NO_OPENCV: Final = (
    "images of simulated cameras need OpenCV: uv sync --extra webcam (elsewhere: install 'mocapella[webcam]')"
)
NO_CONTROLS: Final = "this camera is simulated; it has images, but no controls, colours or board"


class SimulatedPictures(QuestionThread):
    """Draws the image of the newest frame for each query, on a thread of its own, which the constructor starts.

    A context manager; leaving it ends the thread.

    Args:
        camera: the simulated camera.
        round_ns: duration of its scene, which is repeated [ns].
        say: receives messages about unexpected errors.

    Attributes:
        time_ns: capture time of the newest frame [ns]; None before the first.
    """

    def __init__(
        self, camera: SimulatedKeypointCamera, round_ns: int, say: Callable[[str], None] = lambda text: None
    ) -> None:
        self._camera, self._round_ns = camera, round_ns
        self.time_ns: int | None = None
        super().__init__(_WAITING, say)

    def ask(self, question: bytes, reply: Callable[[bytes], None]) -> None:
        """Queue a query, or refuse it if too many wait; return at once.

        Args:
            question: the query as JSON (`mocapella.wire.questions`).
            reply: called once with the answer as JSON, but not for queries that still wait at `close`.
        """
        if not self._queue(question, reply):
            reply(write_answer(NodeAnswer(False, f"{_WAITING} questions wait already; ask again later")))

    def _answers(self, question: bytes) -> NodeAnswer:
        match read_question(question):
            case AskPicture() as wanted:
                return self._picture(wanted)
            case AskReport():
                return NodeAnswer(True, "a simulated camera", report={"problems": []})
            case _:
                raise NotNowError(NO_CONTROLS)

    def _picture(self, wanted: AskPicture) -> NodeAnswer:
        if importlib.util.find_spec("cv2") is None:
            raise NotNowError(NO_OPENCV)
        from mocapella.sensing.marker_mask import encode_image
        from mocapella.sources.simulate.keypoint_picture import draw_bodies

        time_ns = self.time_ns
        if time_ns is None:
            raise NotNowError("there is no image yet; ask again when the camera gives one")
        image = draw_bodies(self._camera, time_ns % self._round_ns)
        height, width = image.shape[:2]
        encoded = encode_image(image, wanted.format, wanted.scale)
        return NodeAnswer(
            True, time_ns=time_ns, size_px=(width, height), image=encoded, format=wanted.format, names=[],
            positions_px=[],
        )  # fmt: skip
