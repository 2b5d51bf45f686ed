"""How long an image that shows something else is rejected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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


def watching(changed: list[float], overlaps: list[float] | None = None) -> dict[str, Camera]:
    """Cameras by number, which usually see a tenth of the background changed and nine tenths of the body."""
    made = {}
    for k, (share, overlap) in enumerate(zip(changed, overlaps or [0.9] * len(changed), strict=True)):
        made[f"c{k}"] = camera = Camera()
        camera.usually.learn(0.1)
        camera.covers.learn(0.9)
        camera.changed, camera.overlap = share, overlap
    return made


SOME, MUCH = (next(iter(watching([0.0]).values())).usually.most(),
              next(iter(watching([0.0]).values())).usually.much(SETTINGS.unlike))  # fmt: skip
LEAST = next(iter(watching([0.0]).values())).covers.least()


def another_scene(changed: list[float], left_out: int = 0) -> set[str]:
    cameras: Any = watching(changed)
    others = {f"other {k}": "it is dark" for k in range(left_out)}
    return set(shows_another_scene(cameras, dict.fromkeys(cameras, IMAGE), others, SETTINGS, 0))


@given(st.integers(1, 7), st.integers(0, 7), st.integers(0, 5))
def test_a_change_that_is_not_much_counts_if_it_is_in_half_of_all_cameras_and_in_two(
    seen: int, changed: int, left_out: int
) -> None:
    """Cameras whose image was rejected before count as changed."""
    changed = min(changed, seen)
    enough = changed + left_out >= 2 and 2 * (changed + left_out) >= seen + left_out
    between = 0.5 * (SOME + MUCH)
    found = another_scene([between] * changed + [0.1] * (seen - changed), left_out)
    assert found == ({f"c{k}" for k in range(changed)} if enough else set())


def test_a_change_is_some_or_much_above_the_thresholds_themselves() -> None:
    assert SOME < MUCH
    assert another_scene([MUCH, 0.1, 0.1]) == set()
    assert another_scene([np.nextafter(MUCH, 1), 0.1, 0.1]) == {"c0"}
    assert another_scene([SOME, SOME]) == set()
    assert another_scene([np.nextafter(SOME, 1)] * 2) == {"c0", "c1"}


def hidden(overlaps: list[float], left_out: int = 0) -> set[str]:
    cameras: Any = watching([0.1] * len(overlaps), overlaps)
    return set(hides_the_body(cameras, {f"other {k}": "" for k in range(left_out)}, SETTINGS, 0))


def test_an_outline_is_anothers_below_the_threshold_itself_and_not_if_that_is_so_in_every_camera() -> None:
    below = np.nextafter(LEAST, 0)
    assert hidden([LEAST, 0.9]) == set()
    assert hidden([below, 0.9]) == {"c0"}
    assert hidden([below, below]) == set(), "the body moved"
    assert hidden([below, below], left_out=1) == {"c0", "c1"}
