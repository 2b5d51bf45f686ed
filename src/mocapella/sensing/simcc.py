"""Decode the outputs of pose networks: SimCC's classification of coordinates, and people of one-stage networks.

SimCC (Li et al., SimCC: a Simple Coordinate Classification Perspective for Human Pose Estimation, ECCV 2022, section
3) classifies each keypoint's x and y into bins that are finer than pixels.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.person_regions import overlap

Float32 = NDArray[np.float32]

MOST_OVERLAP: Final = 0.65
"""Two boxes of one image with a larger intersection over union are one person."""


class CropKeypoints(NamedTuple):
    """Keypoints in one or several crops.

    Attributes:
        points_px: (..., keypoints, 2) x, y in the crop [px].
        confidences: (..., keypoints) 0 to 1.
    """

    points_px: Float32
    confidences: Float32


def decode_simcc(x: Float32, y: Float32, size_px: tuple[int, int]) -> CropKeypoints:
    """Return the most probable coordinates of each keypoint.

    The confidence is the smaller of the two largest responses.

    Args:
        x: (..., keypoints, bins) responses of the bins from left to right.
        y: (..., keypoints, bins) responses of the bins from top to bottom.
        size_px: (width, height) of the crop; its sides are divided into the bins.
    """
    scale_x, scale_y = size_px[0] / x.shape[-1], size_px[1] / y.shape[-1]
    points = np.stack([x.argmax(axis=-1) * scale_x, y.argmax(axis=-1) * scale_y], axis=-1)
    sure = np.clip(np.minimum(x.max(axis=-1), y.max(axis=-1)), 0.0, 1.0)
    return CropKeypoints(points.astype(np.float32), sure.astype(np.float32))


def decode_people(boxes: Float32, keypoints: Float32, least: float) -> CropKeypoints:
    """Return the people of a one-stage network's output, the surest first, each once (non-maximum suppression).

    Args:
        boxes: (people, 5) left, top, right, bottom [px] and score, 0 to 1.
        keypoints: (people, keypoints, 3) x, y [px] and score.
        least: least score of a person.
    """
    kept: list[int] = []
    for k in np.argsort(-boxes[:, 4], kind="stable"):
        if boxes[k, 4] < least:
            break
        if all(overlap(boxes[k, :4], boxes[j, :4]) <= MOST_OVERLAP for j in kept):
            kept.append(int(k))
    people = keypoints[kept]
    return CropKeypoints(people[..., :2].astype(np.float32), np.clip(people[..., 2], 0, 1).astype(np.float32))
