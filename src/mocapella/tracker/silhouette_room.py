"""Learn the empty room from the first seconds, without people in the images."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.sensing.empty_room import EmptyRoom
from mocapella.tracker.bodies_fitter import BodiesFitter

UInt8 = NDArray[np.uint8]

IMAGES: Final = 30
"""So many images of an empty room say all that more would."""
MOVED: Final = 0.001
"""What changes in a larger part of an image, in one piece, is more than noise."""
LEARNING: Final = "learning the empty room: nobody may be in the images"


class EmptyRoomLearning:
    """Takes in images of the empty room, spread evenly over its seconds.

    Args:
        seconds: duration without people; 0: nothing is learnt.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self.reset()

    def reset(self) -> None:
        """Learn anew."""
        self._begin_ns: int | None = None
        self._taken = 0
        self._moved: set[str] = set()
        self.seen: set[str] = set()
        self.done = self._seconds == 0

    def memory(self) -> list[Any]:
        """All that `recall` wants."""
        return [self._begin_ns, self._taken, self._moved, self.seen, self.done]

    def recall(self, memory: Sequence[Any]) -> None:
        """Be as when `memory` was made; of the same seconds."""
        self._begin_ns, self._taken, self._moved, self.seen, self.done = memory

    @property
    def remaining(self) -> int:
        """Images of each camera that are still wanted."""
        return max(IMAGES - self._taken, 0)

    def update(self, time_ns: int, images: Mapping[str, UInt8], empty: EmptyRoom, fitters: BodiesFitter) -> list[str]:
        """Learn from the images of one instant; returns messages once learning has ended.

        Args:
            time_ns: of capture.
            images: (height, width, 3) by camera.
            empty: learns.
            fitters: learn, too.
        """
        self._begin_ns = time_ns if self._begin_ns is None else self._begin_ns
        passed_s = (time_ns - self._begin_ns) / NS_PER_S
        self.done = passed_s >= self._seconds
        if passed_s >= self._taken * self._seconds / IMAGES:
            # Images missed in a pause are not made up for.
            self._taken = max(self._taken + 1, int(IMAGES * passed_s / self._seconds))
            self._moved |= {name for name, image in images.items() if _changed(empty, name, image) > MOVED}
            fitters.learn_background(images)
            empty.learn(images)
            self.seen |= set(images)
        if not self.done or not self._moved:
            return []
        return [
            f"something moved in the images of {', '.join(sorted(self._moved))} while the empty room was learnt: was "
            "somebody there? Then begin anew, with nobody in the images"
        ]


def unknown_room(cameras: Iterable[str], known: Container[str]) -> list[str]:
    """Messages about cameras whose empty room is not known."""
    missing = [name for name in cameras if name not in known]
    if not missing:
        return []
    return [f"no empty room is known of {', '.join(missing)}: what is behind the body is learnt on the way there"]


def _changed(empty: EmptyRoom, name: str, image: UInt8) -> float:
    """Which part of an image the largest piece is that differs from the last one that was learnt."""
    piece = empty.silhouette(name, image)
    return 0.0 if piece is None else piece.step_px**2 * float((piece.phi > 0).sum()) / image[..., 0].size
