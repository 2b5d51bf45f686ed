"""Evaluations of the marker detection: laws of their figures, rows for all that was asked for, and what is refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from support.marker_images import profile, scene, shot

from mocapella.cli import evaluate_markers as commands
from mocapella.errors import EvaluationError, SettingsError
from mocapella.evaluation import marker_films as films
from mocapella.evaluation import marker_jitter as jitter
from mocapella.evaluation import marker_kind_scores as kinds
from mocapella.evaluation import marker_thresholds as thresholds
from mocapella.evaluation import marker_windows as windows
from mocapella.sources.simulate.marker_kinds import MARKER_KINDS
from mocapella.sources.simulate.marker_scene import MIXED, MarkerScene, MarkerSceneSettings, marker_scene_settings


def small(name: str) -> MarkerSceneSettings:
    settings = marker_scene_settings(name)
    travel = (60.0, 25.0) if settings.sway_hz else (0.0, 0.0)
    return replace(settings, size_px=(320, 240), palm_px=60.0, travel_px=travel)


@pytest.fixture
def small_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (kinds, thresholds, jitter):
        monkeypatch.setattr(module, "marker_scene_settings", small)
    monkeypatch.setattr(windows, "load_marker_scene", lambda name, *, seed: MarkerScene(small(name), seed))
    monkeypatch.setattr(jitter, "PALM_PX_M", 30.0)


def clock() -> Callable[[], float]:
    ticks = itertools.count()
    return lambda: float(next(ticks))


def test_a_score_counts_what_is_found_missed_and_false() -> None:
    seen = replace(shot(0.0), visible=np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.5]))
    found = seen.centres_px.copy()
    found[0] += (0.3, 0.4)
    found[1, 0] += 2 * seen.radii_px[1]  # elsewhere
    found[2] = np.nan  # missed
    score = films.MarkerScore()
    score.add(seen, found, np.full(6, 0.5))  # the fourth is right, the fifth is not there, the sixth counts neither way
    assert (score.seen, score.found, score.false, score.total) == (4, 2, 2, 6)
    assert (score.found_share, score.false_share) == (0.5, 2 / 6)
    np.testing.assert_allclose(sorted(score.errors), [0.0, 0.5], atol=1e-12)
    assert score.normalised == pytest.approx(0.5)
    assert score.error_px(50) == pytest.approx(0.25)
    twice = films.MarkerScore()
    twice.join(score)
    twice.join(score)
    assert (twice.seen, twice.found_share, twice.error_px(100)) == (8, 0.5, pytest.approx(0.5))
    assert films.MarkerScore().error_px(50) is None


def test_a_film_is_learnt_once_all_markers_are_seen() -> None:
    film = films.learnt_film(scene())
    assert film.profile.names == scene().names
    assert [made.at_s for made in film.shots(2, 10.0)] == pytest.approx([film.begin_s + 1.0, film.begin_s + 1.1])


def test_a_scene_that_cannot_be_learnt_is_refused() -> None:
    grey = tuple(replace(paint, albedo=(0.2, 0.2, 0.2)) for paint in scene().settings.paints)
    with pytest.raises(EvaluationError, match=r"seed 7: .*hardly any colour.*; take another seed"):
        films.learnt_film(scene("still", paints=grey))


def test_at_rest_the_deviations_are_those_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    found = rng.uniform(0, 100, (1, 5, 2)) + rng.normal(0, 0.1, (400, 5, 2))
    right = np.ones((400, 5), np.bool_)
    assert kinds.root_mean_square(kinds.deviations(found, right)) == pytest.approx(0.1, rel=0.05)
    found[::3, 0], right[::3, 0] = 1e6, False  # a wrong one in a third of the images does not count
    found[::2, 1], right[::2, 1], right[1, 1] = 1e6, False, False  # nor a marker that is wrong in most
    off = kinds.deviations(found, right)
    assert len(off) == 2 * (3 * 400 + 266)
    assert kinds.root_mean_square(off) == pytest.approx(0.1, rel=0.05)
    assert kinds.root_mean_square(kinds.deviations(found, np.zeros((400, 5), np.bool_))) is None


def test_a_noisier_camera_jitters_more() -> None:
    def of(photons: float) -> float:
        made = scene("still", camera=replace(scene("still").settings.camera, photons=photons))
        value = kinds.root_mean_square(kinds.deviations(*kinds.tip_positions(list(made.repeats(0.0, 6)), profile())))
        assert value is not None
        return value

    assert of(1e6) < of(1500.0)


def test_a_wider_threshold_keeps_more_and_takes_more() -> None:
    image, truth = shot(0.4).image, thresholds.whole_surroundings(scene().labels(0.4))
    skin, marker = image[truth == -2], image[truth == 0]
    taken, kept = [], []
    for width in (0.5, *thresholds.WIDTHS_SD):
        taken.append((thresholds.labelled(profile(), thresholds.THRESHOLD, width, skin) > 0).mean())
        kept.append((thresholds.labelled(profile(), thresholds.THRESHOLD, width, marker) == 1).mean())
    assert taken == sorted(taken)
    assert kept[0] < kept[-1] == 1.0
    ratios = [
        (thresholds.labelled(profile(), thresholds.LIKELIHOOD, margin, marker) > 0).mean()
        for margin in thresholds.MARGINS
    ]
    assert ratios == sorted(ratios, reverse=True)


def test_pixels_beside_another_thing_are_mixed() -> None:
    labels = np.full((9, 9), -1, np.int8)
    labels[4, 4] = 3
    whole = thresholds.whole_surroundings(labels)
    assert (whole[2:7, 2:7] == MIXED).all()
    assert (whole == MIXED).sum() == 25
    assert (whole[:2] == -1).all()


@pytest.mark.slow
@pytest.mark.usefixtures("small_scenes")
def test_every_window_has_a_row_and_sees_the_same_images() -> None:
    rows = windows.compare_windows(["desk", "fast"], [0], [16.0, 40.0], clock(), frames=4)
    assert [(row.scene, row.window_px) for row in rows] == list(itertools.product(["desk", "fast"], [16.0, 40.0, None]))
    assert all(row.time_us == 1e6 and row.time_ratio == 1.0 for row in rows)
    assert [row.whole_percent for row in rows] == [25.0, 25.0, 100.0] * 2  # the first image, without a prediction
    assert all(row.found_percent == 100 and row.false_percent == 0 for row in rows)


@pytest.mark.slow
@pytest.mark.usefixtures("small_scenes")
def test_every_kind_has_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = kinds.compare_kinds(["desk"], [0], frames=3)
    assert [row.kind for row in rows] == list(MARKER_KINDS)
    assert all(row.error_px is not None and row.jitter_px is not None for row in rows if not row.refused)

    def refused(made: MarkerScene) -> Any:
        raise EvaluationError("no")

    monkeypatch.setattr(kinds, "learnt_film", refused)
    none = kinds.compare_kinds(["desk"], [0, 1], frames=3)[0]
    assert (none.refused, none.found_percent, none.area_px, none.error_px, none.jitter_px) == (2, 0.0, None, None, None)


@pytest.mark.slow
@pytest.mark.usefixtures("small_scenes")
def test_every_gloss_has_its_rows() -> None:
    rows = thresholds.compare_thresholds(["desk"], [0.0, 1.0], [0], instants=1)
    ways = len(thresholds.WIDTHS_SD) + len(thresholds.MARGINS)
    assert [row.skin_gloss for row in rows] == [0.0] * ways + [1.0] * ways
    for gloss in (0.0, 1.0):
        taken = [row.skin_percent for row in rows if row.skin_gloss == gloss and row.how == thresholds.THRESHOLD]
        assert taken == sorted(taken)
    assert all(row.skin_percent < 0.1 for row in rows if row.how == thresholds.LIKELIHOOD)


@pytest.mark.slow
@pytest.mark.usefixtures("small_scenes")
def test_every_light_and_distance_has_a_row() -> None:
    rows = jitter.measure_jitter([0.5, 1.0], [0], repeats=3)
    asked = list(itertools.product(jitter.LIGHTS, MARKER_KINDS, [0.5, 1.0]))
    assert [(row.light, row.kind, row.distance_m) for row in rows] == asked
    assert all((row.jitter_px is None) == (row.jitter_mm is None) for row in rows)
    painted = [row for row in rows if (row.kind, row.distance_m) == ("painted", 0.5)]
    assert [row.found_percent for row in painted[:2]] == [100.0, 100.0]
    assert painted[0].jitter_px < painted[1].jitter_px


def test_what_cannot_be_evaluated_is_refused() -> None:
    refused: list[tuple[str, Callable[[], Any]]] = [
        ("seeds", lambda: windows.compare_windows(None, [], [40.0], clock())),
        ("frames", lambda: windows.compare_windows(None, [0], [40.0], clock(), frames=0)),
        ("sizes", lambda: windows.compare_windows(None, [0], [], clock())),
        ("window_px is 4.0", lambda: windows.compare_windows(None, [0], [4.0], clock())),
        ("rate", lambda: windows.compare_windows(None, [0], [40.0], clock(), rate_hz=float("nan"))),
        ("unknown scene 'dek'", lambda: windows.compare_windows(["dek"], [0], [40.0], clock())),
        ("seeds", lambda: kinds.compare_kinds(None, [])),
        ("frames", lambda: kinds.compare_kinds(None, [0], frames=0)),
        ("unknown scene", lambda: kinds.compare_kinds(["dek"], [0])),
        ("gloss", lambda: thresholds.compare_thresholds(None, [], [0])),
        ("gloss", lambda: thresholds.compare_thresholds(None, [-0.1], [0])),
        ("seeds", lambda: thresholds.compare_thresholds(None, [0.0], [])),
        ("instants", lambda: thresholds.compare_thresholds(None, [0.0], [0], instants=0)),
        ("distances", lambda: jitter.measure_jitter([], [0])),
        ("distances", lambda: jitter.measure_jitter([0.1], [0])),
        ("seeds", lambda: jitter.measure_jitter([0.5], [])),
        ("repeats", lambda: jitter.measure_jitter([0.5], [0], repeats=1)),
        (r"--sizes: 'x' is no number; write numbers as in", lambda: commands._numbers("40,x", "--sizes", ())),
    ]
    for what, call in refused:
        with pytest.raises(SettingsError, match=what):
            call()


KIND_ROW = kinds.MarkerKindRow("colourful", "grey-bordered", 0, None, 99.99, 0.25, 0.123, None, 0.025)
WINDOW_ROW = windows.WindowRow("colourful", 200.0, 1234.0, 1.25, 100.0, 99.99, 0.123, 1.234, 0.01)
NO_WINDOW_ROW = windows.WindowRow("colourful", None, 1234.0, 1.0, 100.0, 99.99, None, None, 0.01)
WIDE_ROW = thresholds.ThresholdRow("lamp", 0.25, "threshold", 3.25, 99.99, 100.0, 100.0)
RATIO_ROW = thresholds.ThresholdRow("lamp", 0.25, "likelihood", 3.0, 99.99, 0.001, 0.0)
JITTER_ROW = jitter.JitterRow("grey-bordered", "bright", 0.75, 99.5, 0.025, 0.04)
NO_JITTER_ROW = jitter.JitterRow("grey-bordered", "dark", 0.75, 0.0, None, None)


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        (commands._WINDOW, [WINDOW_ROW, NO_WINDOW_ROW]),
        (commands._KIND, [KIND_ROW]),
        (commands._THRESHOLD, [WIDE_ROW, RATIO_ROW]),
        (commands._JITTER, [JITTER_ROW, NO_JITTER_ROW]),
    ],
)
def test_the_tables_fit_a_terminal(columns: Any, rows: Any) -> None:
    out = Console(width=80)
    with out.capture() as text:
        commands.show_rows([*rows, rows[0]], columns, out)
    assert "…" not in text.get()
    assert len(text.get().splitlines()) >= len(rows) + 3


@pytest.mark.parametrize(
    ("draw", "rows"),
    [
        (windows.plot_windows, [WINDOW_ROW, NO_WINDOW_ROW]),
        (kinds.plot_kinds, [KIND_ROW]),
        (thresholds.plot_thresholds, [WIDE_ROW, RATIO_ROW]),
        (jitter.plot_jitter, [JITTER_ROW, NO_JITTER_ROW]),
    ],
)
def test_plots_are_written_or_the_file_is_named(draw: Any, rows: Any, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw(rows, tmp_path / "plot.svg")
    assert (tmp_path / "plot.svg").read_text().lstrip().startswith("<?xml")
    with pytest.raises(SettingsError, match=r"none/plot.svg: .*a folder that exists"):
        draw(rows, tmp_path / "none" / "plot.svg")
