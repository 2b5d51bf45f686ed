"""Causes of missed limbs, and oracles, of the method webcams in simulated crowds."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.body_parts import LIMBS, PARTS
from mocapella.evaluation.webcam_causes import CAUSES, RUNS, _causes, _Instant, causes, evaluate_causes
from mocapella.model.topology import topology
from mocapella.sources.simulate.body import body_template
from mocapella.sources.simulate.crowd import CameraRing, CrowdPerson, CrowdSettings
from mocapella.sources.simulate.keypoint_body import halpe_positions
from mocapella.sources.simulate.keypoint_camera import KeypointCameraSettings
from mocapella.sources.simulate.keypoint_faults import NO_FAULTS

HALPE = topology("halpe_26")
MIRROR = np.array(HALPE.mirror)
BODY: Any = halpe_positions(1.7 * (body_template().chain @ body_template().offsets))
TRUE = np.stack([BODY, BODY + np.array([0.6, 0.0, 0.0])])
SEEN = np.ones((2, 26, 3, 3))


def counted(found: Any, robust: Any = TRUE, seen: Any = SEEN) -> dict[str, int]:
    """Missed limbs of the first of two expected people, by cause; the second one is found."""
    one = _Instant(0, np.arange(2), TRUE, np.ones(2, dtype=np.bool_), {})
    people = np.stack([found, TRUE[1]]) if found is not None else TRUE[1:]
    who = {0: 0, 1: 1} if found is not None else {1: 0}
    counts = _causes([one], [people], [robust], [seen], [who])
    assert counts[:, :, 0].sum() == 2 * len(LIMBS)
    assert counts[1, :, 1:].sum() == 0
    return {cause: int(count) for cause, count in zip(CAUSES, counts[0, :, 1:].sum(axis=0), strict=True) if count}


def moved(joint: str, by: float) -> Any:
    found = TRUE[0].copy()
    found[HALPE.index(joint)] += [0.0, 0.0, by]
    return found


def test_each_missed_limb_has_the_first_cause_that_holds() -> None:
    assert counted(TRUE[0]) == {}
    assert counted(None) == {"not tracked": len(LIMBS)}
    assert set(counted(TRUE[0][MIRROR])) == {"sides"}
    assert counted(moved("LWrist", 1.0)) == {"body": 1}
    few = SEEN.copy()
    few[0, HALPE.index("LWrist"), 1:] = np.nan
    assert counted(moved("LWrist", 1.0), seen=few) == {"one camera": 1}
    assert counted(moved("LWrist", 1.0), np.stack([moved("LWrist", 1.0), TRUE[1]])) == {"detections": 1}
    taken = TRUE[0].copy()
    taken[HALPE.index("LWrist")] = TRUE[1][HALPE.index("LWrist")]
    assert counted(taken) == {"other person": 1}


@pytest.mark.slow
def test_exact_detections_leave_nothing_to_miss() -> None:
    room = CrowdSettings(
        "two", "two people without faults", 2.5, (CrowdPerson((-0.6, 0.4)), CrowdPerson((0.8, -0.5), stature=1.6)),
        ring=CameraRing(count=3), camera=KeypointCameraSettings(faults=NO_FAULTS), seed=3,
    )  # fmt: skip
    found = causes(room)
    assert tuple(found.pcp_percent) == RUNS
    assert tuple(found.causes_percent) == CAUSES
    assert min(found.pcp_percent.values()) > 99.0
    assert found.found_percent == found.precision_percent == 100.0
    assert tuple(found.parts_causes_percent) == tuple(PARTS)
    assert len(found.actors_causes_percent) == 2
    assert sum(found.causes_percent.values()) < 1.0
    missing = dataclasses.replace(NO_FAULTS, missed=(1.0, 1.0, 1.0, 1.0))
    blind = causes(dataclasses.replace(room, camera=KeypointCameraSettings(faults=missing)))
    assert blind.found_percent == blind.pcp_percent["method"] == 0.0
    assert blind.causes_percent["not tracked"] == 100.0
    assert {one["not tracked"] for one in (*blind.parts_causes_percent.values(), *blind.actors_causes_percent)} == {
        100.0
    }


def test_unknown_scenes_and_no_seeds_are_refused() -> None:
    with pytest.raises(SettingsError, match="unknown scene"):
        evaluate_causes(["shelv"])
    with pytest.raises(SettingsError, match="seeds"):
        evaluate_causes(["shelf"], [])
