"""Which bodies are present: those that the cameras see where they are fitted, and nowhere else."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.silhouette_pictures import Room, pose_at, ring, silhouettes_of, somebody

from mocapella.conventions import NS_PER_S
from mocapella.kinematics.silhouette_fit import eye, see
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.body_presence import LOST_AFTER_S, WITNESSES, SilhouettePresence
from mocapella.tracker.silhouette_camera import SeenIn

MESH, RIG = somebody(), ring(3)
HERE, ELSEWHERE, BESIDE = (pose_at(MESH, aside_m) for aside_m in (0.0, 0.6, 0.12))
ELSEWHERE.T_world_model[2, 3] = 0.6
ROOM = Room(RIG)
EMPTY, PERSON = ROOM.images(), ROOM.images(MESH, HERE)


@pytest.fixture
def presence():
    fitters = BodiesFitter({"": MESH}, RIG)
    fitters.start("", HERE, 0)
    fitters.others[""] = {}
    found = SilhouettePresence(fitters, RIG)
    found.empty.learn(EMPTY)
    found.start("", HERE, 0)
    return found


def fitted(presence, time_s, pose=HERE, **poses):
    """A fit whose two outlines agree in each camera: of ``pose``, or of a camera's own."""
    figure, seen = presence._fitters.fitters[""].body.figure, {}
    for name, placed in RIG.cameras.items():
        body = presence._fitters.fitters[""].body.standing(poses.get(name, pose)).vertices
        outline = see(figure, body, eye(placed), step_px=1, margin_px=2)
        seen[name] = SeenIn(outline.silhouette, outline, 1.0)
    return FittedBody(round(time_s * NS_PER_S), pose, landmarks_at(MESH, pose), seen, {})


def lost_after(presence, images, *fits):
    """Whether it is lost after these fits, more than `LOST_AFTER_S` long."""
    for k, fit in enumerate(fits):
        seen, _ = presence.update(k, {"": fit}, images)
    return seen[""].lost


TIMES_S = (0.1, LOST_AFTER_S, LOST_AFTER_S + 0.1)


def test_who_is_where_the_body_is_fitted_is_present(presence):
    assert not lost_after(presence, PERSON, *(fitted(presence, at) for at in TIMES_S))


def test_who_is_seen_beside_the_body_by_most_cameras_is_lost(presence):
    fits = [fitted(presence, at, c2=ELSEWHERE, c3=ELSEWHERE) for at in TIMES_S]
    assert lost_after(presence, PERSON, *fits)


def test_who_is_behind_furniture_for_most_cameras_is_present(presence):
    """They show the room where the body is, and nobody anywhere."""
    images = EMPTY | {"c1": PERSON["c1"]}
    assert not lost_after(presence, images, *(fitted(presence, at) for at in TIMES_S))


def test_nobody_is_present_in_the_empty_room(presence):
    assert lost_after(presence, EMPTY, *(fitted(presence, at) for at in TIMES_S))


def test_a_lost_body_is_searched_in_the_last_pose_that_stood_out_clearly(presence):
    presence.update(0, {"": fitted(presence, 0.1)}, PERSON)
    clear = presence.waiting("").fit.pose
    assert clear is HERE
    shares = [
        presence.empty.differs(name, PERSON[name], one, None) for name, one in silhouettes_of(MESH, RIG, BESIDE).items()
    ]
    assert 0.3 < np.mean(shares) < 0.75  # enough to be present, too little to be searched there
    assert not lost_after(presence, PERSON, fitted(presence, 0.2, BESIDE))
    assert presence.waiting("").fit.pose is clear


@pytest.mark.parametrize("known", range(4))
def test_where_enough_cameras_know_the_empty_room_a_lost_body_is_present_once_a_search_has_found_somebody(known):
    """A fit alone is not believed there: it may be of furniture. Elsewhere there is nothing else to go by."""
    fitters = BodiesFitter({"": MESH}, RIG)
    fitters.start("", HERE, 0)
    fitters.others[""] = {}
    presence = SilhouettePresence(fitters, RIG)
    presence.empty.learn({name: EMPTY[name] for name in list(RIG.cameras)[:known]})
    presence.start("", HERE, 0)
    presence.wait()
    nobody = msgspec.structs.replace(fitted(presence, 0.1), seen={})
    lost = [lost_after(presence, EMPTY, nobody)]
    lost += [lost_after(presence, PERSON, fitted(presence, at)) for at in (0.2, 0.3)]
    assert lost == [True, known >= WITNESSES, False]
