"""The cap is found where it is, and steady people are those of the default, with less jitter."""

import numpy as np

from mocapella.detectors.keypoint_detector import make_keypoint_detector
from mocapella.testing import Walker, check_tracker, walking_arrivals
from mocapella.tracker import make_tracker


def test_the_nose_is_where_the_cap_is() -> None:
    image = np.zeros((60, 80, 3), np.uint8)
    image[10:20, 30:40] = 255
    detector = make_keypoint_detector("bright-cap")
    seen = detector.update(image, 0.0)
    np.testing.assert_allclose(seen.positions_px[0, detector.topology.joints.index("nose")], (34.5, 14.5))
    assert len(make_keypoint_detector("bright-cap", {"smallest_px": 101}).update(image, 0.0).ids) == 0


def test_steady_people_jitter_less_and_a_snapshot_goes_on_to_the_bit() -> None:
    arrivals = walking_arrivals({1: Walker()}, 6.0, noise=0.02)
    steady = check_tracker(lambda: make_tracker("steady", sensors_expected=2), arrivals)
    tracker = make_tracker("default", sensors_expected=2)
    plain = [tracker.update(arrival) for arrival in arrivals]
    assert [len(scene.people) for scene in steady] == [len(scene.people) for scene in plain]

    def jitter(scenes: list) -> float:
        head = np.array([scene.people[0].positions[3] for scene in scenes if scene.people])
        return float(np.nanmean(np.abs(np.diff(head, n=2, axis=0))))

    assert jitter(steady) < jitter(plain)
