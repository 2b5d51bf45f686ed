"""Recognise the gestures of detected arms, by the arms' ids.

Features are ratios of landmark distances, thresholded with hysteresis (`mocapella.kinematics.gestures`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mocapella.detectors.detector import ArmDetector
from mocapella.kinematics.gestures import Gesture, GestureSettings, GesturesReport, HandGestures, hand_features
from mocapella.model.arms import ELBOW, PALM, SeenArm, SeenArms

Float32 = NDArray[np.float32]
Pictures = Mapping[str, NDArray[np.uint8]]

_HAND: Final = slice(0, PALM)


class ArmGestures:
    """Recogniser of the gestures of all arms of a camera. A gesture that the detector reported itself is kept.

    The state of an arm that was unseen for longer than `GestureSettings.hold_s` is dropped.

    Args:
        settings: thresholds, the same for every hand.
        gestures: the gestures to recognise; `mocapella.kinematics.gestures.GESTURES` if None.
    """

    def __init__(self, settings: GestureSettings | None = None, gestures: Iterable[Gesture] | None = None) -> None:
        self.settings = settings or GestureSettings()
        self.gestures = None if gestures is None else tuple(gestures)
        self.reset()

    def reset(self) -> None:
        """Forget all arms."""
        self._hands: dict[int, HandGestures] = {}
        self._seen_s: dict[int, float] = {}

    @property
    def reports(self) -> dict[int, GesturesReport]:
        """Counts of each arm's gestures by arm id; dropped arms have none."""
        return {number: hand.report for number, hand in self._hands.items()}

    def update(self, arms: tuple[SeenArm, ...], at_s: float) -> tuple[SeenArm, ...]:
        """Return the arms of a frame with their gestures: copies, or the arm itself if it has a gesture already.

        Args:
            arms: the arms seen, by ids that are constant from frame to frame; may be empty.
            at_s: capture time [s]. The method must be called for every frame, in order.
        """
        with_gestures = tuple(self._with_gesture(arm, at_s) for arm in arms)
        here = {arm.id for arm in arms}
        for number in [k for k in self._hands if k not in here]:
            self._hands[number].update(None, at_s)
            if not -1e-9 <= at_s - self._seen_s[number] <= self.settings.hold_s:
                del self._hands[number], self._seen_s[number]
        return with_gestures

    def _with_gesture(self, arm: SeenArm, at_s: float) -> SeenArm:
        hand = self._hands.setdefault(arm.id, HandGestures(self.settings, self.gestures))
        self._seen_s[arm.id] = at_s
        features = hand_features(
            arm.points[_HAND], arm.states[_HAND], arm.sd[_HAND], palm=arm.points[PALM], elbow=arm.points[ELBOW],
            unsure=self.settings.unsure,
        )  # fmt: skip
        shown = hand.update(features, at_s)
        if arm.gesture:
            return arm
        return replace(arm, gesture=shown.gesture, gesture_sure=shown.sure, grabbing=shown.grabbing)


class WithGestures:
    """An arm detector that adds gestures to another detector's arms.

    Args:
        detector: detects the arms.
        settings: thresholds of the gestures.
        stages: function of the detector and a depth image, as of `mocapella.detectors.detector.Detector`; None if none.

    Attributes:
        name: the detector's name.
        detector: as given.
        gestures: recognises the gestures; counts them in its ``reports``.
        stages: that function with the detector bound, which takes only a depth image (height, width) [m] and returns
            images of the detector's stages, by name in order. None if the detector has no stages.
    """

    def __init__(
        self,
        detector: ArmDetector,
        settings: GestureSettings | None = None,
        stages: Callable[[Any, Float32], Pictures] | None = None,
    ) -> None:
        self.name, self.detector, self.gestures = detector.name, detector, ArmGestures(settings)
        self.stages: Callable[[Float32], Pictures] | None = None if stages is None else partial(stages, detector)

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """Detect the arms in the next image and their gestures; see `ArmDetector.update`.

        Args:
            depth: (height, width) [m]; 0 where nothing was measured.
            at_s: the image's capture time [s].
        """
        seen = self.detector.update(depth, at_s)
        return SeenArms(self.gestures.update(seen.arms, at_s), seen.reason)

    def reset(self) -> None:
        """Forget all earlier images."""
        self.detector.reset()
        self.gestures.reset()
