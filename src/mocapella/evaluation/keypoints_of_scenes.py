"""Keypoints of the person of a simulated scene, as a detector would give them, beside its images."""

from __future__ import annotations

from typing import Final

import numpy as np

from mocapella.kinematics.silhouette_fit import eye, seen_at
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.topology import topology
from mocapella.sources.simulate.silhouette_scene import SilhouetteScene

OFFSET_M: Final = 0.02
"""Standard deviation of the constant offset of a keypoint from the landmark, along each axis [m]."""
SCATTER: Final = 0.015
"""Standard deviation of a keypoint's scatter in an image, relative to the person's height there [ratio]."""
WRONG: Final = 0.03
"""Share of keypoints that are at a random place near the person, half of the person's height away or less."""


def drawn_keypoints(scene: SilhouetteScene, k: int, time_ns: int) -> list[KeypointFrame]:
    """Return the keypoints of a scene's first person in all images of a frame.

    They are off by a constant offset and by scatter, and a few are at wrong places.

    Args:
        scene: the scene.
        k: index of the frame; scatter and wrong places differ from frame to frame.
        time_ns: capture time, on the common clock.
    """
    names = list(scene.mesh.landmarks)
    halpe = topology("halpe_26")
    columns = [names.index(LANDMARKS[name]) if LANDMARKS.get(name) in names else -1 for name in halpe.joints]
    offsets = np.random.default_rng([scene.seed, 7]).normal(0.0, OFFSET_M, (len(names), 3))
    places = scene.landmarks(k) + offsets
    out = []
    for c, (name, placed) in enumerate(scene.rig.cameras.items()):
        rng = np.random.default_rng([scene.seed, 8, k, c])
        pixels = seen_at(places, eye(placed))
        high = float(np.ptp(pixels[:, 1]))
        pixels = pixels + rng.normal(0.0, SCATTER * high, pixels.shape)
        wrong = rng.random(len(pixels)) < WRONG
        pixels = np.where(wrong[:, None], pixels + rng.uniform(-0.5, 0.5, pixels.shape) * high, pixels)
        width, height = placed.camera.size_px
        inside = np.asarray(((pixels >= 0) & (pixels < [width, height])).all(axis=1))
        seen = np.where(inside[:, None], pixels, np.nan)[columns]
        seen[np.array(columns) < 0] = np.nan
        out.append(
            keypoint_frame(
                name, halpe, time_ns=time_ns, size_px=placed.camera.size_px, positions_px=seen[None], confidences=0.8,
                sequence=k,
            )
        )  # fmt: skip
    return out
