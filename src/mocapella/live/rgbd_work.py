"""Body frames of a depth camera with colour: keypoints of the colour images, lifted by the depth images."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.detectors.keypoint_detector import PeopleDetector, SeenPeople
from mocapella.errors import InputError, SettingsError
from mocapella.live.keypoint_work import KeypointWork
from mocapella.model.observations import BodyFrame
from mocapella.model.skeleton import mapping_problem
from mocapella.model.topology import Topology
from mocapella.sensing.body_ids import BodyIds
from mocapella.sensing.keypoint_depth import KeypointLift, LiftSettings, body_frame_of
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.depth_options import UnitCheck
from mocapella.sources.picture_source import Picture, SourceState

if TYPE_CHECKING:
    from mocapella.sources.simulate.room_keypoints import RoomKeypoints


class RgbdWork(KeypointWork):
    """Finds people in the colour images of a depth camera, and their joints in space.

    The constructor lifts a person of no image, so that kernels are compiled.

    Args:
        camera: the sensor's name.
        acquisition: source of the images, with depth and colour; its state and its reports are used.
        finds: the detector of keypoints, for this camera alone.
        settings: settings of the lift; the defaults if None.

    Attributes:
        not_in_space: number of detections that had no body in the depth image.
        in_space: number of bodies that were found in space.

    Raises:
        InputError: the source gives no colour, or its lens or its unit is unknown.
        SettingsError: the detector's keypoints cannot be mapped to the joints of people.
    """

    def __init__(
        self, camera: str, acquisition: Acquisition, finds: PeopleDetector, settings: LiftSettings | None = None
    ) -> None:
        super().__init__(camera, acquisition, finds)
        self._state, source = acquisition.state, acquisition.source.name
        if problem := mapping_problem(finds.topology):
            raise SettingsError(f"the detector's keypoints cannot be used: {problem}")
        self._lift = lift_of(self._state, source, settings)
        assert self._state.unit_m is not None
        self._unit_m, self._check = self._state.unit_m, UnitCheck(self._state.unit_m, source)
        self._ids, self._topology = BodyIds(), finds.topology
        self.not_in_space = self.in_space = 0
        self._lift.warm_up(finds.topology)

    def frame(self, picture: Picture) -> BodyFrame:
        """Return the bodies of a depth image with its colour image; node id, number and publication time are 0.

        Raises:
            InputError: the depth unit is implausible, or the camera's image size, lens or unit has changed.
        """
        state = self.acquisition.state
        if picture.colour is None or (state is not self._state and not _alike(state, self._state)):
            problem = "gives no colour images any more, or has another size, lens or unit than before"
            raise InputError(problem, file=self.acquisition.source.name, fix="start the node again")
        depth: Any = picture.image
        self._check.update(depth)
        seen = self.look(replace(picture, image=picture.colour))
        joints = self._lift.joints(seen, depth * np.float32(self._unit_m))
        self.in_space += len(joints.detection)
        self.not_in_space += len(seen.ids) - len(joints.detection)
        ids = self._ids.update(joints.positions, picture.time_ns / NS_PER_S)
        return body_frame_of(joints, seen, ids)

    def report(self) -> dict[str, Any]:
        """Return counts since the start and current problems, in the form of ``--json``."""
        counts = {"bodies": self.in_space, "not_in_space": self.not_in_space, "empty": self._check.empty}
        return super().report() | counts

    def _problems(self, before: tuple[int, int, int]) -> dict[str, str]:
        found = super()._problems(before)
        if self.not_in_space > self.in_space and self.not_in_space > 30:
            found["space"] = (
                "most of the detected people have no body in the depth images: they are too far away, the depth camera "
                "is covered, or its lens, unit or place beside the colour camera is wrong (--intrinsics, --unit)"
            )
        return found


class RoomDetector:
    """The simulated detector of a rendered room as a `PeopleDetector`; it looks at the room, not at the image.

    Args:
        seen: the keypoints of the room.

    Attributes:
        topology: names and order of the keypoints.
    """

    def __init__(self, seen: RoomKeypoints) -> None:
        self.topology: Topology = seen.topology
        self._seen = seen

    def update(self, image: Any, at_s: float, regions_px: Any = None) -> SeenPeople:
        """Return the keypoints at a time: the capture time of an image of the room, which is its time plus 1 ns."""
        time_ns = round(at_s * NS_PER_S)
        frame = self._seen.near(time_ns - 1)
        return SeenPeople(frame.ids, frame.positions_px, frame.confidences)

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""


def lift_of(state: SourceState, source: str, settings: LiftSettings | None = None) -> KeypointLift:
    """Return the lift for an opened depth camera with colour; ``source`` is named in errors.

    Raises:
        InputError: it gives no colour, or its lens or its unit is unknown.
    """
    colour = state.colour
    if colour is None:
        raise InputError("gives no colour images", file=source, fix="name a depth camera that has a colour camera, too")
    wanted = (("--intrinsics F,CX,CY", state.lens), ("--unit METRES", state.unit_m))
    if missing := [option for option, value in wanted if value is None]:
        fix = f"give {' and '.join(missing)}, or write a depth.toml beside the depth images (docs/arms/recordings.md)"
        raise InputError("the camera's lens or unit is unknown", file=source, fix=fix)
    if colour.T_colour_depth is None:
        return KeypointLift(state.lens, colour.size_px, settings=settings)
    T = np.array(colour.T_colour_depth)
    return KeypointLift(colour.lens, colour.size_px, depth_lens=state.lens, T_colour_depth=T, settings=settings)


def _alike(one: SourceState, other: SourceState) -> bool:
    return (one.size_px, one.unit_m, one.lens, one.colour) == (other.size_px, other.unit_m, other.lens, other.colour)
