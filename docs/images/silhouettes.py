"""Makes silhouettes.jpg: what simulated cameras see of people, and what is true of it.

python docs/images/silhouettes.py [FILE.jpg]
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from mocapella.sources.simulate.silhouette_scene import Corruption, SilhouetteScene, silhouette_scene

HERE = Path(__file__).parent
SIZE = (320, 240)


def outlined(scene: SilhouetteScene, k: int) -> list[np.ndarray]:
    """The pictures of frame k with the true outline drawn in."""
    pictures = []
    for image, mask in zip(scene.images(k), scene.masks(k), strict=True):
        outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        pictures.append(cv2.drawContours(image, outlines, -1, (80, 255, 80), 1))
    return pictures


def main(file: Path) -> None:
    """Draw it."""
    bend = silhouette_scene("knee-bend", seed=0, size_px=SIZE)
    runner = silhouette_scene("runner", seed=2, size_px=SIZE, corruption=Corruption(noise=0.15, rectangles=3))
    turns = [silhouette_scene("flick-flack", seed=5, size_px=SIZE), silhouette_scene("cartwheel", seed=9, size_px=SIZE)]
    pair = silhouette_scene("walk", seed=8, size_px=SIZE, people=2)
    rows = [
        outlined(bend, 60),
        runner.images(30)[:2] + pair.images(70)[:2],
        [scene.images(round(share * len(scene)))[1] for scene in turns for share in (0.42, 0.55)],
    ]
    cv2.imwrite(str(file), np.vstack([np.hstack(row) for row in rows]), [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "silhouettes.jpg")
