"""Arm detection in a depth camera's node: arms of each image, counts, and warnings."""

from __future__ import annotations

import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.detectors import NEVER_INDEPENDENT_S, ArmDetector
from mocapella.errors import InputError
from mocapella.live.camera_node import FaultReports
from mocapella.model.arms import ArmFrame
from mocapella.model.camera import Camera
from mocapella.model.depth import DepthFrame
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.depth_options import HandSizeCheck, UnitCheck
from mocapella.sources.picture_source import Picture

OFTEN: Final = 0.5
"""Fraction of images without any measured depth, above which they are reported as a fault."""
_TIMES: Final = 1000
"""Number of last images whose median processing time is reported."""
_MOST_REASONS: Final = 100
_ROUGH_M: Final = 0.7
_LEAST_VIDEO_FPS: Final = 5.0


def independent_after_s(fps: float | None) -> float | None:
    """Return the default of a detector's ``independent_s`` for images of a rate [s]; None for the detector's own.

    Images of a video continue each other, also where a busy machine leaves some out.

    Args:
        fps: frame rate of the source [Hz]; None if unknown.
    """
    return NEVER_INDEPENDENT_S if fps is not None and fps >= _LEAST_VIDEO_FPS else None


class ArmWork:
    """Detects arms in the depth images of one camera, and counts, for the loop of the camera's node.

    The constructor runs the detector on artificial images, so that its kernels are compiled, and resets it.

    Args:
        sensor: the camera's name.
        acquisition: source of the images; only its state and its report are read. The state has a depth unit.
        camera: lens and image size of the images.
        detector: made for this camera; kept.
        clock: the monotonic clock, in seconds.

    Attributes:
        late: number of images whose processing took longer than the frame period.
        too_late: number of images whose arms were too old to send.
        looked_at: number of processed images.
        with_arms: number of processed images with at least one arm.
    """

    def __init__(
        self,
        sensor: str,
        acquisition: Acquisition,
        camera: Camera,
        detector: ArmDetector,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.sensor, self.acquisition, self.camera, self.detector = sensor, acquisition, camera, detector
        self._state = acquisition.state
        unit_m = self._state.unit_m
        assert unit_m is not None  # `mocapella.sources.depth_options.complete` makes sure of that
        self._unit_m, self._check, self._clock = unit_m, UnitCheck(unit_m, acquisition.source.name), clock
        self._sizes = HandSizeCheck(camera.lens, camera.size_px, unit_m)
        self.late = self.too_late = self.looked_at = self.with_arms = 0
        self._times: deque[float] = deque(maxlen=_TIMES)
        self._reasons: Counter[str] = Counter()
        self._warned = FaultReports()
        self._before = (0, 0, 0)
        self._reason = ""
        for number in range(3):  # compiles before the first frame, also kernels that need an earlier image
            detector.update(rough_arm(camera), number / 30)
        detector.reset()

    def look(self, picture: Picture) -> ArmFrame:
        """Detect the arms in an image, and count it in ``looked_at`` and ``with_arms``; `in_time` counts the late ones.

        Args:
            picture: depth image (height, width) in the source's unit; its time is the frame's.

        Returns:
            The arms, or the reason why there are none. Node id, number and publication time are 0 until the frame is
                published.

        Raises:
            InputError: the depth unit is implausible, or the camera's image size, lens or unit has changed.
        """
        self._same_camera(picture)
        depth: Any = picture.image
        self._check.update(depth)
        begin_s = self._clock()
        found = self.detector.update(depth * np.float32(self._unit_m), picture.time_ns / NS_PER_S)
        self._times.append(self._clock() - begin_s)
        self.looked_at += 1
        self.with_arms += bool(found.arms)
        self._sizes.update(found.arms)
        if found.reason and (found.reason in self._reasons or len(self._reasons) < _MOST_REASONS):
            self._reasons[found.reason] += 1
        self._reason = found.reason or self._reason
        return ArmFrame(
            self.sensor, 0, 0, picture.time_ns, 0, self.camera.size_px, self.camera.lens, self.detector.name,
            found.arms, found.reason,
        )  # fmt: skip

    def depth(self, picture: Picture) -> DepthFrame:
        """Return the depth image as a frame, without a copy; node id, number and publication time are 0."""
        depth: Any = picture.image
        return DepthFrame(self.sensor, 0, 0, picture.time_ns, 0, depth, self._unit_m, self.camera.lens)

    def in_time(self, took_s: float, age_s: float, drop_after_s: float) -> bool:
        """Update the counts ``late`` and ``too_late``; return whether an image's arms are recent enough to send.

        Args:
            took_s: duration of the processing [s].
            age_s: time since the image was available [s].
            drop_after_s: largest age of an image whose arms are sent [s].
        """
        fps = self.acquisition.state.fps
        self.late += bool(fps and took_s > 1 / fps)
        self.too_late += age_s > drop_after_s
        return age_s <= drop_after_s

    def report(self) -> dict[str, Any]:
        """Return counts since the start and current problems, in the form of ``--json``."""
        return {
            "source": self.acquisition.source.name,
            "times": self.acquisition.source.times,
            **asdict(self.acquisition.report()),
            "detector": self.detector.name,
            "late": self.late,
            "too_late": self.too_late,
            "looked_at": self.looked_at,
            "with_arms": self.with_arms,
            "empty": self._check.empty,
            "damaged": getattr(self.acquisition.source, "damaged", 0),
            "median_ms": round(1e3 * statistics.median(self._times), 3) if self._times else None,
            "reasons": dict(self._reasons.most_common()),
            "problems": [*self._problems((0, 0, 0)).values(), *self.acquisition.state.problems, *self._doubts()],
        }

    def _doubts(self) -> list[str]:
        doubt = "" if self.with_arms else self._check.doubt(self.camera)
        return [doubt] if doubt else []

    def words(self) -> str:
        """Return the counts since the start as one line for the terminal."""
        report = self.acquisition.report()
        looked = max(self.looked_at, 1)
        rate = f"{report.fps:.1f} a second; " if report.fps else ""
        took = f"{1e3 * statistics.median(self._times):.1f} ms an image; " if self._times else ""
        return (
            f"{rate}{took}{report.taken} images taken, {report.dropped} dropped, {self.late} late, "
            f"{self.too_late} not sent; arms in {100 * self.with_arms / looked:.1f} %"
        )

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield faults since the last check, and recoveries; nothing if the last check is too recent.

        ``now_s`` is the present time on a monotonic clock [s].
        """
        if self._warned.due(now_s):
            problems = self._problems(self._before)
            self._before = (self.looked_at, self.with_arms, self._check.empty)
            yield from self._warned.update(problems, now_s)

    def _problems(self, before: tuple[int, int, int]) -> dict[str, str]:
        """Return faults by kind since ``before``: counts of processed images, those with arms, and empty ones."""
        found: dict[str, str] = {}
        report = self.acquisition.report()
        if report.too_few:
            advice = "give it a USB port of its own" if report.live else "this computer is too busy"
            found["rate"] = f"gives {report.fps:.1f} images a second, not {report.asked_fps:g}; {advice}"
        counts = (self.looked_at, self.with_arms, self._check.empty)
        looked, arms, empty = (now - then for now, then in zip(counts, before, strict=True))
        if looked and empty > OFTEN * looked:
            found["images"] = f"nothing is measured in {100 * empty / looked:.0f} % of the images; is it covered?"
        elif self._sizes.problem:
            found["sizes"] = self._sizes.problem
        elif looked and not arms:
            found["arms"] = "no arm is found" + (f": {self._reason}" if self._reason else "")
        return found

    def _same_camera(self, picture: Picture) -> None:
        """Raise `InputError` if the images' size, lens or depth unit has changed; the detector is for one camera."""
        state = self.acquisition.state
        if picture.size_px == self.camera.size_px and (state is self._state or _alike(state, self._state)):
            return
        problem = f"gives {picture.size_px[0]} × {picture.size_px[1]} px now, or has another lens or unit than before"
        raise InputError(problem, file=self.acquisition.source.name, fix="start the node again")


def rough_arm(camera: Camera) -> NDArray[np.float32]:
    """Return an artificial depth image, a disc as hand and a bar as arm, to compile a detector's kernels.

    Returns:
        (height, width) float32 [m]; 0 where nothing is.
    """
    width, height = camera.size_px
    fx, fy = camera.lens[:2]
    x = (np.arange(width) - 0.5 * width) * _ROUGH_M / fx
    y = ((np.arange(height) - 0.5 * height) * _ROUGH_M / fy)[:, None]
    there = (np.hypot(x, y) < 0.05) | ((np.abs(x) < 0.03) & (y > 0))
    return np.where(there, np.float32(_ROUGH_M), np.float32(0))


def _alike(one: Any, other: Any) -> bool:
    return bool((one.size_px, one.unit_m, one.lens) == (other.size_px, other.unit_m, other.lens))
