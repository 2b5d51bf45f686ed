"""People determine focal lengths, principal points and k1, and cameras of one model share what is theirs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from support.webcam_people import circling, walker

from mocapella.calibration.keypoint_bundle import (
    BEND,
    BONES,
    CAMERA,
    CLOCK,
    FOCAL,
    JOINTS,
    LENS,
    POSE,
    STATURES,
    AdjustedPeople,
    BundlePrior,
    KeypointViews,
    PeopleBundle,
    adjust_people,
)
from mocapella.calibration.keypoint_lenses import WrongLens, questioning_lenses
from mocapella.calibration.stepwise import result_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
RIG = list(circle_of_cameras(3).cameras.values())
T = np.array([one.T_camera_world @ inverse(RIG[0].T_camera_world) for one in RIG])
OFF = np.array([12.0, 12.0, 6.0, -5.0, -0.08, 0.0, 0.0, 0.0, 0.0])
TRUE = np.array([one.camera.lens for one in RIG]) + OFF
BODIES = 16


def prior(*, alike: bool, free_lens: bool = True) -> BundlePrior:
    free = np.ones((3, CAMERA), dtype=bool)
    free[0, POSE] = free[:, CLOCK] = False
    free[:, LENS] = free_lens
    sd = np.full((3, CAMERA), np.inf)
    sd[:, LENS] = [0.25, 0.02, 0.02, 0.15]
    equal = np.eye(3) - 1 / 3 if alike else None
    lens = np.array([one.camera.lens for one in RIG])
    return BundlePrior(free, lens, np.zeros(3), sd, stature(), equal)


@cache
def joints() -> Float64:
    times = np.linspace(0.0, 6.0, BODIES, endpoint=False)
    path = circling(0.9, 6.0)
    return np.array([apply(RIG[0].T_camera_world, walker(t, path)) for t in times])


def log_lengths() -> Float64:
    lengths: list[list[float]] = [[] for _ in STATURES]
    for one, other, which in BONES:
        lengths[which] += np.linalg.norm(joints()[:, one] - joints()[:, other], axis=-1).tolist()
    return np.log([[float(np.mean(of)) for of in lengths]])


def stature() -> float:
    return float(np.exp(np.mean(log_lengths() - np.log(STATURES))))


@cache
def views(noise_px: float) -> KeypointViews:
    shape = 3, BODIES, JOINTS
    camera, body, joint = (index.ravel() for index in np.meshgrid(*map(range, shape), indexing="ij"))
    seen = np.array([project(apply(one, joints()), lens) for one, lens in zip(T, TRUE, strict=True)]).reshape(-1, 2)
    seen += np.random.default_rng(0).normal(0.0, noise_px, seen.shape)
    return KeypointViews(
        camera, body, joint, seen, np.zeros_like(seen), np.full(len(camera), 0.5), np.zeros(BODIES, np.int64),
        np.arange(BODIES) // 4,
    )  # fmt: skip


def solved(noise_px: float, lenses: Float64, before: BundlePrior) -> AdjustedPeople:
    start = PeopleBundle(T, lenses, np.zeros(3), joints(), log_lengths())
    return adjust_people(views(noise_px), start, before, rounds=3)


@cache
def adjusted(noise_px: float, *, alike: bool = False, free_lens: bool = True) -> AdjustedPeople:
    lenses = np.array([one.camera.lens for one in RIG])
    return solved(noise_px, lenses, prior(alike=alike, free_lens=free_lens))


@cache
def questioned(focal: float) -> tuple[AdjustedPeople, AdjustedPeople, tuple[WrongLens, ...]]:
    """Return an adjustment with given lenses, of which the second's focal length is wrong by a factor, before and
    after the lenses are questioned, and the contradicted lenses."""
    lenses = TRUE.copy()
    lenses[1, :2] *= focal
    given = replace(prior(alike=False, free_lens=False), lens=lenses)
    before = solved(2.0, lenses, given)
    return before, *result_of(questioning_lenses(views(2.0), before, given))


def off_m(found: Float64) -> float:
    """Return the largest error of a translation after the best scale, which is that of the people's bones [m]."""
    t, true = found[:, :3, 3], T[:, :3, 3]
    return float(np.linalg.norm(t * (t * true).sum() / (t * t).sum() - true, axis=1).max())


def test_exact_keypoints_give_the_lenses() -> None:
    found = adjusted(1e-3).bundle
    np.testing.assert_allclose(found.lenses[:, :4], TRUE[:, :4], atol=1.0)
    np.testing.assert_allclose(found.lenses[:, 4], TRUE[:, 4], atol=0.005)
    assert off_m(found.T_camera_world) < 0.01


def test_a_lens_that_is_not_estimated_moves_the_cameras() -> None:
    off = [off_m(adjusted(1e-3, free_lens=free).bundle.T_camera_world) for free in (True, False)]
    assert off[1] > 5 * off[0]


def test_a_fixed_lens_stays_and_has_no_covariance() -> None:
    found = adjusted(0.5, free_lens=False)
    np.testing.assert_array_equal(found.bundle.lenses, [one.camera.lens for one in RIG])
    assert not found.covariance[:, LENS].any()


def test_cameras_of_one_model_have_lenses_that_are_nearly_equal_and_better_known() -> None:
    alone, same = adjusted(2.0), adjusted(2.0, alike=True)
    spread = [np.ptp(np.log(found.bundle.lenses[:, 0])) for found in (alone, same)]
    assert spread[1] < 0.02 < 10 * spread[0]
    for place in (FOCAL, BEND):
        sds = [np.sqrt(found.covariance[1, place, 1, place]) for found in (alone, same)]
        assert sds[1] < sds[0]


def test_people_do_not_contradict_right_lenses() -> None:
    before, after, wrong = questioned(1.0)
    assert wrong == ()
    assert after is before


def test_people_contradict_a_wrong_focal_length_and_tell_the_likely_one() -> None:
    before, after, wrong = questioned(1.1)
    worst = max(wrong, key=lambda one: one.sds)
    assert worst.camera == 1
    focal, sd = worst.likely_focal_px
    assert abs(focal - TRUE[1, 0]) < min(3 * sd, 0.3 * abs(worst.focal_px - TRUE[1, 0]))
    stated = [np.sqrt(np.trace(found.covariance[1, :3, 1, :3])) for found in (before, after)]
    true = T[1][:3, 3] / np.linalg.norm(T[1][:3, 3])
    off = np.linalg.norm(after.bundle.T_camera_world[1, :3, 3] - true * np.linalg.norm(T[1][:3, 3]))
    assert stated[0] < 0.5 * off
    assert stated[1] > 0.5 * off


def test_free_lenses_are_not_questioned() -> None:
    found = adjusted(2.0)
    after, wrong = result_of(questioning_lenses(views(2.0), found, prior(alike=False)))
    assert after is found
    assert wrong == ()


def test_the_covariance_is_not_below_the_bound_of_independent_errors() -> None:
    found = adjusted(2.0)
    sds, least = (np.einsum("kiki->ki", of) for of in (found.covariance, found.bound))
    assert (sds >= least * (1 - 1e-9)).all()
    assert (least[:, list(LENS)] > 0).all()
