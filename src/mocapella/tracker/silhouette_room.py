"""Learn the empty room from the first seconds, without people in the images.

The images give the background model of each camera, against which people's foreground is detected later.
"""

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
"""Number of images of the empty room that are learnt."""
MOVED: Final = 0.001
"""Fraction of an image above which a connected change is motion rather than noise."""
LEARNING: Final = "learning the empty room: keep people out of the images"


class EmptyRoomLearning:
    """Learns each camera's background model from images of the empty room, spread evenly over a given duration.

    Args:
        seconds: duration without people; 0 learns nothing [s].

    Attributes:
        seen: names of the cameras whose room was learnt.
        done: whether the duration is over; True at once if it is 0.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self.reset()

    def reset(self) -> None:
        """Forget what was learnt; the duration begins again with the next image."""
        self._begin_ns: int | None = None
        self._taken = 0
        self._moved: set[str] = set()
        self.seen: set[str] = set()
        self.done = self._seconds == 0

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return [self._begin_ns, self._taken, self._moved, self.seen, self.done]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same duration."""
        self._begin_ns, self._taken, self._moved, self.seen, self.done = memory

    @property
    def remaining(self) -> int:
        """Number of images of each camera that are still needed."""
        return max(IMAGES - self._taken, 0)

    def update(self, time_ns: int, images: Mapping[str, UInt8], empty: EmptyRoom, fitters: BodiesFitter) -> list[str]:
        """Learn from simultaneous images; return a message at the end if something moved meanwhile, else none.

        Args:
            time_ns: capture time, on the common clock; the first call begins the duration.
            images: (height, width, 3) uint8 BGR, by camera; copied where they are kept.
            empty: background models, updated.
            fitters: the bodies' fitters, whose backgrounds are updated, too.
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
            "a person there? Then restart, without people in the images"
        ]


def unknown_room(cameras: Iterable[str], known: Container[str]) -> list[str]:
    """Return a message that names the ``cameras`` whose empty room is not in ``known``; empty if all are."""
    missing = [name for name in cameras if name not in known]
    if not missing:
        return []
    return [f"no empty room is known of {', '.join(missing)}: the background behind the body is learnt later"]


def _changed(empty: EmptyRoom, name: str, image: UInt8) -> float:
    """Return the fraction of an image of the largest connected change since the last one learnt."""
    piece = empty.silhouette(name, image)
    return 0.0 if piece is None else piece.step_px**2 * float((piece.phi > 0).sum()) / image[..., 0].size
