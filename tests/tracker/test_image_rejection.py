"""How long an image that shows something else is rejected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.tracker.image_rejection import hides_the_body, shows_another_scene
from mocapella.tracker.silhouette_camera import SeenIn, Usually
from mocapella.tracker.silhouette_settings import SilhouetteSettings

SETTINGS = SilhouetteSettings(something_else_s=0.5)
LIMIT_NS = NS_PER_S // 2
NOTHING: Any = None
IMAGE = np.zeros((1, 1), np.uint8)


class Camera:
    """A camera whose image is as it is told to be."""

    def __init__(self) -> None:
        self.usually, self.covers = Usually(), Usually()
        self.changed, self.overlap, self.forgotten = 0.0, 0.9, 0

    def unlike(self, image: Any) -> float:
        return self.changed

    def seen(self) -> SeenIn:
        return SeenIn(NOTHING, NOTHING, self.overlap)

    def forget_background(self) -> None:
        self.forgotten += 1


@pytest.mark.parametrize("began_ns", [0, 7 * NS_PER_S + 1])
def test_an_image_is_accepted_again_once_it_has_shown_something_else_for_the_limit(began_ns: int) -> None:
    cameras: Any = {"good": Camera(), "odd": Camera()}
    images = dict.fromkeys(cameras, IMAGE)

    def rejected(time_ns: int) -> tuple[set[str], set[str]]:
        return (
            set(shows_another_scene(cameras, images, {}, SETTINGS, time_ns)),
            set(hides_the_body(cameras, {}, SETTINGS, time_ns)),
        )

    assert rejected(began_ns - 1) == (set(), set())
    cameras["odd"].changed, cameras["odd"].overlap = 1.0, 0.1
    for after_ns in (0, 1, LIMIT_NS - 1):
        assert rejected(began_ns + after_ns) == ({"odd"}, {"odd"})
        assert cameras["odd"].forgotten == 0
    assert rejected(began_ns + LIMIT_NS) == (set(), set())
    assert (cameras["odd"].forgotten, cameras["good"].forgotten) == (1, 0)
