from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.marker_images import scene, shot

from mocapella.errors import SettingsError
from mocapella.sources.simulate.camera_image import CameraImageSettings, camera_image
from mocapella.sources.simulate.marker_kinds import MARKER_KINDS
from mocapella.sources.simulate.marker_scene import (
    MIXED,
    ON_OTHER,
    ON_SKIN,
    ON_WALL,
    load_marker_scene,
    marker_scene_names,
    marker_scene_settings,
    scene_of,
)  # fmt: skip

CLEAN = CameraImageSettings(lens_blur_px=0.0, photons=1e6, read_noise=0.0, bayer=False, shared_chroma=False, exposure=1)


def test_the_same_scene_seed_and_time_give_the_same_image() -> None:
    again = type(scene())(scene().settings, 7).at(0.0)
    np.testing.assert_array_equal(again.image, shot(0.0).image)
    assert (type(scene())(scene().settings, 8).at(0.0).image != again.image).any()


@pytest.mark.parametrize("changed", [{}, {"readout_s": 0.02}])
def test_the_paints_centre_of_area_is_the_stated_one(changed: dict[str, float]) -> None:
    """Without shading, a marker's weight is its coverage: the difference to the same picture in another paint."""
    flat = dict(
        shading=0.0, camera=CLEAN, brightness_change=1.0, colour_change=0.0, skin_gloss=0.0, curl=0.0, **changed
    )
    made = scene(**flat)
    black = dataclasses.replace(made.settings.paints[5], albedo=(0.0, 0.0, 0.0))
    other = scene(**flat, paints=(*made.settings.paints[:5], black))
    a, b = made.at(0.4), other.at(0.4)
    light = np.where((c := np.arange(256) / 255) <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    weight = np.abs(light[a.image[..., 0]] - light[b.image[..., 0]])
    y, x = np.indices(weight.shape)
    centre = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
    np.testing.assert_allclose(centre, a.centres_px[5], atol=0.05)
    assert a.visible[5] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("kind", MARKER_KINDS)
def test_a_marker_of_each_kind_has_its_stated_centre_and_area(kind: str) -> None:
    """Of the pixels that are the marker's alone, and half of those at its edge."""
    made = scene(kind=kind, curl=0.0)
    labels, seen = made.labels(0.4), made.at(0.4)
    y, x = np.indices(labels.shape)
    for marker in range(6):
        own = labels == marker
        ring = (np.hypot(x - seen.centres_px[marker, 0], y - seen.centres_px[marker, 1]) < 30) & (labels == MIXED)
        np.testing.assert_allclose((x[own].mean(), y[own].mean()), seen.centres_px[marker], atol=0.35)
        area = np.pi * seen.radii_px[marker] ** 2
        assert own.sum() < area < own.sum() + ring.sum()
    np.testing.assert_allclose(seen.visible, 1.0, atol=0.05)


def test_labels_are_of_wall_skin_markers_and_other_things() -> None:
    plain, grey = scene(curl=0.0).labels(0.4), scene(kind="grey-bordered", curl=0.0).labels(0.4)
    assert set(np.unique(plain)) == {MIXED, ON_SKIN, ON_WALL, *range(6)}
    assert set(np.unique(grey)) == {MIXED, ON_OTHER, ON_SKIN, ON_WALL, *range(6)}
    assert (scene(hand=False).labels(0.4) == ON_WALL).all()
    image = scene(camera=CLEAN, curl=0.0, skin_gloss=0.0).at(0.4).image.astype(int)
    assert (image[plain == ON_SKIN, 2] > image[plain == ON_SKIN, 0]).mean() > 0.99


def test_repeats_differ_in_noise_only() -> None:
    one, other = scene().repeats(0.4, 2)
    once = scene().at(0.4)
    assert (one.image != other.image).any()
    assert np.abs(one.image.astype(int) - other.image).mean() < 4
    np.testing.assert_array_equal(one.centres_px, once.centres_px)
    np.testing.assert_array_equal(one.visible, once.visible)
    a, b = scene(camera=dataclasses.replace(CLEAN, photons=1e6)).repeats(0.4, 2)
    assert np.abs(a.image.astype(int) - b.image).max() <= 3
    np.testing.assert_array_equal(next(scene().repeats(0.4, 1)).image, one.image)


def test_a_kinds_shapes_are_its_own() -> None:
    areas = {kind: scene(kind=kind).at(0.4).radii_px for kind in MARKER_KINDS}
    assert (areas["nail"][:5] < areas["grey-bordered"][:5]).all()
    assert (areas["grey-bordered"][:5] < areas["painted"][:5]).all()
    assert (areas["painted"][:5] < areas["shrink-tube"][:5]).all()
    assert len({radii[5] for radii in areas.values()}) == 1


def test_what_is_hidden_or_outside_is_not_visible() -> None:
    gone = scene("hidden", travel_px=(2000.0, 0.0), sway_hz=0.3)
    visible = np.array([gone.at(t).visible for t in np.arange(0.0, 4.0, 0.4)])
    assert visible.min() == 0.0
    assert visible.max() < 1.1


def test_a_uniform_picture_keeps_its_value_and_noise_has_its_size() -> None:
    grey = np.full((64, 64, 3), 0.25, np.float32)
    clean = camera_image(grey, CLEAN, np.random.default_rng(0))
    assert np.abs(clean.astype(int) - 137).max() <= 1  # sRGB of 0.25
    noisy = dataclasses.replace(CLEAN, read_noise=0.02)
    sd = camera_image(grey, noisy, np.random.default_rng(0)).astype(float).std()
    slope = 255 * 1.055 / 2.4 * 0.25 ** (1 / 2.4 - 1)
    assert sd == pytest.approx(0.02 * slope, rel=0.1)


def test_bayer_and_shared_chroma_blur_colour_and_keep_its_mean() -> None:
    picture = np.full((64, 64, 3), 0.2, np.float32)
    picture[:, 32:] = (0.6, 0.05, 0.05)
    plain = camera_image(picture, CLEAN, np.random.default_rng(0)).astype(float)
    both = dataclasses.replace(CLEAN, bayer=True, shared_chroma=True)
    mixed = camera_image(picture, both, np.random.default_rng(0)).astype(float)
    np.testing.assert_allclose(mixed[:, :28], plain[:, :28], atol=2)
    np.testing.assert_allclose(mixed[:, 36:], plain[:, 36:], atol=2)
    assert np.abs(mixed - plain)[:, 30:34].max() > 10


def test_every_scene_can_be_photographed() -> None:
    for name in marker_scene_names():
        made = scene(name, size_px=(64, 48), palm_px=12.0).at(0.1)
        assert made.image.shape == (48, 64, 3)
        assert np.isfinite(made.centres_px).all()


def test_bad_scenes_are_refused() -> None:
    with pytest.raises(SettingsError, match="did you mean desk"):
        load_marker_scene("dek")
    common = {"paints": [dataclasses.asdict(p) for p in marker_scene_settings("desk").paints]}
    with pytest.raises(SettingsError, match="did you mean clutter"):
        scene_of({"common": common, "scenes": {"x": {"cluter": 1.0}}}, "x")
    with pytest.raises(SettingsError, match="paints"):
        dataclasses.replace(marker_scene_settings("desk"), paints=())
    with pytest.raises(SettingsError, match=r"kind is 'nails'.*did you mean nail"):
        dataclasses.replace(marker_scene_settings("desk"), kind="nails")
    with pytest.raises(SettingsError, match="size_px"):
        dataclasses.replace(marker_scene_settings("desk"), size_px=(63, 64))
    for name in ("exposure", "lens_blur_px", "photons", "read_noise", "saturation"):
        with pytest.raises(SettingsError, match=name):
            CameraImageSettings(**{name: -1.0})
