"""What users are told of a calibrated rig, in the units that they are told it in."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mocapella.calibration.cameras import CameraCalibration, CameraReport
from mocapella.calibration.corner_quality import CornerQuality
from mocapella.calibration.rig_report import (
    NEARLY_PARALLEL_DEG,
    as_result,
    distance,
    pair_of,
    sentences,
    table,
    tape_measure,
)
from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.model.camera import Camera, CameraRig, PlacedCamera

LENS = np.array([530.0, 530.0, 319.5, 239.5, 0, 0, 0, 0, 0])
NAN = float("nan")
QUALITY = CornerQuality(40, 90, 1.25, 0.8, 0.1, 0.21, 0.3, 1.5)
REPORT = CameraReport(12, 1, 0.75, 0.31, 0.28, 1.5, 0.2, 0.6, ["cx"])


def calibration(*places: np.ndarray, **changed: object) -> CameraCalibration:
    """A rig of cameras at these ``T_world_camera``."""
    names = [f"c{k}" for k in range(len(places))]
    rig = CameraRig(
        {
            name: PlacedCamera(Camera(name, (640, 480), LENS), inverse(T), np.zeros((6, 6)))
            for name, T in zip(names, places, strict=True)
        }
    )
    values = {"left_out": None, "hints": [], **changed}
    return CameraCalibration(rig, dict.fromkeys(names, REPORT), 9, 8, 0.2, 1.1, QUALITY, **values)  # type: ignore[arg-type]


def at(x: float, turn_deg: float = 0.0, z: float = 2.0) -> np.ndarray:
    return np.asarray(rigid(rotation_about_y(np.radians(turn_deg)), [x, 1.0, z]))


def test_a_distance_is_between_the_cameras_whatever_they_look_at() -> None:
    found = calibration(at(1.0, 30.0), at(4.0, -70.0, 6.0), at(1.0, 5.0))
    assert distance(found, "c0", "c1") == distance(found, "c1", "c0") == pytest.approx(5.0)
    assert distance(found, "c0", "c2") == pytest.approx(0.0, abs=1e-12)
    assert "c0 – c1 5.000 m, c0 – c2 0.000 m, c1 – c2 5.000 m" in tape_measure(found)
    assert tape_measure(calibration(at(1.0))) == ""


def test_a_row_of_the_table_is_of_one_camera_and_fields_are_in_percent() -> None:
    rows = table(calibration(at(0.0), at(0.5)))
    assert rows == [
        ("c0", "12", "75", "0.28", "0.31", "1.50", "0.20", "0.60", "0.000"),
        ("c1", "12", "75", "0.28", "0.31", "1.50", "0.20", "0.60", "0.500"),
    ]


@pytest.mark.parametrize(("turn_deg", "is_pair"), [(0.0, True), (19.9, True), (20.1, False), (180.0, False)])
def test_two_cameras_are_a_pair_if_they_look_nearly_the_same_way(turn_deg: float, is_pair: bool) -> None:
    found = calibration(at(0.0), at(0.075, turn_deg))
    assert NEARLY_PARALLEL_DEG == 20.0
    pair = pair_of(found)
    assert (pair is not None) == is_pair
    said = [text for text in sentences(found) if text.startswith("pair: axes ")]
    assert bool(said) == is_pair
    if pair is not None:
        assert f"{turn_deg:.2f}° apart, baseline 75.0 mm" in said[0]
        assert (pair["first"], pair["second"]) == ("c0", "c1")
        assert (pair["advice"] == []) == (turn_deg == 0.0)
        assert sentences(found)[-len(pair["advice"]) :] == pair["advice"] or not pair["advice"]


def test_one_camera_or_three_are_no_pair() -> None:
    assert pair_of(calibration(at(0.0))) is None
    assert pair_of(calibration(at(0.0), at(0.1), at(0.2))) is None


def test_corners_are_told_of_where_there_are_any_and_halves_where_they_were_left_out() -> None:
    found = calibration(at(0.0), at(0.1), at(0.2), left_out=[QUALITY, replace(QUALITY, distance_rms_mm=2.5)])
    fit, halves = sentences(found)
    assert fit.startswith("40 corners of 8 instants triangulated one by one: distances within 1.25 mm")
    assert halves == "each half by the other: 1.25 and 2.50 mm (RMS; expected 1.50 and 1.50)"
    nothing = replace(found, fit=CornerQuality(0, 0, NAN, NAN, NAN, NAN, NAN, NAN), left_out=None)
    assert sentences(nothing) == []


def test_a_result_has_null_for_what_is_unknown_and_everything_else_as_it_is() -> None:
    fit = replace(QUALITY, predicted_rms_mm=NAN, scale_percent=math.inf)
    told = as_result(calibration(at(0.0), at(0.5), left_out=[replace(QUALITY, predicted_rms_mm=NAN)]))
    assert told["left_out"][0]["predicted_rms_mm"] is None
    assert told["left_out"][0]["distance_rms_mm"] == told["fit"]["distance_rms_mm"] == 1.25
    assert (told["instants"], told["shared_instants"], told["dispersion"]) == (9, 8, 1.1)
    assert told["cameras"]["c1"]["distance_to_first_m"] == pytest.approx(0.5)
    assert told["cameras"]["c1"]["views"] == 12
    assert told["pair"]["baseline_m"] == pytest.approx(0.5)
    assert as_result(calibration(at(0.0)))["left_out"] is None
    unknown = as_result(replace(calibration(at(0.0)), fit=fit))
    assert unknown["fit"]["scale_percent"] is unknown["fit"]["predicted_rms_mm"] is None
