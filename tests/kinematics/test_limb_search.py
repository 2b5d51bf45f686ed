"""A limb that is set elsewhere is found again by what images show, and one that is right stays."""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.rigged_meshes import any_pose, worm
from support.silhouette_room import bent, ring

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.ball_joints import LocalTree, ball_joints, local_tree
from mocapella.kinematics.limb_search import (
    DEFAULT,
    REACH,
    Evidence,
    FoundLimb,
    Limb,
    LimbSearchSettings,
    lasting,
    limbs,
    search,
    traced,
    unknown,
    without,
    worth,
)
from mocapella.kinematics.silhouette_fit import Eye, eye, figure, see, seen_at
from mocapella.model.body_capsules import capsules_of, depths_m
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import landmarks_at, posed, rest
from mocapella.model.twist_tree import TreePose, part_motions, twist_tree

Float64 = NDArray[np.float64]
MESH = body_mesh("male", 1.78, detail=0.8)
FIGURE, BALLS, SOLID = figure(MESH), ball_joints(MESH.tree), capsules_of(MESH)
LIMBS = {limb.name: limb for limb in limbs(MESH)}
EYES = [eye(placed) for placed in ring().cameras.values()]
STEP_PX = 2
MANY = LimbSearchSettings(drawn=2000, kept=10, again=60, rounds=5)
seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(sorted(LIMBS))
few = settings(max_examples=15, deadline=None)


@cache
def window(by: int) -> Any:
    """All of a camera's image, and a little more."""
    width, height = EYES[by].size_px
    seen = see(FIGURE, posed(MESH, rest(MESH)), EYES[by], step_px=STEP_PX, margin_px=width)
    assert seen is not None
    assert seen.mask.size >= width * height / STEP_PX**2
    return seen


def shown(pose: TreePose) -> list[Evidence]:
    """What perfect images of a body show, all of it known."""
    out = []
    for k, by in enumerate(EYES):
        seen = see(FIGURE, posed(MESH, pose), by, step_px=STEP_PX, window=window(k))
        assert seen is not None
        out.append(Evidence(by, seen.origin_px, STEP_PX, np.where(seen.mask > 0, 1.0, -1.0).astype(np.float32)))
    return out


def everywhere(value: float) -> list[Evidence]:
    return [Evidence(one.eye, one.origin_px, STEP_PX, np.full_like(one.strange, value)) for one in shown(rest(MESH))]


def placed(pose: TreePose) -> tuple[LocalTree, tuple[Float64, Float64]]:
    return local_tree(MESH.tree, BALLS, pose), (posed(MESH, pose), landmarks_at(MESH, pose)[SOLID.ends])


def looked_for(
    limb: Limb, true: TreePose, thought: TreePose, seed: int = 0, *, hidden: bool = False, many: bool = False
) -> FoundLimb | None:
    local, places = placed(thought)
    evidence = [without(one, places[0], limb.other_faces) for one in shown(true)]
    how = MANY if many else DEFAULT
    return search(limb, local, places, evidence, np.random.default_rng(seed), also_hidden=hidden, settings=how)


def off_mm(limb: Limb, true: TreePose, found: TreePose) -> float:
    """How far the limb's surface is from where it should be, in the mean."""
    return 1000 * float(np.linalg.norm(posed(MESH, true) - posed(MESH, found), axis=1)[limb.vertices].mean())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("degrees", [90, 140])
def test_a_forearm_that_is_set_elsewhere_is_found_within_a_few_degrees(seed: int, degrees: float) -> None:
    true, thought = bent(MESH, {"left elbow flexion": degrees}), bent(MESH, {"left elbow flexion": 10})
    found = looked_for(LIMBS["left forearm"], true, thought, seed)
    assert found is not None
    elbow = MESH.joint_names.index("left elbow flexion")
    assert abs(np.degrees(found.pose.angles - true.angles)[elbow]) < 6


ASTRAY = {
    "an arm to the side": ("right upper arm", {"right shoulder raise sidewards": 70, "right elbow flexion": 10}),
    "a leg to the side": ("right thigh", {"right hip abduction": 35}),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "degrees"), ASTRAY.values(), ids=ASTRAY)
def test_a_limb_that_is_set_elsewhere_is_found_within_centimetres(
    name: str, degrees: dict[str, float], seed: int
) -> None:
    true, limb = bent(MESH, degrees), LIMBS[name]
    assert off_mm(limb, true, rest(MESH)) > 250
    found = looked_for(limb, true, rest(MESH), seed)
    assert found is not None
    assert off_mm(limb, true, found.pose) < 60


def test_who_tries_more_poses_finds_better_ones() -> None:
    true, limb = bent(MESH, {"left hip flexion": 60, "left knee flexion": 60}), LIMBS["left thigh"]
    some, more = ([looked_for(limb, true, rest(MESH), seed, many=many) for seed in range(3)] for many in (False, True))
    assert all(
        one is not None and other is not None and one.worth < other.worth for one, other in zip(some, more, strict=True)
    )
    assert all(one is not None and off_mm(limb, true, one.pose) < 60 for one in more)


def test_what_is_tried_about_the_best_is_better() -> None:
    true, thought = bent(MESH, {"left elbow flexion": 110}), bent(MESH, {"left elbow flexion": 10})
    limb = LIMBS["left forearm"]
    local, places = placed(thought)
    evidence = [without(one, places[0], limb.other_faces) for one in shown(true)]
    told = []
    for again in (1, 100):
        how = LimbSearchSettings(drawn=9, kept=1, again=again, rounds=1)
        found = search(limb, local, places, evidence, np.random.default_rng(0), also_hidden=False, settings=how)
        assert found is not None
        told.append(found.worth)
    assert told[0] < told[1]


@few
@given(seeds, names, st.booleans())
def test_a_limb_that_is_right_stays(seed: int, name: str, hidden: bool) -> None:
    true = bent(MESH, {"left elbow flexion": 50, "right hip flexion": 30, "left shoulder raise sidewards": 20})
    assert looked_for(LIMBS[name], true, true, seed, hidden=hidden) is None


@few
@given(seeds, names)
def test_what_is_found_is_within_limits_worth_more_and_the_same_but_for_the_limb(seed: int, name: str) -> None:
    rng, limb = np.random.default_rng(seed), LIMBS[name]
    true, thought = any_pose(rng, MESH, 0.9), any_pose(rng, MESH, 0.9)
    found = looked_for(limb, TreePose(np.eye(4), true.angles), TreePose(np.eye(4), thought.angles), seed, hidden=True)
    if found is None:
        return
    assert ((found.pose.angles >= MESH.tree.limits[:, 0]) & (found.pose.angles <= MESH.tree.limits[:, 1])).all()
    np.testing.assert_array_equal(found.pose.T_world_model, np.eye(4))
    others = np.setdiff1d(np.arange(len(true.angles)), limb.joints)
    np.testing.assert_allclose(found.pose.angles[others], thought.angles[others], atol=1e-12)
    assert found.was + DEFAULT.better < found.worth <= 1
    local, places = placed(TreePose(np.eye(4), thought.angles))
    evidence = [without(one, places[0], limb.other_faces) for one in shown(TreePose(np.eye(4), true.angles))]
    angles, at = local.into(found.pose).angles[limb.joints], local.at.angles[limb.joints]
    (good,), (bad,), (deep,) = worth(limb, local, places, evidence, angles[None])
    turned = np.square(angles - at).sum()
    told = good - DEFAULT.room * bad - DEFAULT.per_m * deep - DEFAULT.per_rad2 * turned
    assert found.worth == pytest.approx(told, abs=1e-9)  # of the pose that is told, not of one beyond the limits
    assert np.abs(found.pose.angles - thought.angles)[limb.joints].max() > 0.05


def traced_to(limb: Limb, thought: TreePose, seed: int, evidence: list[Evidence]) -> TreePose:
    local, places = placed(thought)
    of_it = [without(one, places[0], limb.other_faces) for one in evidence]
    return traced(limb, local, places, of_it, np.random.default_rng(seed))


@few
@given(seeds, names, st.booleans())
def test_a_limb_that_another_frame_shows_where_it_was_found_or_of_which_it_knows_nothing_has_not_moved(
    seed: int, name: str, known: bool
) -> None:
    found = bent(MESH, {"left elbow flexion": 50, "right hip flexion": 30, "left shoulder raise sidewards": 20})
    told = traced_to(LIMBS[name], found, seed, shown(found) if known else everywhere(0.0))
    np.testing.assert_allclose(told.angles, found.angles, atol=1e-9)


def test_a_limb_of_which_another_frame_knows_nothing_has_not_moved_though_it_is_in_the_body() -> None:
    inside = bent(MESH, {"left shoulder raise sidewards": -60, "left shoulder swing forwards": 10})
    told = traced_to(LIMBS["left upper arm"], inside, 0, everywhere(0.0))
    np.testing.assert_allclose(told.angles, inside.angles, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("side", "flexion", "knee"), [("left", 40.0, 10.0), ("right", 5.0, 35.0)])
def test_a_leg_is_traced_to_where_another_frame_shows_it(seed: int, side: str, flexion: float, knee: float) -> None:
    """By up to 20° a frame in a flick-flack."""
    limb = LIMBS[f"{side} thigh"]
    true = bent(MESH, {f"{side} hip flexion": flexion, f"{side} knee flexion": knee})
    found = bent(MESH, {f"{side} hip flexion": flexion + 16, f"{side} knee flexion": knee + 14})
    told = traced_to(limb, found, seed, shown(true))
    assert off_mm(limb, true, told) < 0.5 * off_mm(limb, true, found)
    assert ((told.angles >= MESH.tree.limits[:, 0]) & (told.angles <= MESH.tree.limits[:, 1])).all()
    others = np.setdiff1d(np.arange(len(true.angles)), limb.joints)
    np.testing.assert_allclose(told.angles[others], found.angles[others], atol=1e-12)


def test_most_limbs_that_are_set_elsewhere_are_found_to_be_elsewhere() -> None:
    """Else the law before says little."""
    found = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        true, thought = any_pose(rng, MESH, 0.9), any_pose(rng, MESH, 0.9)
        angles = np.where(
            np.isin(np.arange(len(true.angles)), LIMBS["left upper arm"].joints), thought.angles, true.angles
        )
        one = looked_for(LIMBS["left upper arm"], TreePose(np.eye(4), true.angles), TreePose(np.eye(4), angles), seed)
        found += one is not None
    assert found >= 6


@few
@given(seeds, names)
def test_a_pose_is_worth_what_the_samples_under_its_points_say_and_is_as_deep_as_its_capsules(
    seed: int, name: str
) -> None:
    rng, limb = np.random.default_rng(seed), LIMBS[name]
    at = TreePose(np.eye(4), any_pose(rng, MESH, 0.8).angles)
    local, places = placed(at)
    evidence = [
        Evidence(one.eye, one.origin_px, STEP_PX, rng.uniform(-1, 1, one.strange.shape).astype(np.float32))
        for one in everywhere(0.0)
    ]
    others = []
    for _ in range(3):
        angles = at.angles.copy()
        angles[limb.joints] = any_pose(rng, MESH, 0.8).angles[limb.joints]
        others.append(TreePose(at.T_world_model, angles))
    tried = np.array([local.into(other).angles[limb.joints] for other in others])
    good, bad, deep = worth(limb, local, places, evidence, tried)
    for k, other in enumerate(others):
        moved = part_motions(MESH.tree, other) @ inverse(part_motions(MESH.tree, at))
        x = apply(moved[limb.part], places[0][limb.vertices][:, None])[:, 0]
        told = np.array([under(one, x) for one in evidence])
        assert good[k] == pytest.approx(np.maximum(told, 0).mean(), abs=1e-6)
        assert bad[k] == pytest.approx(np.maximum(-told, 0).mean(), abs=1e-6)
        of_it = [SOLID.pairs.tolist().index(pair) for pair in limb.pairs.tolist()]
        assert deep[k] == pytest.approx(depths_m(SOLID, landmarks_at(MESH, other))[of_it].sum(), abs=1e-6)


def test_a_camera_that_looks_away_says_nothing() -> None:
    limb = LIMBS["left upper arm"]
    local, places = placed(rest(MESH))
    T = np.diag([-1.0, 1.0, -1.0, 1.0]) @ EYES[0].T_camera_world
    away = Eye(EYES[0].size_px, EYES[0].lens, EYES[0].farthest_r2, T)
    blind = [Evidence(away, one.origin_px, STEP_PX, one.strange) for one in everywhere(1.0)]
    angles = local.at.angles[limb.joints][None]
    for evidence, says in ((blind, 0.0), (everywhere(1.0), 1.0), (everywhere(1.0)[:2] + blind[:2], 0.5)):
        (good,), (bad,), _ = worth(limb, local, places, evidence, angles)
        assert (good, bad) == (pytest.approx(says), 0)


def under(one: Evidence, points: Float64) -> Float64:
    """What an image says at points (n, 3); 0 beyond it."""
    columns, rows = np.rint((seen_at(points, one.eye) - one.origin_px) / one.step_px).astype(int).T
    inside = (rows >= 0) & (rows < one.strange.shape[0]) & (columns >= 0) & (columns < one.strange.shape[1])
    return np.array([one.strange[i, j] if ok else 0.0 for i, j, ok in zip(rows, columns, inside, strict=True)])


def test_limbs_in_each_other_cost_so_much_that_one_that_is_in_another_is_looked_for() -> None:
    """The images say nothing against where it is."""
    limb = LIMBS["left upper arm"]
    inside = bent(MESH, {"left shoulder raise sidewards": -60, "left shoulder swing forwards": 10})
    local, places = placed(inside)
    before = depths_m(SOLID, landmarks_at(MESH, inside)).sum()
    assert before > 0.08
    for per_m, looks in ((0.0, False), (DEFAULT.per_m, True)):
        how = LimbSearchSettings(per_m=per_m)
        rng = np.random.default_rng(0)
        found = search(limb, local, places, everywhere(1.0), rng, also_hidden=True, settings=how)
        assert (found is not None) is looks
        if found is not None:
            assert depths_m(SOLID, landmarks_at(MESH, found.pose)).sum() < 0.1 * before


@pytest.mark.parametrize("name", LIMBS)
def test_what_the_rest_of_the_body_covers_says_nothing_and_all_else_stays(name: str) -> None:
    limb, pose = LIMBS[name], bent(MESH, {"left elbow flexion": 60, "right hip flexion": 40})
    vertices, at_it = posed(MESH, pose), 0
    for k, one in enumerate(shown(pose)):
        left = without(one, vertices, limb.other_faces)
        assert (left.eye, left.origin_px, left.step_px) == (one.eye, one.origin_px, one.step_px)
        kept = left.strange != 0
        np.testing.assert_array_equal(left.strange[kept], one.strange[kept])
        pixels = np.rint((seen_at(vertices, EYES[k]) - one.origin_px) / STEP_PX).astype(int)
        others = np.unique(limb.other_faces)
        # Not quite all: where the limb was taken off there is a hole.
        assert (left.strange[pixels[others, 1], pixels[others, 0]] == 0).mean() > 0.97
        at_it += (left.strange[pixels[limb.vertices, 1], pixels[limb.vertices, 0]] > 0).sum()
        whole = one.strange > 0
        assert kept[~grown(whole, 2)].all()  # only beside the body
    assert at_it > 10  # of the limb something is seen


def grown(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """With all samples that are so near, also across corners."""
    rows, columns = mask.shape
    wide = np.pad(mask, by)
    shifted = [wide[a : a + rows, b : b + columns] for a in range(2 * by + 1) for b in range(2 * by + 1)]
    return np.asarray(np.any(shifted, axis=0))


def any_map(seed: int, origin: tuple[int, int] = (0, 0), shape: tuple[int, int] = (18, 24)) -> Evidence:
    rng = np.random.default_rng(seed)
    strange = np.where(rng.random(shape) < 0.1, rng.choice([0.5, 1.0], shape), rng.choice([-1.0, 0.0], shape))
    return Evidence(EYES[0], origin, STEP_PX, strange.astype(np.float32))


@given(seeds, seeds, st.integers(-6, 6), st.integers(-6, 6))
def test_strange_is_what_was_so_within_reach_before_wherever_the_map_begins(
    one: int, other: int, right: int, down: int
) -> None:
    now, before = any_map(one), any_map(other, (right * STEP_PX, down * STEP_PX), (15, 20))
    left = lasting(now, before)
    for (i, j), value in np.ndenumerate(now.strange):
        rows, columns = (
            slice(max(i - down - REACH, 0), max(i - down + REACH + 1, 0)),
            slice(max(j - right - REACH, 0), max(j - right + REACH + 1, 0)),
        )
        most = max(before.strange[rows, columns].max(initial=0.0), 0.0)
        assert left.strange[i, j] == (min(value, most) if value > 0 else value)
    assert (left.eye, left.origin_px, left.step_px) == (now.eye, now.origin_px, now.step_px)


@given(seeds)
def test_what_stays_is_as_strange_as_before_and_what_flashes_by_is_not(seed: int) -> None:
    now, same = any_map(seed), any_map(seed)
    np.testing.assert_array_equal(lasting(now, same).strange, same.strange)
    nothing = Evidence(now.eye, now.origin_px, now.step_px, np.full_like(now.strange, -1))
    np.testing.assert_array_equal(lasting(now, nothing).strange, np.minimum(same.strange, 0))
    np.testing.assert_array_equal(now.strange, same.strange)  # what was shown stays


@pytest.mark.parametrize(("moved", "stays"), [(0, True), (REACH, True), (REACH + 1, False)])
def test_what_moved_a_little_is_kept(moved: int, stays: bool) -> None:
    now, before = (any_map(0), any_map(0))
    for one, at in ((now, 5), (before, 5 + moved)):
        one.strange[...] = -1
        one.strange[8, at] = 1
    assert bool(lasting(now, before).strange[8, 5] == 1) is stays


@few
@given(seeds)
def test_moving_the_world_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    G = exp_twist(rng.normal(size=6))
    true, thought = bent(MESH, {"left elbow flexion": 90}), bent(MESH, {"left elbow flexion": 10})
    limb = LIMBS["left forearm"]
    local, (vertices, ends) = placed(thought)
    evidence = [without(one, vertices, limb.other_faces) for one in shown(true)]
    moved, there = placed(TreePose(G @ thought.T_world_model, thought.angles))
    eyes = [Eye(e.size_px, e.lens, e.farthest_r2, e.T_camera_world @ inverse(G)) for e in EYES]
    seen_there = [Evidence(e, one.origin_px, one.step_px, one.strange) for e, one in zip(eyes, evidence, strict=True)]
    rngs = np.random.default_rng(seed), np.random.default_rng(seed)
    one = search(limb, local, (vertices, ends), evidence, rngs[0], also_hidden=False)
    other = search(limb, moved, there, seen_there, rngs[1], also_hidden=False)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(other.pose.angles, one.pose.angles, atol=1e-6)
    assert other.worth == pytest.approx(one.worth, abs=1e-6)


def test_without_doubt_nothing_is_looked_for_and_nothing_drawn() -> None:
    """Where nobody knows anything a limb is not astray, however little it is worth."""
    rng = np.random.default_rng(0)
    local, places = placed(rest(MESH))
    assert search(LIMBS["left upper arm"], local, places, everywhere(0.0), rng, also_hidden=False) is None
    assert rng.random() == np.random.default_rng(0).random()


@pytest.mark.parametrize(
    ("worth_below", "against_above", "looks"),
    [(-0.4, 0.5, False), (np.nextafter(-0.4, 1), 0.5, True), (0.0, 1.0, False), (0.0, np.nextafter(1.0, 0), True)],
)
def test_a_limb_exactly_at_a_threshold_is_not_looked_for_and_one_beyond_both_is(
    worth_below: float, against_above: float, looks: bool
) -> None:
    """Where all is background, all samples are against it, and it is worth −`room`."""
    how = LimbSearchSettings(drawn=3, kept=1, again=1, rounds=1, room=0.4, per_m=0.0, astray=float(worth_below),
                             against=float(against_above))  # fmt: skip
    rng, (local, places) = np.random.default_rng(0), placed(rest(MESH))
    search(LIMBS["left upper arm"], local, places, everywhere(-1.0), rng, also_hidden=False, settings=how)
    assert (rng.random() != np.random.default_rng(0).random()) is looks


def test_limbs_end_freely_and_their_lower_parts_are_limbs_too() -> None:
    assert sorted(LIMBS) == sorted(
        f"{side} {part}" for side in ("left", "right") for part in ("upper arm", "forearm", "thigh", "shank", "foot")
    )
    for limb in LIMBS.values():
        parts = np.unique(MESH.tree.joint_parts[limb.joints])
        assert MESH.part_names[parts[0]] == limb.name
        np.testing.assert_array_equal(np.flatnonzero(np.isin(MESH.tree.joint_parts, parts)), limb.joints)
        np.testing.assert_array_equal(np.unique(limb.part), parts)
        np.testing.assert_array_equal(limb.part, MESH.bones[limb.vertices, 0])
        assert len(limb.vertices) == len(np.unique(limb.vertices)) <= DEFAULT.points
        assert not np.isin(MESH.bones[limb.other_faces, 0], parts).any()
        assert len(limb.other_faces) > 0.5 * len(MESH.faces)
        mine = np.isin(SOLID.part[limb.pairs], parts)
        assert mine.any(axis=1).all()
        assert mine.any(axis=1).sum() == np.isin(SOLID.part[SOLID.pairs], parts).any(axis=1).sum()


def test_a_neck_and_a_trunk_are_no_limbs() -> None:
    """A part alone is none, nor is a chain on which others hang."""
    supple = body_mesh("male", detail=0.8, supple=True)
    assert "head" in supple.part_names
    assert [limb.name for limb in limbs(supple)] == list(LIMBS)
    chain = worm()
    divided = twist_tree([*chain.tree.parents, 2, 2], chain.tree.joint_parts, chain.tree.twists, chain.tree.limits)
    both = msgspec.structs.replace(chain, tree=divided, part_names=(*chain.part_names, "left horn", "right horn"))
    assert limbs(both) == ()


def test_what_is_no_body_has_limbs_that_are_in_nothing() -> None:
    (all_of_it, last) = limbs(worm())
    assert (all_of_it.name, last.name) == ("middle", "head")
    assert (len(all_of_it.pairs), len(last.pairs)) == (0, 0)
    np.testing.assert_array_equal(all_of_it.joints, [0, 1])
    np.testing.assert_array_equal(last.joints, [1])


@pytest.mark.parametrize(
    "name", ["points", "drawn", "kept", "again", "rounds", "near_rad", "farther_rad", "room", "against", "better",
             "much_better", "per_rad2", "per_m"]
)  # fmt: skip
def test_settings_of_no_sense_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        LimbSearchSettings(**{name: -1})


@given(scores=st.lists(st.sampled_from([-1.0, -0.2, 0.0, 0.4, 1.0]), min_size=1, max_size=40))
def test_a_sample_is_unknown_or_has_a_score(scores):
    strange = np.array([scores], np.float32)
    maybe = unknown(Evidence(EYES[0], (3, 6), 3, strange))
    assert (maybe.origin_px, maybe.step_px) == ((3, 6), 3)
    assert np.array_equal(maybe.strange, (strange == 0).astype(np.float32))
