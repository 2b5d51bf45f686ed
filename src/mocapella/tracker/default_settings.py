"""Settings of the method ``default``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from mocapella.association.jumps import JumpSettings
from mocapella.association.tracks import TrackSettings
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.errors import one_of
from mocapella.settings import check
from mocapella.tracker.people import PeopleSettings
from mocapella.tracker.people_arms import PeopleArmsSettings
from mocapella.tracker.people_bodies import PeopleBodiesSettings

JOINT_BIAS: Final = ("learnt", "none")
"""Joint bias that is subtracted from the views: the model shipped with this version, or none."""


@dataclass(frozen=True)
class DefaultSettings:
    """The settings of every stage.

    Attributes:
        calibration: calibration of the sensors' poses.
        jumps: rejection of bodies that jump farther than people can move.
        tracks: assignment of bodies to people.
        people: fusion and smoothing of their views.
        silent_after_s: a sensor without a frame for this long is not waited for [s].
        joint_bias: ``learnt`` subtracts the sensors' known joint bias, which depends on people's facing; ``none`` does
            not.
        keep_root_s: time for which the root sensor, whose space defines the world, is kept while others are calibrated
            relative to each other but not yet to it, or while it is silent; larger: the world changes more rarely [s].
        arms: people's arms in depth cameras, and the poses of these cameras.
        bodies: body models fitted to cameras' images, and their assignment to people.
        shown_for_s: time for which an unseen person is reported, as predicted [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    calibration: PeopleCalibrationSettings = field(default_factory=PeopleCalibrationSettings)
    jumps: JumpSettings = field(default_factory=JumpSettings)
    tracks: TrackSettings = field(default_factory=TrackSettings)
    people: PeopleSettings = field(default_factory=PeopleSettings)
    silent_after_s: float = 1.0
    shown_for_s: float = 1.0
    keep_root_s: float = 15.0
    joint_bias: str = "learnt"
    arms: PeopleArmsSettings = field(default_factory=PeopleArmsSettings)
    bodies: PeopleBodiesSettings = field(default_factory=PeopleBodiesSettings)

    def __post_init__(self) -> None:
        for name in ("silent_after_s", "shown_for_s"):
            check(0 < getattr(self, name) <= 3600, name, getattr(self, name), "above 0 and at most 3600 s")
        known = self.joint_bias in JOINT_BIAS
        check(known, "joint_bias", self.joint_bias, one_of(self.joint_bias, JOINT_BIAS))
        check(0 <= self.keep_root_s <= 3600, "keep_root_s", self.keep_root_s, "from 0 to 3600 s")
