"""Regions of people in an image: boxes around their keypoints, and images with blank regions.

Detectors of one person find several people with them: each found person's box is blank in the image that is searched
for further people.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

SEEN: Final = 0.3
"""Least confidence of a keypoint that counts for a person's box."""
FEWEST: Final = 4
"""Least number of such keypoints; a box of fewer would be too small."""
ALIKE: Final = 0.1
"""Two detections whose keypoints' median distance is below this part of the larger one's size are one person."""


def box_of(positions_px: Float32, confidences: Float32, margin: float = 0.0) -> Float32 | None:
    """Return the box (4,) left, top, right, bottom around a person's keypoints [px]; None with too few keypoints.

    Args:
        positions_px: (keypoints, 2), NaN where not seen.
        confidences: (keypoints,) 0 to 1; only those from `SEEN` count.
        margin: enlargement on each side, as a part of the box's longer side.
    """
    there = (confidences >= SEEN) & np.isfinite(positions_px).all(axis=-1)
    if np.count_nonzero(there) < FEWEST:
        return None
    low, high = positions_px[there].min(axis=0), positions_px[there].max(axis=0)
    wider = margin * float((high - low).max())
    return np.concatenate([low - wider, high + wider]).astype(np.float32)


def alike(one_px: Float32, other_px: Float32, least: Float32) -> bool:
    """Whether two detections in one image are of the same person.

    Args:
        one_px, other_px: (keypoints, 2) positions, NaN where not seen [px].
        least: (keypoints,) the lower of the two confidences of each keypoint.
    """
    both = (least >= SEEN) & np.isfinite(one_px).all(axis=-1) & np.isfinite(other_px).all(axis=-1)
    if np.count_nonzero(both) < FEWEST:
        return False
    one, other = one_px[both], other_px[both]
    size = max(float(np.ptp(one, axis=0).max()), float(np.ptp(other, axis=0).max()))
    return float(np.median(np.linalg.norm(one - other, axis=-1))) < ALIKE * size


def covered(box: Float32, others: list[Float32]) -> float:
    """Return the largest part of a box's area that one of the other boxes covers, 0 to 1."""
    area = max(float((box[2] - box[0]) * (box[3] - box[1])), 1e-6)
    return max((_shared(box, other) / area for other in others), default=0.0)


def overlap(one: Float32, other: Float32) -> float:
    """Return the intersection over union of two boxes, 0 to 1."""
    shared = _shared(one, other)
    areas = sum(max(float((box[2] - box[0]) * (box[3] - box[1])), 0.0) for box in (one, other))
    return shared / max(areas - shared, 1e-6)


def without(image: UInt8, boxes: list[Float32]) -> UInt8:
    """Return a copy of an image (height, width, 3) with the boxes filled with the image's mean colour.

    Without boxes it is the image itself.
    """
    if not boxes:
        return image
    copy, grey = image.copy(), image[::8, ::8].reshape(-1, image.shape[-1]).mean(axis=0)
    for box in boxes:
        left, top, right, bottom = _pixels(box, image)
        copy[top:bottom, left:right] = grey
    return copy


def only(image: UInt8, box: Float32) -> UInt8:
    """Return a copy of an image (height, width, 3) that shows the box's content, and its mean colour elsewhere."""
    left, top, right, bottom = _pixels(box, image)
    copy = np.empty_like(image)
    copy[...] = image[::8, ::8].reshape(-1, image.shape[-1]).mean(axis=0)
    copy[top:bottom, left:right] = image[top:bottom, left:right]
    return copy


def _pixels(box: Float32, image: UInt8) -> tuple[int, int, int, int]:
    height, width = image.shape[:2]
    left, top = (int(max(0.0, np.floor(value))) for value in box[:2])
    right, bottom = min(width, int(np.ceil(box[2])) + 1), min(height, int(np.ceil(box[3])) + 1)
    return left, top, max(left, right), max(top, bottom)


def _shared(one: Float32, other: Float32) -> float:
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(np.prod(np.maximum(sides, 0.0)))
