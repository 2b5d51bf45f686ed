"""The experiments with silhouettes: which runs they make, and what they tell and draw of each."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation import silhouette_experiments as experiments
from mocapella.evaluation import silhouette_one_camera as one_camera
from mocapella.evaluation.silhouette_experiments import MOVES_DEG, PlottedScene, RunRow
from mocapella.evaluation.silhouette_one_camera import AWAY_M, _row, errors_m, freedoms, median_freedoms
from mocapella.evaluation.silhouette_runs import Film, filmed, with_penalty
from mocapella.evaluation.silhouettes import FEET, Movement, outcome, score
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.body_meshes import body_mesh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.twist_tree import TreePose
from mocapella.sources.simulate.corruption import Corruption
from mocapella.tracker.silhouette_settings import SilhouetteSettings, Steadiness

MESH = body_mesh("female", detail=0.8)
FRAMES, FPS = 12, 24.0
SIDES = ("left", "right")
LENS = np.array([100.0, 100.0, 79.5, 59.5, 0, 0, 0, 0, 0])
FALL = np.outer(0.5 * (np.arange(FRAMES) / FPS) ** 2, [0.0, -9.81, 0.0])
"""Places of who falls freely [m]."""
T_CAMERA_WORLD = rigid(rotation_about_y(0.6), [0.3, 0.2, 4.0])


def rig(cameras: int = 2) -> CameraRig:
    placed = PlacedCamera(Camera("x", (160, 120), LENS), T_CAMERA_WORLD, np.zeros((6, 6)))
    return CameraRig({f"camera{k + 1}": placed for k in range(cameras)})


def movement(places: Any = 0.0, mesh: Any = MESH, **degrees: Any) -> Movement:
    """Somebody at given places (frames, 3) with given angles."""
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    T[:, :3, 3] = places
    poses = TreePose(T, np.zeros((FRAMES, len(mesh.joint_names))))
    for name, value in degrees.items():
        poses.angles[:, mesh.joint_names.index(name.replace("_", " "))] = np.radians(value)
    return Movement(mesh, poses, FPS)


def film(true: Movement | None = None, name: str = "still", seed: int = 3) -> Film:
    images = [{f"camera{k + 1}": np.full((2, 2, 3), frame, np.uint8) for k in range(2)} for frame in range(FRAMES)]
    scene: Any = SimpleNamespace(name=name, seed=seed, rig=rig())
    return Film(scene, images, true or movement())


@cache
def perfect() -> RunRow:
    told = score(movement(), movement()), outcome(movement(), movement())
    return RunRow("walk", 0, "own", "clean", 1.0, *told, 1.0, 0, 0, None, None)


def run_row(
    scene: str = "walk", images: str = "clean", weight: float = 1.0, jitter: float = 0.0, seed: int = 0
) -> RunRow:
    told = msgspec.structs.replace(perfect().score, jitter=jitter, angle_deg=10 * jitter)
    return msgspec.structs.replace(perfect(), scene=scene, images=images, weight=weight, score=told, seed=seed)


@pytest.mark.parametrize("name", ["acrobatics", "runner"])
def test_each_scene_seed_corruption_body_and_weight_is_run_and_the_first_of_each_scene_drawn(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, followed = experiments.EXPERIMENTS[name], []

    def follow(film: Any, body: str, images: str, corruption: Any, weight: float, *, settings: Any) -> Any:
        followed.append((*film, images, body, weight))
        assert corruption.seed == film[1]
        return followed[-1], followed[-1]

    monkeypatch.setattr(experiments, "silhouette_scene", lambda scene, *, seed, fps: (scene, seed))
    monkeypatch.setattr(experiments, "filmed", lambda scene, seconds: scene)
    monkeypatch.setattr(experiments, "followed", follow)
    rows, shown = experiments.run(name, [5, 4], bodies=["own", "measured"])
    wanted = [
        (scene, seed, images, body, weight)
        for scene in plan.scenes for seed in (5, 4) for images in plan.images
        for body in ("own", "measured") for weight in plan.weights
    ]  # fmt: skip
    assert rows == followed == wanted
    assert [one.film for one in shown] == [(scene, 5) for scene in plan.scenes]
    last = list(plan.images)[-1]
    for one in shown:
        assert one.found == {weight: (*one.film, last, "own", weight) for weight in plan.weights}


@pytest.mark.parametrize(("seeds", "bodies"), [([], ["own"]), ([1], [])])
def test_without_a_seed_or_a_body_there_is_nothing_to_run(seeds: list[int], bodies: list[str]) -> None:
    experiments.check_run([1], ["own"])
    with pytest.raises(SettingsError, match="seeds and bodies"):
        experiments.check_run(seeds, bodies)


@pytest.mark.parametrize(("bends_deg", "told"), [(0.9 * MOVES_DEG, False), (20.0, True)])
def test_lag_and_peak_are_told_of_knees_that_bend(
    bends_deg: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the mean of both knees: the true body bends the left one, and the tracked body the right one, as much."""
    wave = bends_deg * np.sin(np.arange(FRAMES) / 2) ** 2
    wave *= bends_deg / np.ptp(wave)
    true, found = movement(left_knee_flexion=2 * wave), movement(right_knee_flexion=2 * wave)
    done = SimpleNamespace(movement=found, left_out=(1, 2, 3), lost=(7,))
    monkeypatch.setattr(experiments, "rough_joints", lambda scene: {})
    monkeypatch.setitem(experiments.BODIES, "own", lambda scene, joints: MESH)
    monkeypatch.setattr(experiments, "follow", lambda *_, **__: done)
    monkeypatch.setattr(experiments, "overlaps", lambda *_: np.array([[0.5, 0.7]]))
    row, moved = experiments.followed(film(true), "own", "clean", None, 1.0)
    monkeypatch.setattr(
        experiments, "MOVES_DEG", np.ptp(np.mean([true.flexion_deg(f"{s} knee") for s in SIDES], axis=0))
    )
    assert experiments.followed(film(true), "own", "clean", None, 1.0)[0].kept is not None  # at the limit it is told
    assert moved is found
    assert (row.scene, row.seed, row.overlap, row.blind, row.lost) == ("still", 3, pytest.approx(0.6), 3, 1)
    assert (row.kept is not None, row.lag is not None) == (told, told)
    if told:
        assert (row.kept, row.lag) == pytest.approx((1.0, 0.0), abs=0.2)


def drawn(monkeypatch: pytest.MonkeyPatch, shown: Any, hinges: Any) -> Any:
    pytest.importorskip("matplotlib")
    saved: list[Any] = []
    monkeypatch.setattr(experiments, "save_figure", lambda figure, path: saved.append(figure))
    experiments.plot_movements(shown, hinges, Path("plot.svg"))
    return saved[0]


def test_angles_and_accelerations_are_drawn_over_seconds_and_wrong_frames_shaded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The images beside are of the frame with the most wrong ones; of those, of the one nearest to the middle."""
    true = movement(left_knee_flexion=30.0)
    found = {0.0: movement(FALL, left_knee_flexion=10.0), 1.0: movement(FALL, left_knee_flexion=20.0)}
    worse = Corruption(0.1, wrong_frames=(1, 4, 8))
    figure = drawn(monkeypatch, [PlottedScene(film(true), worse, found)], ["left knee"])
    knee, _, feet, _ = figure.axes
    lines = {line.get_label(): line for line in knee.lines}
    for label, degrees in (("without the penalty", 10), ("with the penalty", 20), ("truth", 30)):
        np.testing.assert_allclose(lines[label].get_xdata(), np.arange(FRAMES) / FPS)
        np.testing.assert_allclose(lines[label].get_ydata(), degrees, atol=1e-9)
    colours = {lines[label].get_color() for label in ("without the penalty", "with the penalty", "truth")}
    assert len(colours) == 3
    assert (lines["with the penalty"].get_color(), lines["truth"].get_color()) == (experiments._WITH, "black")
    long = [line for line in feet.lines if len(line.get_xdata()) == FRAMES - 2]
    np.testing.assert_allclose(long[0].get_xdata(), np.arange(1, FRAMES - 1) / FPS)
    np.testing.assert_allclose(long[0].get_ydata(), 9.81)
    spans = sorted(
        patch.get_extents().transformed(knee.transData.inverted()).intervalx.tolist() for patch in knee.patches
    )
    np.testing.assert_allclose(spans, [[(k - 0.5) / FPS, (k + 0.5) / FPS] for k in (1, 4, 8)], atol=1e-6)
    (dotted,) = {line.get_xdata()[0] for one in (knee, feet) for line in one.lines if line.get_linestyle() == ":"}
    assert dotted == 4 / FPS
    assert knee.get_xlim() == pytest.approx((0.0, (FRAMES - 1) / FPS))


def test_without_wrong_images_the_one_in_the_middle_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    falls = movement(FALL)
    figure = drawn(monkeypatch, [PlottedScene(film(falls), None, {1.0: falls})] * 2, ["left knee", "right elbow"])
    titles = [axes.get_title() for axes in figure.axes if axes.images]
    assert titles == [f"camera{k} at {FRAMES // 2 / FPS:.2f} s (dotted)" for k in (1, 2)] * 2
    assert not [patch for axes in figure.axes for patch in axes.patches]


def test_feet_that_are_pushed_accelerate_by_that() -> None:
    push = np.outer((np.arange(FRAMES) / FPS) ** 2, [3.0, 0.0, 4.0])
    assert len(FEET) == 4
    np.testing.assert_allclose(experiments._feet(movement(push)), 2 * 5.0)


def test_the_share_of_wrong_images_is_of_the_cameras() -> None:
    wrong = experiments._wrong_share(PlottedScene(film(), Corruption(0.1, wrong_frames=(2,)), {}))
    np.testing.assert_array_equal(wrong, np.arange(FRAMES) == 2)
    assert not experiments._wrong_share(PlottedScene(film(), None, {})).any()


def test_error_and_jitter_are_drawn_over_the_weights_for_each_scene_and_corruption(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Means over the seeds; the usual weight is marked."""
    pytest.importorskip("matplotlib")
    saved: list[Any] = []
    monkeypatch.setattr(experiments, "save_figure", lambda figure, path: saved.append(figure))
    kinds = [("runner", "clean", 100.0), ("runner", "noise", 200.0), ("walk", "clean", 300.0), ("walk", "noise", 400.0)]
    rows = [
        run_row(scene, images, weight, base + 10 * weight + seed, seed)
        for scene, images, base in kinds for weight in (0.0, 1.0, 3.0) for seed in (1, 2)
    ]  # fmt: skip
    experiments.plot_weights(rows, Path("plot.svg"))
    error, jitter = saved[0].axes
    for axes, factor in ((error, 10), (jitter, 1)):
        lines = {line.get_label(): line.get_ydata() for line in axes.lines if len(line.get_xdata()) == 3}
        assert set(lines) == {f"{scene}, {images}" for scene, images, _ in kinds}
        for scene, images, base in kinds:
            wanted = factor * (base + 10 * np.array([0.0, 1.0, 3.0]) + 1.5)
            np.testing.assert_allclose(lines[f"{scene}, {images}"], wanted)
        (usual,) = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
        assert usual == 1
    experiments.plot_weights([row for row in rows if row.weight != 1.0], Path("plot.svg"))
    (usual,) = [line.get_xdata()[0] for line in saved[1].axes[0].lines[4:]]
    assert usual == 0


class Drawn:
    """A scene whose pictures are numbers; it begins at 5 s."""

    corruption, mesh, rig = None, MESH, rig()
    times_s = 5.0 + np.arange(FRAMES) / FPS

    def __len__(self) -> int:
        return FRAMES

    def images(self, frame: int) -> list[int]:
        return [10 * frame, 10 * frame + 1]

    def poses(self) -> TreePose:
        return movement(FALL).poses


@pytest.mark.parametrize(("seconds", "frames"), [(None, FRAMES), (3 / FPS, 3), (5.2 / FPS, 5), (99.0, FRAMES)])
def test_a_film_is_of_the_whole_scene_or_of_its_first_seconds(seconds: float | None, frames: int) -> None:
    scene: Any = Drawn()
    made = filmed(scene, seconds)
    assert made.truth.fps == pytest.approx(FPS)
    assert (len(made.truth), len(made.images)) == (frames, frames)
    assert made.images[2] == {"camera1": 20, "camera2": 21}
    with pytest.raises(SettingsError, match=r"3 frames or more, 0\.125 s"):
        filmed(scene, 2.9 / FPS)


def test_a_weight_is_times_the_penalty_that_is_set_or_else_the_usual_one() -> None:
    own = Steadiness(1, 2, 3)
    assert with_penalty(4.0, SilhouetteSettings(steadiness=own)).steadiness == own.times(4.0) != Steadiness().times(4.0)
    assert with_penalty(4.0, SilhouetteSettings(steadiness=None)).steadiness == Steadiness().times(4.0)


# One camera


def test_errors_are_those_in_the_first_cameras_frame() -> None:
    """Of a body that is elsewhere; its landmarks that the true one lacks have none."""
    off = np.array([0.03, -0.02, 0.5])
    shift = apply(np.linalg.inv(T_CAMERA_WORLD), off[None])[0] - np.linalg.inv(T_CAMERA_WORLD)[:3, 3]
    found = errors_m(movement(shift), movement(), rig())
    assert found.shape == (FRAMES, len(MESH.landmarks), 3)
    np.testing.assert_allclose(found, np.broadcast_to(off, found.shape), atol=1e-9)


def test_figures_of_one_camera_are_along_its_axis_and_across_it() -> None:
    off = np.zeros((FRAMES, 4, 3))
    off[:, :, 2], off[:, :, 0], off[:, :, 1] = -0.2, 0.03, 0.04
    off[:, 3] *= 10
    off[-2:] *= 10
    row = _row(run_row(), off[:-2], FPS, (3.0, 2.0, 1.0))
    assert (row.depth_mm, row.across_mm) == pytest.approx((200.0, 50.0))
    assert (row.depth_p95_mm, row.across_p95_mm) == pytest.approx((2000.0, 500.0))
    assert (row.away, row.free, row.outlines, row.outlines_of_many) == (0.0, 3.0, 2.0, 1.0)
    at_the_limit = np.broadcast_to([0.0, 0.0, AWAY_M], off.shape)
    assert _row(run_row(), at_the_limit, FPS, (0.0, 0.0, 0.0)).away == 0.0
    assert (row.depth_jitter, row.across_jitter) == pytest.approx((0.0, 0.0), abs=1e-9)
    lost = _row(run_row(), off, FPS, (3.0, 2.0, 1.0))
    assert lost.away == pytest.approx(2 / FRAMES)
    assert AWAY_M == 0.5


def test_jitter_of_one_camera_is_an_acceleration() -> None:
    """Of errors that grow as of bodies that fall, by different amounts along the axis and across it."""
    off = np.zeros((FRAMES, 5, 3))
    off += 0.5 * ((np.arange(FRAMES) / FPS) ** 2)[:, None, None] * [3.0, 4.0, -2.0]
    row = _row(run_row(), off, FPS, (0.0, 0.0, 0.0))
    assert (row.depth_jitter, row.across_jitter) == pytest.approx((2.0, 5.0))


def test_uncertainties_are_medians_over_frames_from_the_first_to_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def freedoms_at(mesh: Any, pose: TreePose, *_: Any) -> np.ndarray:
        k = round(pose.T_world_model[0, 3])
        asked.append(k)
        return np.array([100.0 + k, float(k**2)])

    monkeypatch.setattr(one_camera, "freedoms", freedoms_at)
    places = np.outer(np.arange(FRAMES), [1.0, 0.0, 0.0])
    found = median_freedoms(movement(places), rig(), with_penalty(1.0))
    assert (asked[0], asked[-1], len(asked)) == (0, FRAMES - 1, one_camera.ASKED)
    assert asked == sorted(set(asked))
    np.testing.assert_allclose(found, [100 + np.median(asked), np.median(np.square(asked))])


@pytest.mark.parametrize(("weight", "terms"), [(0.0, 1), (1.0, 2)])
def test_the_uncertainty_of_a_direction_falls_with_the_root_of_what_holds_it(
    weight: float, terms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The resting pose and the penalty hold it, where no camera sees the body."""
    held: list[int] = []

    def equations(tree: Any, pose: Any, given: Any, priors: Any) -> Any:
        assert given == []
        held.append(len(priors))
        return SimpleNamespace(H=np.diag([4.0, 0.0, 25.0]))

    stands = SimpleNamespace(vertices=None)
    body = SimpleNamespace(figure=None, standing=lambda pose: stands)
    monkeypatch.setattr(one_camera, "SilhouetteBody", lambda mesh: body)
    monkeypatch.setattr(one_camera, "see", lambda *_, **__: None)
    monkeypatch.setattr(one_camera, "normal_equations", equations)
    monkeypatch.setattr(one_camera, "smoothness", lambda tree, pose, penalty: "penalty")
    pose = TreePose(np.eye(4), np.zeros(len(MESH.joint_names)))
    np.testing.assert_allclose(freedoms(MESH, pose, rig(), with_penalty(weight), FPS), [np.inf, 0.5, 0.2])
    assert held == [terms]


def test_each_body_is_followed_with_one_camera_with_the_penalty_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first body of the first seed is drawn; uncertainties are of outlines alone, and of what holds the body."""
    followed: list[Any] = []

    def scene(name: str, *, seed: int, fps: float, cameras: int) -> Any:
        return SimpleNamespace(name=name, seed=seed, rig=rig(cameras))

    def follow(film: Film, body: str, images: str, corruption: Any, weight: float, *, settings: Any) -> Any:
        followed.append((film.scene.name, film.scene.seed, body, weight))
        assert (images, corruption) == ("clean", None)
        return run_row(film.scene.name, images, weight, seed=film.scene.seed), movement()

    def sizes(true: Any, rig: CameraRig, settings: Any) -> np.ndarray:
        held = (settings.steadiness is not None) + 0.5 * (settings.usual_per_rad > 0)
        return np.array([10.0 / len(rig.cameras) - held, 0.0])

    monkeypatch.setattr(one_camera, "silhouette_scene", scene)
    monkeypatch.setattr(one_camera, "filmed", lambda scene, _: Film(scene, [], movement()))
    monkeypatch.setattr(one_camera, "followed", follow)
    monkeypatch.setattr(one_camera, "median_freedoms", sizes)
    rows, shown = one_camera.run_one_camera([7, 2], bodies=["own", "measured"])
    assert followed == [
        (name, seed, body, weight)
        for name in one_camera.SCENES for seed in (7, 2) for body in ("own", "measured") for weight in (0.0, 1.0)
    ]  # fmt: skip
    assert {(row.run.weight, row.free, row.outlines, row.outlines_of_many) for row in rows} == {
        (0.0, 9.5, 10.0, 2.5), (1.0, 8.5, 10.0, 2.5)
    }  # fmt: skip
    assert [(one.film.scene.name, one.film.scene.seed) for one in shown] == [(name, 7) for name in one_camera.SCENES]
    for one in shown:
        assert [float(size[0]) for size in one.freedoms.values()] == [2.5, 10.0, 9.5, 8.5]
        assert set(one.found) == {0.0, 1.0}
