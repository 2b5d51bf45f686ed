"""What is behind the body, from images of the empty room: known before the first frame instead of learnt on the way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.tracker.silhouettes import SilhouetteTracker

UInt8 = NDArray[np.uint8]


def learn_backgrounds(tracker: SilhouetteTracker, images: Mapping[str, UInt8]) -> None:
    """Take in one image of the empty room from each camera; after `SilhouetteTracker.start`.

    Args:
        tracker: whose memories these are; one whose cameras move has none.
        images: (height, width, 3) BGR by camera, of the size that the rig has.

    Raises:
        InputError: an image of another size than before.
    """
    for name, image in images.items():
        camera = tracker._cameras.get(name)
        if camera is not None and camera.memory is not None:
            camera.memory.update(image, None)
