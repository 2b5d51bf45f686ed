"""Where a static camera's image changes, above its noise."""

import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.sensing.frame_changes import NOISY_LEVELS, SPAN_S, FrameChanges, near_change

STEP = 2


def scene(at=40, bright=1.0, noise=0.0, seed=0):
    """A dark square before stripes, with noise."""
    image = np.full((120, 160, 3), 120.0)
    image[:, ::20] = 160.0
    image[50:74, at : at + 24] = 40.0
    return np.clip(bright * image + np.random.default_rng(seed).normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def changed(*images, apart_s=0.05, step_px=STEP):
    """Densities of images one after the other."""
    changes = FrameChanges(step_px)
    return [changes.update(image, round(k * apart_s * NS_PER_S)) for k, image in enumerate(images)]


def test_of_the_first_image_nothing_is_known_and_an_equal_one_does_not_change():
    first, second = changed(scene(), scene())
    assert first is None
    assert second.shape == (60, 80)
    assert not second.any()


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_noise_is_no_change(noise):
    last = changed(*[scene(noise=noise, seed=k) for k in range(8)])[-1]
    assert (last > 0.05).mean() < 0.01


def test_change_is_where_something_moved_and_not_elsewhere():
    density = changed(scene(40, noise=1.0), scene(44, noise=1.0, seed=1))[-1]
    assert near_change(density, STEP, np.array([[40.0, 62.0], [66.0, 62.0]])).min() > 0.1
    assert near_change(density, STEP, np.array([[120.0, 62.0], [40.0, 100.0]])).max() < 0.05


def test_slow_motion_adds_up_within_the_span_and_what_rests_is_at_rest_after_it():
    slow = [scene(40 + k // 3) for k in range(6)]
    assert changed(*slow)[-1].max() > 0.1, "less than a pixel from image to image"
    rests = [*slow, *[slow[-1]] * round(SPAN_S / 0.05 + 1)]
    assert not changed(*rests)[-1].any()


def test_exposure_is_no_change():
    assert not changed(scene(), scene(bright=1.06))[-1].any()


def test_in_noisy_images_nothing_is_known():
    assert changed(scene(noise=10 * NOISY_LEVELS), scene(noise=10 * NOISY_LEVELS, seed=1))[-1] is None


def test_gray_images_are_taken_too():
    density = changed(scene(40)[..., 0], scene(44)[..., 0])[-1]
    assert density.max() > 0.1


def test_an_image_of_another_size_is_refused_and_named():
    with pytest.raises(InputError, match="80 × 60 samples"):
        changed(scene(), scene()[:100])


def test_a_step_below_one_pixel_is_refused():
    with pytest.raises(SettingsError, match="step_px"):
        FrameChanges(0)


def test_pixels_outside_of_the_image_are_unknown():
    density = np.zeros((60, 80), np.float32)
    near = near_change(density, STEP, np.array([[-1.0, 5.0], [160.0, 5.0], [5.0, 120.0], [0.0, 0.0], [159.4, 119.4]]))
    assert np.isnan(near).tolist() == [True, True, True, False, False]


def test_changes_go_on_from_their_memory():
    one, other = FrameChanges(STEP), FrameChanges(STEP)
    for k in range(5):
        one.update(scene(40 + k), k * NS_PER_S // 10)
    other.recall(one.memory())
    assert np.array_equal(*[each.update(scene(46), 6 * NS_PER_S // 10) for each in (one, other)])
