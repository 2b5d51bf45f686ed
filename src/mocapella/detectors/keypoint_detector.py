"""Interfaces of keypoint detectors: the descriptor that registers one, and the object that it makes for one camera.

A keypoint detector takes the colour images of one camera and returns the keypoints of all people in each. The camera's
lens need not be known: positions are pixels of the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.model.topology import Topology
from mocapella.registry import Table

if TYPE_CHECKING:
    from mocapella.model.keypoints import KeypointFrame

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]


class SeenPeople(msgspec.Struct, frozen=True, eq=False):
    """The keypoints of all people in one image: arrays over (detections, keypoints).

    Attributes:
        ids: (detections,) int64 ids of people that the detector follows, `mocapella.model.keypoints.NO_ID` without.
        positions_px: (detections, keypoints, 2) x, y [px]; the centre of the first pixel is (0, 0); NaN: not seen.
        confidences: (detections, keypoints) 0 to 1.
        relative: (detections, keypoints, 3) the detector's estimate in space, x right, y down, z out of the lens,
            relative to any point of the body [m]; None if it makes none.
    """

    ids: NDArray[np.int64]
    positions_px: Float32
    confidences: Float32
    relative: Float32 | None = None


class PeopleDetector(Protocol):
    """Interface of detectors of keypoints in the images of one camera, one image after the other.

    Attributes:
        topology: names and order of the keypoints.
    """

    topology: Topology

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the people in the next image.

        Args:
            image: (height, width, 3) uint8 blue, green, red; not changed.
            at_s: the image's capture time [s].
            regions_px: (people, 4) left, top, right, bottom of boxes where people are expected, such as from a
                tracker's prediction [px]; None without. People elsewhere are found as well.
        """
        ...

    def reset(self) -> None:
        """Forget all earlier images."""
        ...


@dataclass(frozen=True)
class KeypointDetector:
    """The descriptor of a keypoint detector, which a package registers in ``mocapella.keypoint_detectors``.

    A descriptor's module imports no model and no package of an extra; `settings`, `make` and `missing` do.

    Attributes:
        interface: version of the interface, see `mocapella.registry`.
        name: name on the command line.
        summary: one line for users who choose.
        settings: function that returns the class of its settings, a frozen dataclass.
        make: function of settings and a model's file, None if the user gives none, that makes a `PeopleDetector`. It
            raises `InputError` for a file that cannot be used.
        missing: function that returns why the detector cannot be used on this machine, with the remedy; else empty.
        model: whether the user gives a model's file.
    """

    interface: int
    name: str
    summary: str
    settings: Callable[[], type[Any]]
    make: Callable[[Any, Path | None], PeopleDetector]
    missing: Callable[[], str]
    model: Literal["none", "optional", "required"] = "none"


KEYPOINT_DETECTORS: Final = Table("mocapella.keypoint_detectors", KeypointDetector, "keypoint detector")
"""Descriptors of all keypoint detectors, by name."""


def make_keypoint_detector(name: str, settings: Any = None, model: Path | None = None) -> PeopleDetector:
    """Make a keypoint detector for the images of one camera; each camera needs its own.

    Args:
        name: name of a registered detector.
        settings: the detector's settings by name; missing ones, or all if None, take their defaults.
        model: the model's file; None without.

    Raises:
        SettingsError: no such detector, an unknown setting, or one out of range; names valid ones.
        InputError: a package is missing, a model's file is needed and not given, or it cannot be used.
    """
    from mocapella.settings import parse

    detector = KEYPOINT_DETECTORS.find(name)
    values = parse(detector.settings(), dict(settings or {}), where=f"settings of {name}")
    missing = detector.missing()
    if missing:
        raise InputError(f"the detector {name} cannot be used: {missing}")
    if model is None and detector.model == "required":
        raise InputError(f"the detector {name} needs a model", fix="give its file with --model FILE")
    if model is not None and detector.model == "none":
        raise InputError(f"the detector {name} takes no model", file=model, fix="leave --model out")
    if model is not None and not model.is_file():
        raise InputError("is not there", file=model, fix="name the file of a model")
    return detector.make(values, model)


def frame_of(
    seen: SeenPeople, topology: Topology, camera: str, time_ns: int, size_px: tuple[int, int]
) -> KeypointFrame:
    """Return the frame of the people in an image.

    Args:
        seen: the people.
        topology: names and order of the keypoints.
        camera: name of the camera.
        time_ns: capture time, on the camera's clock.
        size_px: (width, height) of the image.
    """
    from mocapella.model.keypoints import keypoint_frame

    return keypoint_frame(
        camera, topology, time_ns=time_ns, size_px=size_px, positions_px=seen.positions_px,
        confidences=seen.confidences, ids=seen.ids, relative=seen.relative,
    )  # fmt: skip
