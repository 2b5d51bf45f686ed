"""Settings of the calibration from people.

The method is described in `people` and docs/methods/people-calibration.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from mocapella.calibration.pair_calibration import PairSettings
from mocapella.settings import check


@dataclass(frozen=True)
class PeopleCalibrationSettings:
    """Settings of all sensors together.

    Attributes:
        pair: settings of each pair of sensors.
        match_within_m: bodies of two sensors whose centres are nearer are one person, where identities are not given
            [m].
        moved_after_s: time for which two sensors must disagree about all people until one of them counts as moved, and
            is calibrated again; larger: fewer false alarms [s].
        frozen_after_s: a sensor whose bodies do not change at all for this long is not used [s].
        gone_after_s: a body that a sensor has not seen for this long is dropped [s].
        clock_jump_s: largest delay of a sensor's times behind other sensors' that is not reported as a wrong clock [s].
        refresh_s: interval at which all poses are recomputed; larger: less work, and later poses [s].
        first_refresh_s: shortest interval of recomputation at first, while pairs have seen little motion [s].
        partners: number of pairs of each sensor that are refined, the best ones, if it has more; larger: more work, and
            more accurate poses [pairs].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    RECORDED_AS: ClassVar[str] = "PeopleSettings"

    pair: PairSettings = field(default_factory=PairSettings)
    match_within_m: float = 0.5
    moved_after_s: float = 2.0
    frozen_after_s: float = 0.5
    gone_after_s: float = 1.0
    clock_jump_s: float = 2.0
    refresh_s: float = 0.5
    first_refresh_s: float = 0.1
    partners: int = 4

    def __post_init__(self) -> None:
        for name in (
            "match_within_m", "moved_after_s", "frozen_after_s", "gone_after_s", "clock_jump_s", "refresh_s",
            "first_refresh_s",
        ):  # fmt: skip
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "greater than 0")
        check(self.partners >= 1, "partners", self.partners, "1 or more")
