"""Cameras whose keypoints have no person are named, and nothing else is blamed for that."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from mocapella.library.people_report import LEAST_DETECTIONS, CameraPeopleReport, PeopleReport, alarms


def report(detections: Mapping[str, int]) -> PeopleReport:
    cameras = {
        name: CameraPeopleReport(count, count, 10 * count, 0.0, 2.0, 0.0, 0.0) for name, count in detections.items()
    }
    return PeopleReport(60, {}, cameras, 2.0)


def test_a_camera_whose_keypoints_have_no_person_is_named() -> None:
    found = alarms(report({"left": 60, "right": 60, "rear": 0}))
    assert [one for one in found if "rear" in one] == [found[0]]
    assert "its keypoints have no person: look at the images" in found[0]


def test_nothing_else_is_blamed_if_no_camera_has_a_person() -> None:
    (found,) = alarms(report({"left": 0, "right": 0}))
    assert found.startswith("no camera's keypoints have a person: look at the images")


@pytest.mark.parametrize("count", [1, LEAST_DETECTIONS - 1])
def test_too_few_detections_tell_nothing_of_a_camera_without_any(count: int) -> None:
    assert not any("rear" in one for one in alarms(report({"left": count, "right": count, "rear": 0})))
