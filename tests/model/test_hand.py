from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import InputError, SettingsError
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, LANDMARKS, PARENTS, HandShape, hand_model, hand_model_from_toml
from mocapella.model.hand_file import decode_hand_shape, encode_hand_shape, load_hand_shape, save_hand_shape

TEXT = files("mocapella.model").joinpath("hands", "human.toml").read_text(encoding="utf-8")
anything = arrays(np.float64, 21, elements=st.floats(allow_nan=True, allow_infinity=True))


@pytest.mark.parametrize("constraints", ["full", "thesis"])
@given(anything)
def test_whatever_comes_in_is_brought_within_the_limits(constraints: str, angles: np.ndarray) -> None:
    model = hand_model(constraints)  # type: ignore[arg-type]
    limited = model.limited(angles)
    assert model.within(limited)
    np.testing.assert_allclose(model.limited(limited), limited, atol=1e-12)
    assert not model.within(np.where(np.arange(21) == 4, np.nan, limited))


def test_the_thesis_has_fifteen_angles_and_the_whole_hand_twenty_one() -> None:
    for constraints, free in (("full", 21), ("thesis", 15)):
        model = hand_model(constraints)  # type: ignore[arg-type]
        turning = (model.limits[:, 0] < model.limits[:, 1]).sum() - sum(model.coupled)
        assert turning == free
    assert (len(ANGLES), len(LANDMARKS), len(PARENTS)) == (21, 21, 21)
    assert len(set(DIGIT_ANGLES.ravel()) - {-1}) == 21


def test_limits_are_those_of_the_thesis() -> None:
    limits = dict(zip(ANGLES, np.degrees(hand_model("thesis").limits).round(9).tolist(), strict=True))
    assert limits["index MCP flexion"] == [0, 90]
    assert limits["ring PIP flexion"] == [0, 110]
    assert limits["little DIP flexion"] == [0, 90]
    assert limits["index MCP abduction"] == [-15, 15]
    assert limits["middle MCP abduction"] == [0, 0]
    assert limits["thumb MCP abduction"] == [0, 0]


@pytest.mark.parametrize(
    ("flexion", "abduction", "within"),
    [
        (0, 15, True),
        (0, 15.1, False),
        (45, 12.9, True),
        (45, 13.1, False),
        (90, 0, True),
        (89, 4, False),
        (-0.1, 0, False),
    ],
)
def test_the_limit_of_a_two_axis_joint_is_a_cone_with_an_elliptic_section(
    flexion: float, abduction: float, within: bool
) -> None:
    model = hand_model("full")
    angles = model.natural.copy()
    angles[DIGIT_ANGLES[1, :2]] = np.radians([flexion, abduction])
    assert bool(model.within(angles)) is within
    angles[DIGIT_ANGLES[1, 1]] *= -1
    assert bool(model.within(angles)) is within


def test_a_broken_coupling_is_outside_the_limits_of_the_thesis_only() -> None:
    angles = hand_model("full").natural.copy()
    angles[ANGLES.index("ring DIP flexion")] += 0.1
    assert hand_model("full").within(angles)
    assert not hand_model("thesis").within(angles)


def test_a_shape_scales_with_length_and_breadth() -> None:
    model = hand_model()
    one, two = model.shape("left", hand_length_m=0.1), model.shape("left", hand_length_m=0.2, hand_breadth_m=0.09)
    np.testing.assert_allclose(two.lengths, 2 * one.lengths)
    np.testing.assert_allclose(two.bases[:, 1:], 2 * one.bases[:, 1:])
    np.testing.assert_allclose(two.bases[1, 0], 0.29 * 0.09)
    for wrong in ({"hand_length_m": 2.0}, {"hand_breadth_m": 0.0}, {"hand_length_m": float("nan")}):
        with pytest.raises(SettingsError, match="hand_"):
            model.shape("left", **wrong)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("middle_deg = [0, 60]", "middle_deg = [5, 60]", "middle_deg"),
        ("last_deg = [0, 90]", "last_deg = [0, 60]", "coupling_thirds"),
        ("abduction_deg = [-15, 15]", "abduction_deg = [-15, 20]", "abduction_deg"),
        ("flexion_deg = [0, 90]", "flexion_deg = [10, 90]", "flexion_deg"),
        ("lengths = [0.265", "lengths = [-0.265", "lengths"),
        ("bends_towards = [0, -1, 0]", "bends_towards = [0, 0, 2]", "bends_towards"),
        ("coupling_thirds = 2", "coupling_thirds = 9", "coupling_thirds"),
        ("[digits.index]", "[digits.indx]", "did you mean index"),
        ("natural_deg = [25", "naturl_deg = [25", "did you mean natural_deg"),
        ("middle_ring = 15", "middle_ring = 0", "neighbours_deg"),
        ("ring_little = 20", "", "ring_little is missing"),
        ("hand_length_m = 0.189", "hand_lenght_m = 0.189", "did you mean hand_length_m"),
        ("= [-10, 10]", "= [10, 20]", "thumb_mcp_abduction_deg"),
    ],
)
def test_a_wrong_file_is_refused_and_says_where(old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(SettingsError, match=message):
        hand_model_from_toml(TEXT.replace(old, new, 1))


def test_an_unknown_hand_or_set_is_refused() -> None:
    with pytest.raises(SettingsError, match="known: human"):
        hand_model("full", "humna")
    with pytest.raises(SettingsError, match="full or thesis"):
        hand_model("some")  # type: ignore[arg-type]


def test_a_hand_is_saved_and_read_again(tmp_path: Path) -> None:
    shape = hand_model().shape("left", hand_length_m=0.2, person="Ada")
    measured = HandShape(shape.handedness, shape.lengths, shape.bases, shape.person, 0.1 * shape.lengths)
    path = tmp_path / "hand.json"
    save_hand_shape(path, measured)
    read = load_hand_shape(path)
    assert (read.handedness, read.person) == ("left", "Ada")
    np.testing.assert_allclose(read.lengths, measured.lengths, atol=1e-6)
    np.testing.assert_allclose(read.bases, measured.bases, atol=1e-6)
    np.testing.assert_allclose(read.lengths_sd, measured.lengths_sd, atol=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == ["hand.json"]
    assert decode_hand_shape(encode_hand_shape(shape)).lengths_sd is None


def test_a_file_that_is_no_hand_says_what_and_where(tmp_path: Path) -> None:
    good = json.loads(encode_hand_shape(hand_model().shape("left")))
    wrong = {
        "version": (good | {"version": 2}, "field version: 2.*reads version 1"),
        "side": (good | {"handedness": "both"}, "is no hand"),
        "extra": (good | {"more": 1}, "is no hand"),
        "digit": (good | {"lengths_m": {"thumb": [0.1, 0.1, 0.1]}}, "lengths_m.index"),
        "sd": (good | {"lengths_sd_m": {name: [0.001, -0.001, 0.001] for name in good["lengths_m"]}}, "lengths_sd is"),
        "size": (good | {"lengths_m": good["lengths_m"] | {"ring": [0.1, -0.1, 0.1]}}, "lengths is"),
    }
    for name, (data, message) in wrong.items():
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(InputError, match=message) as caught:
            load_hand_shape(path)
        assert str(path) in str(caught.value)
    with pytest.raises(InputError, match="measure the hand first"):
        load_hand_shape(tmp_path / "absent.json")
    with pytest.raises(InputError, match="choose another folder"):
        save_hand_shape(tmp_path / "absent" / "hand.json", hand_model().shape("left"))


@given(anything)
def test_a_stretched_hand_bends_backwards_and_spreads_so_far(angles: np.ndarray) -> None:
    model = hand_model("full").stretched(25.0, 28.0)
    limited = model.limited(angles)
    assert model.within(limited)
    for k, row in enumerate(DIGIT_ANGLES[1:]):
        assert np.degrees(model.limits[row[0]]).round(9).tolist() == [-25, 90], k
        assert np.degrees(model.limits[row[1]]).round(9).tolist() == [-28, 28]
    thumb, usual = model.limits[DIGIT_ANGLES[0]], hand_model("full").limits[DIGIT_ANGLES[0]]
    np.testing.assert_allclose(thumb[:2], 1.5 * usual[:2], atol=1e-12)
    np.testing.assert_array_equal(thumb[2:], usual[2:])


@pytest.mark.parametrize(("extension", "abduction"), [(-1, 20), (46, 20), (20, 4), (20, 41)])
def test_a_hand_is_not_stretched_farther_than_one_can(extension: float, abduction: float) -> None:
    with pytest.raises(SettingsError, match=r"extension_deg|abduction_deg"):
        hand_model("full").stretched(extension, abduction)


@pytest.mark.parametrize(("name", "least"), [("lengths", 0.0), ("bases", -0.5)])
def test_bones_and_bases_are_strictly_between_their_limits(name: str, least: float) -> None:
    shape = hand_model().shape("right")

    def having(value: float) -> HandShape:
        arrays_of = {"lengths": shape.lengths.copy(), "bases": shape.bases.copy()}
        arrays_of[name][3, 1] = value
        return HandShape("right", **arrays_of)

    for limit, inside in ((least, np.inf), (0.5, -np.inf)):
        with pytest.raises(SettingsError, match=f"{name} is"):
            having(limit)
        within = np.nextafter(limit, inside)
        assert getattr(having(within), name)[3, 1] == within


def test_a_standard_deviation_of_a_bone_may_be_0_and_is_below_half_a_metre() -> None:
    shape = hand_model().shape("right")

    def having(sd: float) -> HandShape:
        return HandShape("right", shape.lengths, shape.bases, lengths_sd=np.full((5, 3), sd))

    for sd in (0.0, np.nextafter(0.5, 0)):
        assert having(sd).lengths_sd is not None
    for sd in (-np.nextafter(0, 1), 0.5, np.nan):
        with pytest.raises(SettingsError, match="lengths_sd is"):
            having(sd)


@pytest.mark.parametrize("apart", [0.01, 1.0, 4.0, 100.0])
def test_fingers_of_a_stretched_hand_may_be_so_many_times_as_far_apart(apart: float) -> None:
    usual = hand_model("full")
    assert usual.stretched(25.0, 28.0, apart).neighbours_deg == pytest.approx(np.multiply(apart, usual.neighbours_deg))


def test_a_stretched_hand_spreads_most_halfway_between_its_limits_of_flexion() -> None:
    model = hand_model("full").stretched(25.0, 28.0)
    for flexion, abduction, within in ((32.5, 27.9, True), (32.5, 28.1, False), (30.5, 28, False), (-25, 0, True)):
        angles = model.natural.copy()
        angles[DIGIT_ANGLES[1, :2]] = np.radians([flexion, abduction])
        assert bool(model.within(angles)) is within


@pytest.mark.parametrize(
    ("name", "least", "most"), [("extension_deg", 0.0, 45.0), ("abduction_deg", 5.0, 40.0), ("apart", None, 100.0)]
)
def test_limits_of_a_stretched_hand_may_be_reached_and_not_passed(name: str, least: float | None, most: float) -> None:
    usual, model = {"extension_deg": 20.0, "abduction_deg": 20.0, "apart": 1.0}, hand_model("full")
    for value in (most, least if least is not None else np.nextafter(0, 1)):
        model.stretched(**usual | {name: value})
    for value in (np.nextafter(most, np.inf), np.nextafter(least, -np.inf) if least is not None else 0.0, np.nan):
        with pytest.raises(SettingsError, match=f"{name} is"):
            model.stretched(**usual | {name: value})
