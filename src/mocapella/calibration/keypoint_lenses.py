"""Tell whether people contradict lenses that were given, by an adjustment in which these lenses are free.

A lens that is right changes by its standard deviation when it is freed, and one that is wrong by more (the test of
A. Wald, Trans. AMS 54 (1943) 426). The pose of a camera with a wrong lens is off by about as much as it changes, which
no residual shows, because the pose follows the lens.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import (
    CAMERA,
    CENTRE,
    FOCAL,
    LENS,
    AdjustedPeople,
    BundlePrior,
    KeypointViews,
    adjusting_people,
    stating_covariance,
)
from mocapella.calibration.stepwise import Steps
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import log_motion

Float64 = NDArray[np.float64]

CONTRADICTED: Final = 4.0
"""Change of a parameter of a lens above which people contradict it [standard deviations]."""


class WrongLens(msgspec.Struct, frozen=True):
    """A given lens that people contradict.

    Attributes:
        camera: index of the camera.
        focal_px: the given focal length [px].
        likely_focal_px: the one by the people, and its standard deviation [px].
        likely_centre_px: the principal point by the people; the given one if they do not contradict it [px].
        sds: the largest change of a parameter of the lens, in its standard deviations.
    """

    camera: int
    focal_px: float
    likely_focal_px: tuple[float, float]
    likely_centre_px: tuple[float, float]
    sds: float


def questioning_lenses(
    views: KeypointViews, adjusted: AdjustedPeople, prior: BundlePrior
) -> Steps[tuple[AdjustedPeople, tuple[WrongLens, ...]]]:
    """Return the steps that compare given lenses with those that the people have if all lenses are free.

    If people contradict a lens, the covariance of the poses grows by their change, so that the stated standard
    deviations are at least as large.

    Args:
        views: the keypoints.
        adjusted: the adjustment with the given lenses, and its covariance.
        prior: its prior; lenses that are not free are given.

    Returns:
        The adjustment, and the lenses that are contradicted, in the order of the cameras.
    """
    given = ~prior.free[:, FOCAL]
    if not given.any():
        return adjusted, ()
    free = prior.free.copy()
    free[:, list(LENS)] = True
    asked = replace(prior, free=free)
    freed = yield from adjusting_people(views, adjusted.bundle, asked, rounds=2)
    freed = yield from stating_covariance(views, freed, asked)
    wrong = _contradicted(adjusted, freed, np.flatnonzero(given))
    if not wrong:
        return adjusted, ()
    return replace(adjusted, covariance=_grown(adjusted, freed)), wrong


def _contradicted(before: AdjustedPeople, after: AdjustedPeople, given: NDArray[np.int64]) -> tuple[WrongLens, ...]:
    """Return the given lenses whose parameters changed too much.

    Focal lengths are tested twice: with the principal points and k1 as given, where they are known best, and with these
    free, where a wrong principal point does not look like a wrong focal length.
    """
    lens, count = list(LENS), len(given)
    change = _changes(before, after)[given]
    rows = after.covariance[given][:, lens][:, :, given][..., lens]
    covariance = rows.reshape(4 * count, 4 * count)
    sds = np.sqrt(np.maximum(np.diag(covariance), 1e-30)).reshape(count, 4)
    information = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)[::4]
    of_focal = np.linalg.inv(information[:, ::4])
    focal, focal_sd = of_focal @ information @ change.ravel(), np.sqrt(np.diag(of_focal))
    wrong = []
    for k, camera in enumerate(given):
        others = float(np.max(np.abs(change[k, 1:]) / sds[k, 1:]))
        whole = others > CONTRADICTED
        log, sd = (change[k, 0], sds[k, 0]) if whole else (focal[k], focal_sd[k])
        most = max(others, float(abs(focal[k]) / focal_sd[k]), float(abs(change[k, 0]) / sds[k, 0]))
        if most <= CONTRADICTED:
            continue
        own = float(before.bundle.lenses[camera, :2].mean())
        likely = own * float(np.exp(log))
        x, y = after.bundle.lenses[camera, 2:4] if whole else before.bundle.lenses[camera, 2:4]
        wrong.append(WrongLens(int(camera), own, (likely, likely * float(sd)), (float(x), float(y)), most))
    return tuple(wrong)


def _changes(before: AdjustedPeople, after: AdjustedPeople) -> Float64:
    """Return the changes (cameras, 4) of the parameters `LENS`."""
    one, other = before.bundle.lenses, after.bundle.lenses
    focal = np.log(other[:, :2] / one[:, :2]).mean(axis=1)
    return np.column_stack([focal, (other[:, 2:4] - one[:, 2:4]) / one[:, :2], other[:, 4] - one[:, 4]])


def _grown(before: AdjustedPeople, after: AdjustedPeople) -> Float64:
    """Return the covariance with the change of the poses as a further error of one standard deviation."""
    cameras = len(before.bundle.lenses)
    change = np.zeros((cameras, CAMERA))
    for k in range(cameras):
        moved = after.bundle.T_camera_world[k] @ inverse(before.bundle.T_camera_world[k])
        change[k, :6] = log_motion(moved)
    changes = _changes(before, after)
    change[:, FOCAL], change[:, CENTRE] = changes[:, 0], changes[:, 1:3]
    return np.asarray(before.covariance + np.einsum("ai,bj->aibj", change, change))
