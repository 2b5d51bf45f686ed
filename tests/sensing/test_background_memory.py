"""What is behind people is learnt where they are not, and whether an image is of the same room."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.signed_distance import signed_distance
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background_memory import BackgroundMemory, MemorySettings
from mocapella.sensing.region_contour import RegionSettings, read_band

UInt8 = NDArray[np.uint8]
HEIGHT, WIDTH = 120, 160


def room(seed: int = 0, channels: int = 3) -> UInt8:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(30, 220, (HEIGHT // 10, WIDTH // 10, channels))
    return np.asarray(np.kron(coarse, np.ones((10, 10, 1))), dtype=np.uint8)


def costs(memory: BackgroundMemory, image: UInt8, window: Silhouette) -> NDArray[np.float32]:
    """(rows, columns) of the window, all of which is looked at."""
    settings = RegionSettings(median=False)
    band = read_band(image, window, None, None, settings, guided=False)
    return memory.costs(band, settings).reshape(band.phi.shape)[:, band.pad : band.pad + window.phi.shape[1]]


def person(x: int, step: int = 2, reach: float = 16.0) -> tuple[Silhouette, NDArray[np.bool_]]:
    """A box of 12 × 30 px in the image's middle rows, and its mask."""
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[15:45, x : x + 12] = True
    return Silhouette((0, 0), step, signed_distance(mask[::step, ::step], reach, step)), mask


def shown(seed: int, mask: NDArray[np.bool_], noise: float = 2.0, level: int = 128) -> UInt8:
    rng = np.random.default_rng(seed)
    image = np.where(mask[..., None], level, room().astype(float)) + rng.normal(0, noise, (HEIGHT, WIDTH, 3))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("step", [1, 2])
def test_what_is_learnt_is_the_room_wherever_nobody_was_near(step: int) -> None:
    memory = BackgroundMemory(step, MemorySettings(guard_steps=3))
    for k in range(30):
        who, mask = person(10 + k, step)
        memory.update(shown(k, mask), who)
    empty = room()
    everywhere = Silhouette((0, 0), step, np.zeros(memory.known.shape, np.float32))
    told = costs(memory, empty, everywhere)
    assert (np.isfinite(told) == memory.known).all()
    assert memory.known.mean() > 0.9  # it walked by
    usual = 3 * np.log(2 * memory.settings.least_sd)
    assert np.nanmedian(told) == pytest.approx(usual, abs=0.5)  # squares and tents differ at edges
    assert np.nanpercentile(told, 90) < usual + 2
    who, mask = person(30, step)
    inside = (who.phi > step) & memory.known
    other = costs(memory, shown(77, mask, level=255), everywhere)
    assert np.median(other[inside]) > usual + 9


def test_near_a_person_nothing_is_learnt() -> None:
    memory = BackgroundMemory(2, MemorySettings(guard_steps=3))
    who, mask = person(30)
    memory.update(shown(0, mask), who)
    assert (memory.known == (who.phi < -6)).all()


def test_where_others_are_nothing_is_learnt() -> None:
    memory = BackgroundMemory(2, MemorySettings(guard_steps=3))
    who, _ = person(30)
    others = np.zeros((HEIGHT, WIDTH), dtype=bool)
    others[:, 100:] = True
    memory.update(room(), who, others)
    assert (memory.known == ((who.phi < -6) & ~others[::2, ::2])).all()
    with pytest.raises(InputError, match="mask is not of the image"):
        memory.update(room(), who, others[:-1])


def test_what_the_model_covers_is_not_learnt_though_its_contour_is_elsewhere() -> None:
    memory = BackgroundMemory(2, MemorySettings(guard_steps=3))
    covered = np.zeros((HEIGHT // 2, WIDTH // 2), np.uint8)
    covered[20:30, 60:70] = 1
    who, _ = person(30)
    memory.update(room(), who, None, covered)
    free = (who.phi < -6) & (covered == 0)
    np.testing.assert_array_equal(memory.known, free)
    with pytest.raises(InputError, match="mask is not of the window"):
        memory.update(room(), who, None, covered[:-1])


def test_whoever_stands_still_is_not_learnt_but_what_lies_far_away_is() -> None:
    """What is far from people is taken in stripe by stripe, so that a lamp that is switched on is background soon."""
    memory = BackgroundMemory(2, MemorySettings(rate=0.5, sweep_images=4))
    who, mask = person(30)
    memory.update(shown(0, mask), who)
    for k in range(40):
        image = shown(k, mask)
        image[:, 70:] = 250
        memory.update(image, who)
    lit = shown(99, mask)
    lit[:, 70:] = 250
    assert memory.unlike(lit, who) == 0
    assert not memory.known[who.phi > 0].any()


@given(st.integers(0, 1000), st.sampled_from([1, 3]))
def test_another_image_is_told_from_noise(seed: int, channels: int) -> None:
    memory = BackgroundMemory(2, MemorySettings(every=2))
    who, _ = person(30)
    for k in range(5):
        memory.update(noisy(room(0, channels), k), who)
    assert memory.unlike(noisy(room(0, channels), seed + 100), who) < 0.05
    assert memory.unlike(noisy(room(seed + 1, channels), seed), who) > 0.4
    assert memory.unlike(np.zeros((HEIGHT, WIDTH, channels), np.uint8), who) > 0.5
    rng = np.random.default_rng(seed)
    salted = noisy(room(0, channels), 3)
    hit = rng.random((HEIGHT, WIDTH)) < 0.15
    salted[hit] = rng.integers(0, 256, (int(hit.sum()), channels))
    assert memory.unlike(salted, who) < 0.5


def noisy(image: UInt8, seed: int) -> UInt8:
    return np.clip(image + np.random.default_rng(seed).normal(0, 4, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("noise", "lost"), [(18.0, False), (23.0, True)])
def test_an_image_of_twice_the_first_noise_is_another_everywhere(noise: float, lost: bool) -> None:
    """The first standard deviation is the least one, 10 grey levels."""
    grey = np.full((HEIGHT, WIDTH, 3), 128.0)
    memory = BackgroundMemory(1, MemorySettings(every=1))
    memory.update(grey.astype(np.uint8), None)
    image = np.clip(grey + np.random.default_rng(0).normal(0, noise, grey.shape), 0, 255).astype(np.uint8)
    assert (memory.unlike(image, None) == 1.0) == lost


def test_before_anything_is_known_nobody_can_say() -> None:
    memory = BackgroundMemory(2)
    assert np.isnan(memory.unlike(room(), None))
    assert np.isnan(costs(memory, room(), person(30)[0])).all()


def test_grey_images_have_no_axis_of_channels() -> None:
    grey, both = BackgroundMemory(2), BackgroundMemory(2)
    image = room(0, 1)
    grey.update(image[..., 0], None)
    both.update(image, None)
    window = person(30)[0]
    assert costs(grey, image[..., 0], window) == pytest.approx(costs(both, image, window))


def test_beyond_the_image_nothing_is_known() -> None:
    memory = BackgroundMemory(2)
    memory.update(room(), None)
    window = Silhouette((-6, -4), 2, np.zeros((10, 12), np.float32))
    told = costs(memory, room(), window)
    assert np.isnan(told[:2]).all()
    assert np.isnan(told[:, :3]).all()
    assert np.isfinite(told[2:, 3:]).all()


def seen_by(memory: BackgroundMemory, images: int = 5) -> BackgroundMemory:
    """After so many noisy images of the empty room."""
    for k in range(images):
        memory.update(noisy(room(), k), None)
    return memory


def all_of_it(memory: BackgroundMemory) -> Silhouette:
    return Silhouette((0, 0), memory.step_px, np.zeros(memory.known.shape, np.float32))


@pytest.mark.parametrize("step", [1, 2, 3])
def test_somebody_is_strange_and_the_room_is_not(step: int) -> None:
    memory, (_, mask) = seen_by(BackgroundMemory(step)), person(40)
    told = memory.strange(shown(77, mask, level=255), all_of_it(memory), 1)
    inside, beside = (as_samples(mask, step, by) for by in (-2, 2))
    assert inside.sum() > 0
    assert (told[inside] == 1).all()
    assert told[~beside].mean() < -0.95
    assert (np.abs(told) <= 1).all()
    assert memory.strange(noisy(room(), 99), all_of_it(memory), 1).mean() < -0.95


def as_samples(mask: NDArray[np.bool_], step: int, by: int) -> NDArray[np.bool_]:
    """Which samples are in the mask after it is grown by so many of them, or shrunk."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    out = np.zeros((-(-HEIGHT // step), -(-WIDTH // step)), dtype=bool)
    out[rows[0] // step - by : rows[-1] // step + by + 1, columns[0] // step - by : columns[-1] // step + by + 1] = True
    return out


def test_a_sample_alone_is_outvoted() -> None:
    """Of five samples, it and those beside it, it is one: salt in an image is nobody."""
    memory = seen_by(BackgroundMemory(2))
    image = room()
    part = image[59:62, 79:82, 1].astype(int)
    image[59:62, 79:82, 1] = np.where(part > 127, part - 60, part + 60)
    told = memory.strange(image, all_of_it(memory), 1)
    assert (told < 0).all()
    assert (told > -1).any()


def darkened(share: float, channels: int = 3, colour: float = 0.0) -> tuple[UInt8, NDArray[np.bool_]]:
    """The room with a shadow that leaves that share of the light, greener by so many grey levels; and where."""
    _, mask = person(40)
    image = room(channels=channels).astype(float)
    image[mask] *= share
    image[mask, channels // 2] += colour
    return np.clip(np.round(image), 0, 255).astype(np.uint8), as_samples(mask, 2, -2)


@given(st.floats(0.45, 1.0))
def test_a_shadow_is_nobody_and_whether_somebody_is_there_is_not_known(share: float) -> None:
    memory = seen_by(BackgroundMemory(2))
    image, inside = darkened(share)
    told = memory.strange(image, all_of_it(memory), 1)
    assert (told[inside] <= 0).all()
    if share < 0.7:
        assert (told[inside] == 0).any()
    if share > 0.97:
        assert (told[inside] == -1).all()


@given(st.floats(0.0, 0.3))
def test_what_is_darker_than_a_shadow_or_of_another_colour_is_somebody(share: float) -> None:
    memory = seen_by(BackgroundMemory(2))
    for image, inside in (darkened(share), darkened(0.6 + share, colour=90.0)):
        assert memory.strange(image, all_of_it(memory), 1)[inside].mean() > 0.9


def test_without_colour_a_shadow_is_not_told_and_less_is_strange() -> None:
    memory = BackgroundMemory(2)
    for k in range(5):
        memory.update(noisy(room(channels=1), k), None)
    image, inside = darkened(0.5, channels=1)
    bright = room(channels=1)[::2, ::2, 0] > 100
    told = memory.strange(image, all_of_it(memory), 1)[inside & bright]
    assert told.mean() > 0.9
    image, _ = darkened(1.0, channels=1, colour=20.0)  # two of the least deviations: in colour that would be much
    assert (memory.strange(image, all_of_it(memory), 1)[inside] == -1).all()


@given(st.integers(1, 5), st.integers(-8, 40), st.integers(-8, 40))
def test_every_so_manieth_sample_says_what_it_says_among_all(every: int, x: int, y: int) -> None:
    memory, image = seen_by(BackgroundMemory(2), 2), shown(3, person(40)[1])
    window = Silhouette((2 * x, 2 * y), 2, np.zeros((23, 31), np.float32))
    some, each = memory.strange(image, window, every), memory.strange(image, window, 1)
    np.testing.assert_array_equal(some, each[::every, ::every])
    whole = memory.strange(image, all_of_it(memory), 1)
    for (i, j), value in np.ndenumerate(each):
        a, b = i + y, j + x
        if 0 <= a < whole.shape[0] and 0 <= b < whole.shape[1]:
            assert value == whole[a, b]
        else:
            assert value == 0 or a in {-1, whole.shape[0]} or b in {-1, whole.shape[1]}


def test_points_are_as_strange_as_the_samples_next_to_them_and_beyond_the_image_nobody_knows() -> None:
    memory, image = seen_by(BackgroundMemory(2)), shown(3, person(40)[1])
    told = memory.strange(image, all_of_it(memory), 1)
    rows, columns = np.random.default_rng(0).integers(0, told.shape, (50, 2)).T
    aside = np.random.default_rng(1).uniform(-0.9, 0.9, (50, 2))
    np.testing.assert_array_equal(memory.strange_at(image, 2.0 * np.c_[columns, rows] + aside), told[rows, columns])
    assert len(set(told[rows, columns].tolist())) > 1
    beyond = np.array([[-2.0, 5.0], [5.0, -2.0], [WIDTH + 1.0, 5.0], [5.0, HEIGHT + 1.0], [-1e6, -1e6]])
    np.testing.assert_array_equal(memory.strange_at(image, beyond), 0)


def test_what_nobody_knows_is_neither_strange_nor_the_room() -> None:
    memory, (who, mask) = BackgroundMemory(2), person(40)
    image = shown(0, mask)
    assert (memory.strange(image, Silhouette((0, 0), 2, np.zeros((60, 80), np.float32)), 1) == 0).all()
    assert (memory.strange_at(image, np.array([[50.0, 50.0]])) == 0).all()
    for _ in range(3):
        memory.update(image, who)
    told = memory.strange(image, all_of_it(memory), 1)
    crosses = np.pad(memory.known, 1).astype(int)
    of_five = crosses[1:-1, 1:-1] + crosses[:-2, 1:-1] + crosses[2:, 1:-1] + crosses[1:-1, :-2] + crosses[1:-1, 2:]
    np.testing.assert_array_equal(told == 0, of_five < 3)
    assert (told[of_five >= 3] < 0).all()
    with pytest.raises(InputError, match="multiple of 2 px"):
        memory.strange(image, Silhouette((1, 0), 2, np.zeros((4, 4), np.float32)), 1)
    with pytest.raises(InputError, match="size changed"):
        memory.strange_at(image[:-2], np.zeros((1, 2)))


def test_what_is_forgotten_is_not_known() -> None:
    memory = BackgroundMemory(2)
    memory.update(room(), None)
    memory.reset()
    memory.update(np.zeros((10, 10), np.uint8), None)  # another size is as good
    assert memory.known.shape == (5, 5)


def test_a_window_that_does_not_fit_is_refused() -> None:
    memory = BackgroundMemory(2)
    memory.update(room(), None)
    for window in (
        Silhouette((1, 0), 2, np.zeros((4, 4), np.float32)),
        Silhouette((0, 0), 1, np.zeros((4, 4), np.float32)),
    ):
        with pytest.raises(InputError, match="multiple of 2 px"):
            costs(memory, room(), window)
    with pytest.raises(InputError, match="size changed"):
        memory.update(room()[:-2], None)


@pytest.mark.parametrize(
    "wrong",
    [
        {"guard_steps": -1},
        {"rate": 0},
        {"rate": 2},
        {"least_sd": 0},
        {"sweep_images": 0},
        {"cut_sd": 0},
        {"every": 0},
        {"strange_sd": 0},
        {"strange_gray_sd": 0},
        {"shadow": 0},
        {"shadow": 1.1},
        {"shadow_sd": 0},
        {"window_images": 0},
    ],
)
def test_settings_of_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        MemorySettings(**wrong)


def test_a_step_below_one_is_refused() -> None:
    with pytest.raises(SettingsError, match="step_px"):
        BackgroundMemory(0)


def _with_a_thing(far_px, **other):
    """Sample counts of a learnt wall after a person came, and a thing ``far_px`` wide right beside them."""
    wall = np.full((96, 160, 3), 120, np.uint8)
    memory = BackgroundMemory(2)
    for _ in range(3):
        memory.update(wall, None)
    image = wall.copy()
    image[20:80, 40:70] = 10
    image[40:60, 70 : 70 + far_px] = 10
    phi = np.full((48, 80), -20.0, np.float32)
    phi[10:40, 20:35] = 20.0
    columns = np.arange(80)
    phi[:, 35:] = np.maximum(-2.0 * (columns[35:] - 34), -20.0)
    forgotten = memory.forget_things(image, Silhouette((0, 0), 2, phi), **other)
    return memory.known, forgotten


def test_the_room_is_forgotten_where_a_thing_reaches_away_from_a_person_and_beside_it():
    known, forgotten = _with_a_thing(40)
    assert not known[20:30, 35:55].any()
    assert not known[25, 30], "behind the person, beside the thing"
    assert known[25, 20], "behind the person, far from it"
    assert known[:, 60:].all(), "the rest of the room"
    assert forgotten == np.count_nonzero(~known)


def test_what_differs_just_beside_a_person_may_be_the_person():
    known, forgotten = _with_a_thing(8)
    assert known.all()
    assert forgotten == 0


def test_other_people_are_no_things():
    others = np.zeros((96, 160), bool)
    others[36:64, 70:116] = True
    known, forgotten = _with_a_thing(40, others=others)
    assert known.all()
    assert forgotten == 0


def test_nothing_is_forgotten_before_anything_is_learnt():
    phi = np.full((48, 80), -20.0, np.float32)
    assert BackgroundMemory(2).forget_things(np.zeros((96, 160, 3), np.uint8), Silhouette((0, 0), 2, phi)) == 0
