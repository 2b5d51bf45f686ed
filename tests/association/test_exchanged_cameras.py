"""Cameras whose images are exchanged are named; other disagreements are not mistaken for an exchange."""

from __future__ import annotations

from itertools import permutations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.webcam_people import circling, frames, walker

from mocapella.association.exchanged_cameras import exchange_text, exchanged_cameras
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.tracker.webcams_warmup import circle_of_cameras

Instants = list[dict[str, KeypointFrame]]
RIG = circle_of_cameras(4)
NAMES = sorted(RIG.cameras)


def instants(rig: CameraRig, people: int = 1, seed: int = 1) -> Instants:
    """Some instants of people who walk about before a rig."""
    paths = [circling(0.9 + 0.3 * k, 7.0 + k, 2.0 * k) for k in range(people)]
    walking = [lambda t, path=path: walker(t, path) for path in paths]
    found: dict[int, dict[str, KeypointFrame]] = {}
    for arrival in frames(rig, walking, seconds=4.0, seed=seed, rates_hz=dict.fromkeys(rig.cameras, 3.0)):
        frame = arrival.frame
        assert isinstance(frame, KeypointFrame)
        if len(frame.ids):
            found.setdefault(frame.sequence, {})[frame.sensor] = frame
    return list(found.values())


def reordered(some: Instants, order: dict[str, str]) -> Instants:
    """Images of ``order[name]`` given to the camera ``name``."""
    return [{name: seen[order.get(name, name)] for name in seen if order.get(name, name) in seen} for seen in some]


@settings(max_examples=6, deadline=None)
@given(st.permutations(NAMES), st.integers(1, 2), st.integers(0, 1000))
def test_two_exchanged_cameras_of_a_symmetric_rig_are_named(two: list[str], people: int, seed: int) -> None:
    one, other = two[:2]
    some = reordered(instants(RIG, people, seed), {one: other, other: one})
    found = exchanged_cameras(some, RIG.cameras)
    assert {one: other, other: one} in found
    opposite = abs(NAMES.index(one) - NAMES.index(other)) == 2
    assert len(found) == (2 if opposite else 1)  # half a turn makes one exchange of opposite cameras the other


def test_cameras_in_their_places_are_never_named() -> None:
    for seed in range(3):
        assert exchanged_cameras(instants(RIG, 2, seed), RIG.cameras) == ()
    assert exchanged_cameras([], RIG.cameras) == ()


def test_any_order_of_the_cameras_of_an_irregular_rig_is_found() -> None:
    cameras = {}
    for k, (name, placed) in enumerate(RIG.cameras.items()):
        T = placed.T_camera_world.copy()
        turned = np.eye(4)
        turned[:3, :3] = Rotation.from_rotvec((0.0, (0.0, 0.4, -0.5, 0.2)[k], 0.0)).as_matrix()
        T = T @ turned
        T[2, 3] += 0.5 * k
        cameras[name] = msgspec.structs.replace(placed, T_camera_world=T)
    rig = CameraRig(cameras)
    some = instants(rig, 2)
    for order in permutations(NAMES):
        expected = {name: own for name, own in zip(NAMES, order, strict=True) if own != name}
        assert exchanged_cameras(reordered(some, expected), rig.cameras) == ((expected,) if expected else ())


def test_a_camera_that_was_moved_is_not_called_exchanged() -> None:
    moved = RIG.cameras[NAMES[0]].T_camera_world.copy()
    moved[:3, :3] = Rotation.from_rotvec((0.0, 0.5, 0.2)).as_matrix() @ moved[:3, :3]
    cameras = dict(RIG.cameras) | {
        NAMES[0]: msgspec.structs.replace(RIG.cameras[NAMES[0]], T_camera_world=moved),
    }
    assert exchanged_cameras(instants(RIG, 2), cameras) == ()


def test_a_camera_of_another_room_is_not_called_exchanged() -> None:
    some, other = instants(RIG, 2, 1), instants(RIG, 1, 5)
    mixed = [here | {NAMES[1]: there[NAMES[2]]} for here, there in zip(some, reversed(other), strict=False)]
    assert exchanged_cameras(mixed, RIG.cameras) == ()


def test_more_than_five_cameras_are_compared_two_by_two() -> None:
    rig = circle_of_cameras(7)
    one, other = sorted(rig.cameras)[1:6:4]
    some = reordered(instants(rig, 2), {one: other, other: one})
    assert exchanged_cameras(some, rig.cameras) == ({one: other, other: one},)


@pytest.mark.parametrize(
    ("exchanged", "text"),
    [
        ((), ""),
        (({"a": "b", "b": "a"},), "cameras a and b seem exchanged"),
        (({"a": "b", "b": "a"}, {"c": "d", "d": "c"}), "cameras a and b, or c and d seem exchanged"),
        (({"a": "b", "b": "c", "c": "a"},), "the images of a, b, c seem to be those of b, c, a"),
    ],
)
def test_the_clause_names_the_cameras(exchanged: tuple[dict[str, str], ...], text: str) -> None:
    assert exchange_text(exchanged) == text
