"""What is known of views by their facing: tables, files, shapes, and how it is learnt."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.facing_bodies import ACROSS_X, KINECT, MIRROR

from mocapella.errors import InputError, SettingsError
from mocapella.fusion import facing_model
from mocapella.fusion.facing import FacingSettings
from mocapella.fusion.facing_grid import BIN, BINS, STEP_S, YAWS, most_likely, turned, turned_on
from mocapella.fusion.facing_model import (
    MOST_SCORE,
    SHAPE_BINS,
    SPEEDS,
    YAW_BINS,
    from_json,
    neighbours,
    read_model,
    shape_place,
    shipped_model,
    to_json,
    untrained,
)
from mocapella.fusion.facing_shape import (
    FADES_FROM,
    FADES_TO,
    FEATURES,
    MOST_SPREADS,
    UNLIKE_FROM,
    View,
    fit_classifier,
    view_of,
)
from mocapella.fusion.facing_training import FacingSequence, TrainingSettings, believed, posteriors, train
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import rotation_about_y

angles = st.floats(-np.pi, np.pi)
few = settings(max_examples=25, deadline=None)


def a_body(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(len(KINECT), 3)) * [0.2, 0.4, 0.2]


@given(st.integers(0, 999), angles, angles, st.floats(0.8, 1.2))
@few
def test_what_a_view_says_is_measured_from_the_sensor(seed: int, toward: float, angle: float, scale: float) -> None:
    body = a_body(seed)
    one = view_of(body, np.array(toward), KINECT)
    moved = scale * body @ rotation_about_y(angle).T + [3.0, -1.0, 2.0]
    other = view_of(moved, np.array(toward + angle), KINECT)
    assert wrap(other.reported - one.reported - angle) == pytest.approx(0, abs=1e-7)
    assert other.seen == pytest.approx(one.seen, abs=1e-7)
    both = np.isfinite(one.features) & np.isfinite(other.features)  # a trunk may have become too long for anybody's
    np.testing.assert_allclose(other.features[both], one.features[both], atol=1e-6)


@given(st.integers(0, 999), angles)
@few
def test_labels_and_sides_do_not_matter_to_the_shape(seed: int, toward: float) -> None:
    body = a_body(seed)
    one = view_of(body, np.array(toward), KINECT)
    swapped = view_of(body[MIRROR], np.array(toward), KINECT)
    assert swapped.seen == pytest.approx(one.seen, abs=1e-9)
    np.testing.assert_allclose(swapped.features, one.features, atol=1e-9)
    mirrored = view_of(body * ACROSS_X, np.array(-toward), KINECT)
    np.testing.assert_allclose(mirrored.features, one.features, atol=1e-9)
    assert mirrored.seen == pytest.approx(-one.seen, abs=1e-9)


def test_whoever_moves_mostly_faces_ahead_more_so_when_faster_but_may_walk_backwards() -> None:
    motion, away = untrained().motion, np.abs(wrap(YAWS))
    nearer = np.argsort(away)
    for row in motion:
        np.testing.assert_allclose(row, row[np.argmin(np.abs(wrap(YAWS[:, None] + YAWS)), axis=0)], atol=1e-9)
        assert (np.diff(row[nearer]) <= 1e-12).all()
    behind = motion.max(axis=1) - motion.min(axis=1)
    assert (np.diff(behind) > 0).all()
    assert np.log(2) < behind[0]
    assert behind[-1] < np.log(50)  # else a few steps backwards would turn a person round


def test_a_missing_joint_takes_its_features_away_and_no_others() -> None:
    body = a_body(1)
    body[KINECT.index("Head")] = [0.0, 0.6, 0.0]
    body[KINECT.index("SpineBase")] = 0.0
    body[KINECT.index("FootLeft")] = np.nan
    features = view_of(body, np.array(0.0), KINECT).features
    assert [name for name, x in zip(FEATURES, features, strict=True) if np.isnan(x)] == ["feet before the ankles"]


@pytest.mark.parametrize("model", [shipped_model(), untrained()], ids=["shipped", "untrained"])
def test_tables_are_probabilities_and_their_own_mirror_images(model: Any) -> None:
    back = -np.arange(BINS) % BINS
    np.testing.assert_allclose(np.exp(model.yaw).sum(axis=1), 1, atol=0.02)
    np.testing.assert_allclose(model.yaw[back][:, -np.arange(model.yaw.shape[1])], model.yaw, atol=1e-9)
    np.testing.assert_allclose(model.motion[:, back], model.motion, atol=1e-9)
    ahead = np.cos(YAWS) > 0
    assert (np.exp(model.motion)[:, ahead].sum(axis=1) > 0.7).all()
    if model.shape is not None:
        np.testing.assert_allclose(np.exp(model.shape).sum(axis=1), 1, atol=0.02)
        np.testing.assert_allclose(model.shape[back], model.shape, atol=1e-9)


def test_the_shipped_model_is_small_and_says_what_it_was_trained_on() -> None:
    model = shipped_model()
    assert len(to_json(model)) < 10_000
    assert model.trained_on["participants"] == list(range(10))
    assert "KinectMultiTrack" in model.trained_on["recordings"]
    assert "mocapella lab train facing" in model.trained_on["command"]


def test_a_model_survives_its_file(tmp_path: Path) -> None:
    text = to_json(shipped_model())
    (tmp_path / "m.json").write_text(text, encoding="utf-8")
    assert to_json(read_model(tmp_path / "m.json")) == text


def test_without_a_file_the_shipped_model_is_the_untrained_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(facing_model, "files", lambda package: tmp_path)
    assert shipped_model.__wrapped__() is untrained()


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("features", ["knees"], "features are not those of this version"),
        ("yaw", [[0.0]], "a table has the wrong number of rows or columns"),
        ("weights", [0.0], "the wrong number of weights"),
        ("spread", [0.0] * len(FEATURES), "a spread that is none"),
        ("motion", "fast", "Expected `array`, got `str`"),
        ("extra", 1, "unknown field `extra`"),
    ],
)
def test_a_file_that_is_no_model_is_refused(field: str, value: Any, said: str) -> None:
    data = {**json.loads(to_json(shipped_model())), field: value}
    with pytest.raises(InputError, match=f"a.json: is no model of facing: .*{said}.*mocapella lab train facing"):
        from_json(json.dumps(data), "a.json")


def test_a_file_that_is_not_there_and_an_untrained_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        read_model(tmp_path / "none.json")
    with pytest.raises(ValueError, match="an untrained model is no file"):
        to_json(untrained())


def test_a_classifier_tells_apart_what_can_be_told_apart() -> None:
    rng = np.random.default_rng(0)
    faces = rng.random(400) < 0.3
    features = rng.normal(size=(400, len(FEATURES))) + np.where(faces[:, None], 3.0, 0.0) * (np.arange(10) == 3)
    classifier = fit_classifier(features, faces, 0.01)
    score, seen = classifier.score(features)
    assert ((score > 0) == faces).mean() > 0.9
    assert np.abs(classifier.weights[:20]).argmax() == 3
    assert (seen == 1).all()
    score, seen = classifier.score(np.full(len(FEATURES), np.nan))
    assert (float(score), float(seen)) == (classifier.weights[-1], 0.0)


@given(st.floats(-2 * MOST_SCORE, 2 * MOST_SCORE))
def test_scores_are_spread_evenly_over_the_bins_and_those_beyond_are_at_the_ends(score: float) -> None:
    bins = np.linspace(-MOST_SCORE, MOST_SCORE, SHAPE_BINS)
    np.testing.assert_allclose(shape_place(bins), np.arange(SHAPE_BINS), atol=1e-12)
    place = float(shape_place(np.array(score)))
    assert 0 <= place <= SHAPE_BINS - 1
    assert float(shape_place(np.array(-score))) == pytest.approx(SHAPE_BINS - 1 - place)
    if abs(score) >= MOST_SCORE:
        assert place == (SHAPE_BINS - 1 if score > 0 else 0)


@given(st.integers(1, 40), st.floats(-3, 45))
def test_between_bins_that_do_not_wrap_lines_stay_lines_and_beyond_the_ends_is_the_end(
    count: int, place: float
) -> None:
    first, second, part = neighbours(np.array(place), count, wraps=False)
    line = np.arange(count, dtype=np.float64)
    assert (1 - part) * line[first] + part * line[second] == pytest.approx(np.clip(place, 0, count - 1))


@pytest.mark.parametrize("part", [0.0, 0.25, 0.5, 1.0])
def test_a_yaw_between_two_bins_says_what_lies_between_what_they_say(part: float) -> None:
    table = shipped_model().yaw
    for j in range(YAW_BINS):
        said = shipped_model().yaw_evidence(np.array((j + part - YAW_BINS / 2) * BIN))
        after = table[:, (j + 1) % YAW_BINS]  # half a turn further the labels are the same, only swapped
        np.testing.assert_allclose(said, table[:, j] + part * (after - table[:, j]), atol=1e-9)


@pytest.mark.parametrize("part", [0.0, 0.25, 0.5])
def test_a_shape_between_two_bins_says_what_lies_between_what_they_say(part: float) -> None:
    table = np.random.default_rng(0).normal(size=(BINS, SHAPE_BINS))
    known = np.arange(SHAPE_BINS - 1)
    scores = (2 * (known + part) / (SHAPE_BINS - 1) - 1) * MOST_SCORE
    scored = SimpleNamespace(score=lambda _: (scores, np.full(len(scores), 0.5)))
    said = msgspec.structs.replace(untrained(), shape=table, classifier=scored).shape_evidence(scores)
    expected = 0.5 * (table[:, :-1] + part * np.diff(table, axis=1))  # half of the features are seen
    np.testing.assert_allclose(said, expected.T, atol=1e-9)


def test_what_is_not_seen_says_nothing() -> None:
    model = shipped_model()
    assert (model.yaw_evidence(np.array(np.nan)) == 0).all()
    assert (model.motion_evidence(np.full(3, np.nan)) == 0).all()
    assert untrained().shape_evidence(np.zeros(len(FEATURES))) is None


@given(st.integers(0, BINS - 1))
def test_a_motion_says_what_the_row_of_its_speed_says_turned_to_its_heading(heading: int) -> None:
    """From the row's speed on, whatever the vertical speed; below the first it says nothing."""
    model, yaw = shipped_model(), heading * BIN
    ahead = np.array([np.sin(yaw), 0.0, np.cos(yaw)])
    for row, speed in enumerate(SPEEDS):
        for faster in (1.001, 1.3):
            said = model.motion_evidence(faster * speed * ahead + [0.0, 2.0, 0.0])
            np.testing.assert_allclose(said, np.roll(model.motion[row], heading), atol=1e-9)
    assert (model.motion_evidence(0.999 * SPEEDS[0] * ahead) == 0).all()


@given(
    arrays(np.float64, (3, BINS), elements=st.floats(0.1, 1)),
    arrays(np.float64, (3, BINS), elements=st.floats(-5, 5)),
    st.floats(-2000, 2000),
)
@few
def test_belief_follows_bayes_whatever_is_added_to_all_likelihoods(p: Any, likelihoods: Any, added: float) -> None:
    after = believed(p, likelihoods + added)
    np.testing.assert_allclose(after.sum(axis=-1), 1)
    odds = after[:, 1:] / after[:, :-1] / (p[:, 1:] / p[:, :-1])
    np.testing.assert_allclose(np.log(odds), np.diff(likelihoods), atol=1e-6)


def shown(views: int, velocity: Any, frames: int = 1, step_s: float = STEP_S) -> FacingSequence:
    """Somebody at a constant velocity, whom sensors see at different angles."""
    rng = np.random.default_rng(0)
    toward, seen = rng.uniform(-3, 3, (frames, views)), rng.uniform(-1.5, 1.5, (frames, views))
    view = View(toward + seen, seen, rng.normal(size=(frames, views, len(FEATURES))))
    unknown = np.full(frames, np.nan)
    return FacingSequence(step_s * np.arange(frames), view, toward, np.tile(velocity, (frames, 1)), unknown)


WALK = np.array([0.6, 0.0, 0.7])


@pytest.mark.parametrize(
    "weights", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.25), (0.3, 0.7, 0.4)]
)
@pytest.mark.parametrize("views", [1, 2])
def test_the_first_frame_adds_up_what_all_views_and_the_motion_say_by_their_weights(
    weights: tuple[float, float, float], views: int
) -> None:
    model, sequence = shipped_model(), shown(views, WALK)
    yaw, shape, motion = weights
    used = FacingSettings(yaw_weight=yaw, shape_weight=shape, motion_weight=motion)
    said = motion * model.motion_evidence(WALK)
    for k in range(views):
        toward, features = sequence.toward_sensor[0, k], sequence.view.features[0, k]
        of_shape = model.shape_evidence(features)
        assert of_shape is not None
        said = said + turned(yaw * model.yaw_evidence(sequence.view.seen[0, k]) + shape * of_shape, toward)
    (p,) = posteriors([sequence], model, used)
    np.testing.assert_allclose(np.diff(np.log(p[0])), np.diff(said), atol=1e-6)


def test_a_frame_in_which_nobody_is_seen_says_nothing_of_motion_either() -> None:
    sequence = shown(1, WALK)
    sequence.view.reported[:] = np.nan
    (p,) = posteriors([sequence], shipped_model(), FacingSettings())
    np.testing.assert_allclose(p, 1 / BINS)


@pytest.mark.parametrize(("steps", "counts"), [(0.5, 0.5), (1.0, 1.0), (2.0, 1.0)])
def test_a_frame_counts_by_the_time_since_the_last_and_no_more_than_once(steps: float, counts: float) -> None:
    """So many frames of one moment are no more certain than a few."""
    model = shipped_model()
    used = FacingSettings(yaw_weight=0.0, shape_weight=0.0, motion_weight=0.5)
    (p,) = posteriors([shown(1, WALK, 2, steps * STEP_S)], model, used)
    gained = np.log(p[1]) - np.log(turned_on(p[0], steps))
    np.testing.assert_allclose(np.diff(gained), counts * 0.5 * np.diff(model.motion_evidence(WALK)), atol=1e-6)


def sequences(seed: int, people: int = 3, known: bool = True) -> list[FacingSequence]:
    """People who turn before two sensors that report half of their angle and fold it; shapes say back or front."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(people):
        n = 400
        at_s = np.arange(n) / 29
        yaw = np.where(at_s < 5, 0.0, 1.5 * (at_s - 5))
        toward = np.tile([0.0, 0.8], (n, 1))
        alpha = wrap(yaw[:, None] - toward)
        folded = wrap(2 * alpha) / 4 + 0.05 * rng.normal(size=alpha.shape)
        features = rng.normal(size=(n, 2, len(FEATURES))) + np.cos(alpha)[..., None]
        view = View(toward + folded, folded, features)
        asked = np.where((at_s < 5) & known, 0.0, np.nan)
        found.append(FacingSequence(at_s, view, toward, np.full((n, 3), np.nan), asked))
    return found


def test_a_facing_that_nobody_wrote_down_is_learnt() -> None:
    model = train(sequences(0), KINECT.name)
    for sequence, p in zip(sequences(1), posteriors(sequences(1), model, FacingSettings()), strict=True):
        true = np.where(sequence.at_s < 5, 0.0, 1.5 * (sequence.at_s - 5))
        assert (np.abs(wrap(most_likely(p) - true)) < np.pi / 2)[30:].mean() > 0.98


def test_how_people_walk_is_learnt_of_each_speed_by_itself() -> None:
    """Somebody walks backwards as slowly as counts, and ahead fast; at the speed between them nobody walks."""
    slow, between, fast = SPEEDS
    turning = sequences(0)
    for sequence in turning:
        speed = np.where(np.arange(len(sequence.at_s)) % 2, -0.5 * (slow + between), 1.2 * fast)
        yaw = 1.5 * (sequence.at_s - 5)
        sequence.velocity[:] = (speed * np.stack([np.sin(yaw), 0 * yaw, np.cos(yaw)])).T
    p = np.exp(train(turning, KINECT.name).motion)
    p /= p.sum(axis=1, keepdims=True)
    ahead = np.abs(wrap(YAWS)) < np.radians(60)
    backwards = np.abs(wrap(YAWS)) > np.radians(120)
    assert p[0, backwards].sum() > 0.9
    np.testing.assert_allclose(p[1], 1 / BINS)
    assert p[2, ahead].sum() > 0.9


def test_learning_says_what_it_lacks() -> None:
    with pytest.raises(InputError, match="no facing is known"):
        train(sequences(0, people=1, known=False), KINECT.name)
    still = [
        FacingSequence(
            at_s=s.at_s[:140],
            view=View(s.view.reported[:140], s.view.seen[:140], s.view.features[:140]),
            toward_sensor=s.toward_sensor[:140],
            velocity=s.velocity[:140],
            known_yaw=s.known_yaw[:140],
        )
        for s in sequences(0, people=1)
    ]
    with pytest.raises(InputError, match="0 of a back; add recordings in which people turn all the way round"):
        train(still, KINECT.name)
    for name, value in (("sure", 0.3), ("penalty", 0.0), ("yaw_floor", 0.0), ("front_deg", 130.0), ("yaw_rounds", 0)):
        with pytest.raises(SettingsError, match=name):
            TrainingSettings(**{name: value})


def facing(yaw: float, frames: int) -> FacingSequence:
    """Somebody who was asked to face a yaw, before a sensor at the yaw 0 that takes a back for a front."""
    features = np.random.default_rng(frames).normal(size=(frames, 1, len(FEATURES))) + np.cos(yaw)
    zeros = np.zeros((frames, 1))
    unknown = np.full((frames, 3), np.nan)
    return FacingSequence(np.arange(frames) / 29, View(zeros, zeros, features), zeros, unknown, np.full(frames, yaw))


@pytest.mark.parametrize(("fronts_lacking", "backs_lacking"), [(0, 0), (0, 1), (1, 0)])
def test_the_shape_is_learnt_from_at_least_as_many_fronts_and_backs_as_it_has_weights(
    fronts_lacking: int, backs_lacking: int
) -> None:
    weights = 2 * len(FEATURES) + 1  # of each feature, of its being seen, and a constant
    fronts, backs = weights - fronts_lacking, weights - backs_lacking
    asked = [facing(0.0, fronts), facing(np.pi, backs)]
    if fronts_lacking or backs_lacking:
        with pytest.raises(InputError, match=f"{fronts} views are surely of a front and {backs} of a back"):
            train(asked, KINECT.name)
    else:
        classifier = train(asked, KINECT.name).classifier
        assert classifier is not None
        assert classifier.weights.shape == (weights,)


@pytest.mark.parametrize("far", [-1.0, 1.0])
def test_features_of_a_body_unlike_the_training_data_are_as_if_they_were_not_seen(far: float) -> None:
    classifier = shipped_model().classifier
    assert classifier is not None
    z = np.linspace(-1, 1, len(FEATURES))
    for k in range(len(FEATURES) - 3):
        odd = slice(k, k + 4)
        beyond, fading, missing = z.copy(), z.copy(), z.copy()
        beyond[odd], fading[odd], missing[odd] = 9.0 * far, 9.0 * far, np.nan
        fading[k] = far * (FADES_FROM + FADES_TO) / 2
        scores = [classifier.score(classifier.mean + classifier.spread * each) for each in (beyond, fading, missing)]
        np.testing.assert_allclose(scores[0], scores[2])
        assert scores[1][1] == pytest.approx(scores[2][1] + 0.5 / len(FEATURES))


def test_one_odd_feature_makes_no_body_unlike_and_counts_as_the_limit() -> None:
    classifier = shipped_model().classifier
    assert classifier is not None
    for k in range(len(FEATURES)):
        far, limit = np.zeros(len(FEATURES)), np.zeros(len(FEATURES))
        far[k], limit[k] = 0.99 * np.sqrt(UNLIKE_FROM * len(FEATURES)), MOST_SPREADS
        scores = [classifier.score(classifier.mean + classifier.spread * each) for each in (far, limit)]
        np.testing.assert_allclose(scores[0], scores[1])
