"""Two bodies that pass in front of each other stay who they are."""

from __future__ import annotations

import numpy as np
import pytest
from support.silhouette_room import FRAME_NS, Room, bent, ring

from mocapella.errors import SettingsError
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import BodyFitter

ROOM = Room(rig=ring(4, radius=5.0))
OTHER = Room(rig=ROOM.rig, mesh=body_mesh("female", 1.66), colour=(60, 90, 200))  # in the same clothes


def step(k: int) -> tuple[TreePose, TreePose]:
    """Both walk past each other, half a metre apart."""
    way = -0.5 + k / 24
    swing = 20 * np.sin(0.2 * k)
    angles = {"left hip flexion": max(swing, 0), "right hip flexion": max(-swing, 0)}
    return bent(ROOM.mesh, angles, (way, 0.0, 0.35)), bent(OTHER.mesh, angles, (-way, 0.0, -0.35))


def images(k: int) -> dict[str, np.ndarray]:
    one, two = step(k)
    seen = ROOM.images(one, k)
    masks = OTHER.masks(two)
    noise = np.random.default_rng(k)
    out = {}
    for name, image in seen.items():
        mine = ROOM.masks(one)[name]
        both = image.copy()
        behind = masks[name] & ~mine
        both[behind] = np.clip(np.array(OTHER.colour) + noise.normal(0, 3, (int(behind.sum()), 3)), 0, 255)
        out[name] = both
    return out


@pytest.mark.slow
def test_two_people_in_the_same_clothes_pass_each_other() -> None:
    people = BodiesFitter({"one": ROOM.mesh, "two": OTHER.mesh}, ROOM.rig)
    for name, pose in zip(("one", "two"), step(0), strict=True):
        people.start(name, pose, -FRAME_NS)
    for k in range(24):
        found = people.update(images(k), k * FRAME_NS)
        assert list(found) == ["one", "two"]
        for followed, mesh, pose in zip(found.values(), (ROOM.mesh, OTHER.mesh), step(k), strict=True):
            missed = np.linalg.norm(followed.landmarks - landmarks_at(mesh, pose), axis=1)
            assert np.median(missed) < 0.03
    people.stop("two")
    assert list(people.update(images(23), 24 * FRAME_NS)) == ["one"]


def test_what_a_body_covers_is_where_it_is_and_so_much_around_it() -> None:
    fitter = BodyFitter(ROOM.mesh, ROOM.rig)
    pose, _ = step(0)
    for name, mask in ROOM.masks(pose).items():
        covered = fitter.covered(pose)[name]
        assert np.mean(covered[mask]) > 0.9  # by samples of two pixels
        assert np.count_nonzero(covered & ~mask) < 0.12 * np.count_nonzero(mask)
        grown = fitter.covered(pose, 6)[name]
        assert grown[mask].all()
        assert np.count_nonzero(grown) > 1.2 * np.count_nonzero(mask)
    away = bent(ROOM.mesh, {}, (0.0, 30.0, 0.0))
    assert not any(mask.any() for mask in fitter.covered(away).values())


def test_nobody_of_another_name_begins() -> None:
    people = BodiesFitter({"one": ROOM.mesh}, ROOM.rig)
    with pytest.raises(SettingsError, match="no body 'on'; known: one"):
        people.start("on", step(0)[0], 0)
    assert people.update(images(0), 0) == {}
