"""Which parts of a body are still, by what changes about them in the images."""

import numpy as np
import pytest
from support.silhouette_room import Room, bent

from mocapella.kinematics.silhouette_fit import eye, seen_at
from mocapella.tracker.limb_stillness import SETTLED_M, SETTLING, WITNESSES, ChangedImage, LimbStillness
from mocapella.tracker.silhouette_body import SilhouetteBody

ROOM = Room()
BODY = SilhouetteBody(ROOM.mesh)
EYES = [eye(placed) for placed in ROOM.rig.cameras.values()]
PARTS = ROOM.mesh.part_names
POSE = bent(ROOM.mesh, {})
STEP = 2


def changes(about=None, images=1):
    """Images in which nothing changes, but about a part in the first of them, or in as many."""
    found = {}
    for k, by in enumerate(EYES):
        density = np.zeros((by.size_px[1] // STEP, by.size_px[0] // STEP), np.float32)
        if about is not None and k < images:
            at = seen_at(BODY.standing(POSE).vertices[BODY.figure.part == PARTS.index(about)], by)
            column, row = (at / STEP).astype(int).T
            density[row, column] = 0.5
        found[str(k)] = ChangedImage(by, STEP, density)
    return found


def begun(start=POSE):
    stillness = LimbStillness(BODY)
    stillness.certain(BODY.standing(start))
    return stillness


def still(some, images=4):
    stillness = begun()
    stillness.update(BODY.standing(POSE), some, images)
    return {name for name, one in zip(PARTS, stillness.still.tolist(), strict=True) if one}


def test_where_nothing_changes_all_is_still():
    assert still(changes()) == set(PARTS)


def test_a_part_about_which_one_image_changes_may_move_and_what_is_far_from_it_stays():
    some = still(changes("left foot"))
    assert "left foot" not in some
    assert {"torso", "right forearm", "left forearm", "right upper arm"} <= some


def test_nothing_is_still_without_an_image_or_where_the_changes_of_one_are_unknown():
    assert still({}, 0) == set()
    assert still(changes(), len(EYES) + 1) == set()


def test_a_part_outside_of_all_images_is_not_still():
    stillness = begun()
    stillness.update(BODY.standing(bent(ROOM.mesh, {}, (0.0, 30.0, 0.0))), changes(), len(EYES))
    assert not stillness.still.any()


def test_parts_are_held_where_they_came_to_rest_until_they_may_move():
    stillness = begun()
    begin, drifted = (BODY.standing(bent(ROOM.mesh, {}, (x, 0.0, 0.0))) for x in (0.0, 0.1))
    stillness.update(begin, changes(), len(EYES))
    held = stillness.update(drifted, changes(), len(EYES))
    assert held.points.all()
    assert np.array_equal(held.at, begin.vertices[BODY.skin])
    assert not stillness.update(drifted, {}, len(EYES)).points.any()
    assert np.array_equal(stillness.update(drifted, changes(), len(EYES)).at, drifted.vertices[BODY.skin])


def test_a_part_that_was_misplaced_is_held_once_it_has_settled():
    stillness, foot = begun(), PARTS.index("left foot")
    first, second = (BODY.standing(bent(ROOM.mesh, {}, (x, 0.0, 0.0))) for x in (0.0, 0.1))
    stillness.update(first, changes(), len(EYES))
    stillness.release(np.array([foot]))
    skin = BODY.figure.part[BODY.skin] == foot
    for _ in range(SETTLING + 1):
        assert not stillness.update(second, changes(), len(EYES)).points[skin].any()
    held = stillness.update(second, changes(), len(EYES))
    assert held.points.all()
    assert np.array_equal(held.at[skin], second.vertices[BODY.skin][skin])
    assert np.array_equal(held.at[~skin], first.vertices[BODY.skin][~skin])


def test_after_an_uncertain_start_nothing_is_held_until_it_has_settled():
    stillness = LimbStillness(BODY)
    held = [stillness.update(BODY.standing(POSE), changes(), len(EYES)).points for _ in range(SETTLING + 2)]
    assert [some.all() for some in held] == [False] * (SETTLING + 1) + [True]
    assert not stillness.as_started.any()


def test_what_moves_on_after_an_uncertain_start_has_not_settled():
    stillness = LimbStillness(BODY)
    for k in range(3 * SETTLING):
        stands = BODY.standing(bent(ROOM.mesh, {}, (1.5 * SETTLED_M * k, 0.0, 0.0)))
        assert not stillness.update(stands, changes(), len(EYES)).points.any()


def test_parts_are_as_at_a_certain_start_until_they_go_from_there():
    stillness = begun()
    begin, far = (BODY.standing(bent(ROOM.mesh, {}, (x, 0.0, 0.0))) for x in (0.0, 0.3))
    stillness.update(begin, changes(), len(EYES))
    assert stillness.as_started.all()
    stillness.update(begin, {}, len(EYES))
    assert not stillness.as_started.any(), "nothing is still"
    stillness.update(far, changes(), len(EYES))
    assert not stillness.as_started.any()


@pytest.mark.parametrize("quiet", range(4))
def test_a_part_that_two_cameras_show_unchanged_is_still_and_other_images_do_not_count(quiet):
    foot = PARTS.index("left foot")
    stillness = begun()
    stillness.witness({str(k): np.ones(len(PARTS), np.bool_) for k in range(len(EYES))})
    for _ in range(2):
        held = stillness.update(BODY.standing(POSE), changes("left foot", len(EYES) - quiet), len(EYES))
        assert stillness.still[foot] == (quiet >= WITNESSES)
        assert held.points[BODY.figure.part[BODY.skin] == foot].all() == (quiet >= WITNESSES)
        assert not stillness.update(BODY.standing(POSE), changes(), len(EYES) + 1).points.any()


def test_a_camera_is_a_witness_until_its_image_changes_about_the_part_and_again_when_it_shows_it():
    foot, every = PARTS.index("left foot"), np.ones(len(PARTS), np.bool_)
    stillness = begun()

    def is_still(images):
        stillness.update(BODY.standing(POSE), changes("left foot", images), len(EYES))
        return stillness.still[foot]

    stillness.witness({"2": every, "3": every})
    assert is_still(2)
    stillness.witness({"2": ~every})
    assert is_still(2), "nothing changed there, so it shows what it showed"
    assert not is_still(3)
    assert not is_still(2), "of the third camera nothing is known any more"
    stillness.witness({"2": every})
    assert is_still(2)


def test_it_goes_on_from_its_memory():
    one, other = begun(), LimbStillness(BODY)
    one.update(BODY.standing(POSE), changes("left foot"), len(EYES))
    other.recall(one.memory())
    a, b = (each.update(BODY.standing(bent(ROOM.mesh, {}, (0.1, 0, 0))), changes(), len(EYES)) for each in (one, other))
    assert np.array_equal(a.at, b.at)
