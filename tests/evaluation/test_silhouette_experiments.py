"""Rendered runs of the silhouettes' tracker: what is given to it, and the experiments as commands, on little."""

from __future__ import annotations

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.silhouette_pictures import pose_at, somebody
from typer.testing import CliRunner

from mocapella.cli import evaluate_silhouettes  # noqa: F401  (it registers)
from mocapella.cli.app import app
from mocapella.errors import SettingsError
from mocapella.evaluation import silhouette_experiments as experiments
from mocapella.evaluation.silhouette_runs import (
    BODIES,
    ROUGH_M,
    Film,
    filmed,
    follow,
    overlaps,
    rough_joints,
    with_penalty,
)
from mocapella.evaluation.silhouettes import Movement, score
from mocapella.model.twist_tree import TreePose, motions
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import silhouette_scene
from mocapella.tracker.silhouette_body import SilhouetteBody
from mocapella.tracker.silhouette_settings import SilhouetteSettings, Steadiness
from mocapella.tracker.surface_prior import SurfacePrior

SMALL = {"seed": 3, "cameras": 3, "size_px": (160, 120)}


@pytest.fixture(scope="module")
def film() -> Film:
    return filmed(silhouette_scene("runner", **SMALL), 0.1)


def test_a_film_is_the_scene_and_its_truth(film: Film) -> None:
    scene = film.scene
    assert len(film.images) == len(film.truth) == 6
    assert film.truth.fps == pytest.approx(60)
    np.testing.assert_array_equal(film.truth.poses.angles[4], scene.pose(4).angles)
    np.testing.assert_array_equal(film.images[4]["camera2"], scene.image(4, 1))
    np.testing.assert_allclose(np.stack(list(film.truth.landmarks.values()), axis=1)[4], scene.landmarks(4))


def test_it_is_shown_as_a_corrupted_scene_would_be_and_stays_as_it_is(film: Film) -> None:
    corruption = Corruption(0.2, rectangles=2, seed=5)
    before = film.images[2]["camera3"].copy()
    shown = film.shown(2, corruption)["camera3"]
    np.testing.assert_array_equal(shown, silhouette_scene("runner", **SMALL, corruption=corruption).image(2, 2))
    assert (shown != before).any()
    np.testing.assert_array_equal(film.images[2]["camera3"], before)
    assert film.shown(2) is film.images[2]


def test_a_film_of_what_is_corrupted_or_too_short_is_refused(film: Film) -> None:
    with pytest.raises(SettingsError, match="it is given with each run"):
        filmed(silhouette_scene("runner", **SMALL, corruption=Corruption(0.1)))
    with pytest.raises(SettingsError, match="3 frames or more"):
        filmed(film.scene, 0.04)


def test_rough_joints_are_off_by_so_much_and_by_the_seed() -> None:
    scene = silhouette_scene("t-pose", **SMALL)
    off = np.array(list(rough_joints(scene).values())) - scene.landmarks(0)
    assert 0.7 * ROUGH_M < off.std() < 1.3 * ROUGH_M
    np.testing.assert_array_equal(off + scene.landmarks(0), np.array(list(rough_joints(scene).values())))
    np.testing.assert_allclose(np.array(list(rough_joints(scene, 0.0).values())), scene.landmarks(0))


def test_bodies_are_the_subject_and_one_of_measured_proportions() -> None:
    scene = silhouette_scene("t-pose", **SMALL)
    exact = rough_joints(scene, 0.0)
    assert BODIES["own"](scene, exact) is scene.mesh
    measured = BODIES["measured"](scene, exact)
    assert measured.name == scene.mesh.name
    thighs = [
        np.linalg.norm(mesh.landmarks["left hip"].point - mesh.landmarks["left knee"].point)
        for mesh in (measured, scene.mesh)
    ]
    assert thighs[0] == pytest.approx(thighs[1], rel=1e-3)
    longer = {name: 1.1 * at for name, at in exact.items()}
    assert np.ptp(BODIES["measured"](scene, longer).vertices[:, 1]) > 1.05 * np.ptp(measured.vertices[:, 1])


def test_a_weight_times_a_cost_is_that_of_the_penalty() -> None:
    usual, fourfold = SilhouetteSettings().steadiness, with_penalty(4.0).steadiness
    assert usual is not None
    assert fourfold is not None
    one, four = usual.penalty(3600.0), fourfold.penalty(3600.0)
    for name in ("root_per_m", "root_per_rad", "angle_per_rad"):  # costs have their squares
        assert getattr(four, name) ** 2 == pytest.approx(4 * getattr(one, name) ** 2)
    body = SilhouetteBody(somebody())
    stands = body.standing(pose_at(body.mesh))
    weights = []
    for steadiness in (usual, fourfold):
        skin = SurfacePrior(body, steadiness)
        skin.expect(stands, 1 / 60, 3600.0)
        weights.append(skin.steady(stands, motions(body.mesh.tree, stands.pose)).weights)
    np.testing.assert_allclose(weights[1], 4.0 * weights[0])
    assert with_penalty(1.0) == SilhouetteSettings()
    assert with_penalty(0.0).steadiness is None
    assert with_penalty(1.0, replace(SilhouetteSettings(), rounds=5, steadiness=Steadiness(1, 2, 3))).rounds == 5
    with pytest.raises(SettingsError, match="weight"):
        with_penalty(-1.0)


def test_a_body_is_followed_and_timed(film: Film) -> None:
    ticks = itertools.count()
    done = follow(film, film.scene.mesh, rough_joints(film.scene), clock=lambda: float(next(ticks)))
    assert (done.seconds == 1).all()
    assert len(done.movement) == 6
    assert done.left_out == ()
    found = score(done.movement, film.truth)
    assert 0 < found.median_mm < 40
    iou = overlaps(film, done.movement, 3)
    assert iou.shape == (2, 3)
    assert (iou > 0.8).all()


def test_overlaps_are_1_of_the_truth_and_0_elsewhere(film: Film) -> None:
    assert overlaps(film, film.truth, 5).min() > 0.97
    T = film.truth.poses.T_world_model.copy()
    T[:, 0, 3] += 2.0
    aside = Movement(film.scene.mesh, TreePose(T, film.truth.poses.angles), film.truth.fps)
    assert overlaps(film, aside, 5).max() < 0.1


def test_frames_are_stored_wrong_where_the_plan_says() -> None:
    worse = experiments.corrupted(Corruption(0.1, wrong_frames=(20,)), 7)
    assert worse == Corruption(0.1, wrong_frames=(20,), seed=7)
    assert experiments.corrupted(None, 7) is None
    (strong,) = experiments.STRONG.images.values()
    assert strong is not None
    wrong = np.array([[strong.is_wrong(k, camera) for camera in range(4)] for k in range(500)])
    assert wrong.mean() == pytest.approx(experiments.WRONG_EACH, abs=0.03)
    assert not wrong[: experiments.WRONG_FROM].any()


def test_what_is_not_known_is_refused() -> None:
    with pytest.raises(SettingsError, match="did you mean runner"):
        experiments.run("runer", [1])
    with pytest.raises(SettingsError, match="no 'mine'; there are own, measured"):
        experiments.run("runner", [1], bodies=["mine"])
    with pytest.raises(SettingsError, match="seeds and bodies"):
        experiments.run("runner", [])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The experiments' scenes in small pictures, and three weights instead of many."""

    def scene(name: str, *, seed: int, **more: Any) -> Any:
        return silhouette_scene(name, **(more | SMALL | {"seed": seed}))

    monkeypatch.setattr(experiments, "silhouette_scene", scene)
    fewer = replace(experiments.EXPERIMENTS["weight"], weights=(0.0, 1.0, 10.0))
    monkeypatch.setitem(experiments.EXPERIMENTS, "weight", fewer)


@pytest.mark.slow
@pytest.mark.parametrize("name", experiments.EXPERIMENTS)
@pytest.mark.usefixtures("small")
def test_an_experiment_is_a_command(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    plan = experiments.EXPERIMENTS[name]
    line = ["lab", "evaluate", f"silhouettes-{name}", "--seeds", "5", "--bodies", "own", "--seconds", "0.05"]
    files = ["--plot", str(tmp_path / "plot.svg"), "--json", str(tmp_path / "rows.json")]
    done = CliRunner().invoke(app, [*line, *files], env={"COLUMNS": "80"})
    assert done.exit_code == 0, (done.output, done.exception)
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))["rows"]
    expected = [(scene, images, weight) for scene in plan.scenes for images in plan.images for weight in plan.weights]
    assert [(row["scene"], row["images"], row["weight"]) for row in rows] == expected
    assert {(row["seed"], row["body"], row["score"]["frames"]) for row in rows} == {(5, "own", 3)}
    assert all(np.isfinite(row["score"]["angle_deg"]) and row["overlap"] > 0.5 for row in rows)
    by_weight = {row["weight"]: row["score"]["jitter"] for row in rows if row["scene"] == plan.scenes[-1]}
    assert len(set(by_weight.values())) == len(plan.weights)  # a weight makes a difference
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert all(f"{scene} 5" in done.output for scene in plan.scenes)
    assert "none" in done.output
    assert all(row["outcome"]["problem"] in " ".join(done.output.split()) for row in rows)
    assert "…" not in done.output  # nothing is cut off at 80 columns
    # Within 0.05 s the runner alone bends the knees.
    assert all((row["lag"] is None) == (row["kept"] is None) == (row["scene"] != "runner") for row in rows)
    assert ("–" in done.output) == (name != "runner")


def test_the_images_beside_a_plot_are_of_the_dotted_lines_time(monkeypatch: pytest.MonkeyPatch, film: Film) -> None:
    pytest.importorskip("matplotlib")
    drawn: list[Any] = []
    monkeypatch.setattr(experiments, "save_figure", lambda figure, path: drawn.append(figure))
    shown = experiments.PlottedScene(film, Corruption(0.1, wrong_frames=(4,)), {1.0: film.truth})
    experiments.plot_movements([shown], ["left knee"], Path("plot.svg"))
    axes = drawn[0].axes
    dotted = {line.get_xdata()[0] for one in axes for line in one.lines if line.get_linestyle() == ":"}
    assert dotted == {4 / film.truth.fps}
    titles = [one.get_title() for one in axes if one.images]
    assert titles == [f"{name} at 0.07 s (dotted)" for name in ("camera1", "camera2")]


def test_a_plot_that_cannot_be_is_refused_in_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, film: Film) -> None:
    shown = [experiments.PlottedScene(film, None, {1.0: film.truth})]
    with pytest.raises(SettingsError, match=r"name a \.png or \.svg"):
        experiments.plot_movements(shown, ["left knee"], tmp_path / "nowhere" / "plot.png")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(SettingsError, match="matplotlib is not installed: uv sync --extra plots"):
        experiments.plot_weights([], tmp_path / "plot.png")
