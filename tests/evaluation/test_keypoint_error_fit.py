"""Errors of detectors, measured on simulated recordings with known errors, and on the real ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.evaluation.keypoint_clips import CLIPS, KeypointClip, mediapipe_clip, pose2sim_clip
from mocapella.evaluation.keypoint_error_fit import fit_errors, fit_recordings, match_clip
from mocapella.sources.simulate.crowd import CrowdPerson, CrowdScene, CrowdSettings, build_crowd
from mocapella.sources.simulate.keypoint_body import GROUPS
from mocapella.sources.simulate.keypoint_camera import KeypointCameraSettings
from mocapella.sources.simulate.keypoint_errors import (
    CONFIDENCE_BINS,
    ErrorTables,
    detector_errors,
    detectors_to_json,
    read_detectors,
)
from mocapella.sources.simulate.keypoint_faults import NO_FAULTS, KeypointFaults

DATA = Path(__file__).resolve().parents[3] / "shared/data"
needs_data = pytest.mark.skipif(
    not all((DATA / name).is_dir() for name in (*CLIPS, "mediapipe_holistic_4cam")), reason="no recordings"
)
ONE = (CrowdPerson((0.0, 0.0), "route", route=("go 0.8 0.3", "go 0 0", "turn 270", "stand 1")),)


def simulated(faults: KeypointFaults, seconds: float = 8.0) -> KeypointClip:
    scene: CrowdScene = build_crowd(
        CrowdSettings("fit", "one person", seconds, ONE, camera=KeypointCameraSettings(faults=faults), seed=5)
    )
    instants: dict[int, list] = {}
    for item in scene.frames():
        instants.setdefault(item.frame.sequence, []).append(item)
    frames = tuple(tuple(item.frame for item in row) for row in instants.values())
    truth = np.stack([row[0].positions for row in instants.values()], axis=1)
    return KeypointClip("simulated", scene.rig, frames, truth, 30.0)


@pytest.mark.slow
def test_the_fit_finds_the_errors_that_were_simulated() -> None:
    clip = simulated(dataclasses.replace(NO_FAULTS, noise=1.0))
    found = fit_errors({"simulated": match_clip(clip)}, "openpose")
    true = detector_errors("openpose")
    high = np.searchsorted(CONFIDENCE_BINS, 0.5)
    ratio = np.array(found.core)[:, high:] / true.core[:, high:]
    assert 0.85 < np.median(ratio) < 1.25
    hip = GROUPS.index("hip")
    assert abs(found.quantiles[0][hip][3] - true.quantiles[0, hip, 3]) < 0.05
    assert found.slow > 0.8
    assert 0.03 < found.slow_s < 0.15


@pytest.mark.slow
def test_swaps_are_counted_and_do_not_widen_the_errors() -> None:
    clean, swapped = (
        match_clip(simulated(dataclasses.replace(NO_FAULTS, noise=1.0, mirrored=(share,) * 3), 4.0))
        for share in (0.0, 0.2)
    )
    assert not clean.swapped.any()
    assert 0.08 < swapped.swapped.mean() < 0.35
    one, other = (fit_errors({"a": clip}, "openpose").core for clip in (clean, swapped))
    assert np.median(np.array(other) / np.array(one)) < 1.15


def test_an_exact_detector_has_no_errors() -> None:
    matched = match_clip(simulated(NO_FAULTS, 1.0))
    assert matched.matched.all()
    assert np.nanmax(np.abs(matched.residuals)) < 1e-4


def test_tables_survive_their_file() -> None:
    data = {"openpose": detector_errors("openpose").data}
    assert read_detectors(detectors_to_json(data).encode()) == data
    for damaged in (b"", b"[]", b'{"openpose": {}}', b'{"openpose": 3}'):
        with pytest.raises(InputError, match="keypoint-errors"):
            read_detectors(damaged, file="errors.json")


@needs_data
@pytest.mark.slow
def test_the_shipped_tables_are_those_of_the_real_recordings() -> None:
    found = fit_recordings(DATA)
    for name, tables in found.items():
        shipped = detector_errors(name)
        own = ErrorTables(tables)
        np.testing.assert_allclose(own.core, shipped.core, rtol=0.02, atol=1e-4)
        np.testing.assert_allclose(own.quantiles, shipped.quantiles, atol=0.02)
        np.testing.assert_allclose(own.missing, shipped.missing, atol=0.02)


@needs_data
@pytest.mark.slow
def test_the_real_clips_have_their_people_and_a_bystander() -> None:
    two, one = (pose2sim_clip(DATA, name) for name in CLIPS)
    assert len(two.reference) == 2
    assert len(one.reference) == 1
    assert len(one.frames) == 100
    assert np.mean([[len(frame.ids) for frame in row] for row in two.frames]) > 2.4
    matched = match_clip(two)
    assert matched.matched.mean() > 0.99
    assert matched.extra[2] > 100
    session = mediapipe_clip(DATA)
    assert len(session.frames) == 267


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Calib_qualisys"):
        pose2sim_clip(tmp_path, "pose2sim_two_people")
