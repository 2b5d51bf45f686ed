"""A rig from people is good only if its errors are probably small, and people contradict no given lens."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.keypoint_people import filmed, ring, walking

from mocapella.calibration.keypoint_tracks import collect_tracks
from mocapella.calibration.people_rig import POOR_DEG, POOR_MM, SURE, PlacedByPeople, RigFromPeople, place_rig
from mocapella.calibration.rig_from_people import RigFromPeopleSettings, solve_people


def placed(position_sd_mm: float, rotation_sd_deg: float) -> PlacedByPeople:
    return PlacedByPeople(1000, 3.0, position_sd_mm, rotation_sd_deg, 1.0, 2.0, 0.0)


def rig_of(one: PlacedByPeople, wrong_lenses: tuple[str, ...] = ()) -> RigFromPeople:
    return RigFromPeople(
        ring(2), {"cam1": one, "cam2": placed(5.0, 0.1)}, "stated", 0.01, guessed=False, floor_known=True,
        up_sd_deg=1.0, people=2, instants=300, stature_m=1.7, extent_m=1.0, notes=[], wrong_lenses=wrong_lenses,
    )  # fmt: skip


@given(st.floats(0.0, 200.0), st.floats(0.0, 5.0))
def test_good_is_a_limit_of_errors_and_not_of_standard_deviations(mm: float, deg: float) -> None:
    assert rig_of(placed(mm, deg)).good == (SURE * mm <= POOR_MM and SURE * deg <= POOR_DEG)


def test_the_limit_holds_for_95_percent_of_errors_of_any_shape() -> None:
    rng = np.random.default_rng(0)
    for shape in ((1.0, 1.0, 1.0), (1.0, 0.5, 0.2)):
        errors = rng.normal(size=(20000, 3)) * shape
        share = (np.linalg.norm(errors, axis=1) < SURE * np.linalg.norm(shape)).mean()
        assert 0.93 < share < 0.985


def test_a_contradicted_lens_is_not_good() -> None:
    assert rig_of(placed(5.0, 0.1)).good
    assert not rig_of(placed(5.0, 0.1), ("cam2",)).good


@pytest.mark.slow
def test_a_wrong_given_lens_is_named_with_the_likely_focal_length() -> None:
    true = ring(4, 0)
    frames = filmed(true, walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65]), 12.0, hz=15)
    given_lenses = {name: one.camera for name, one in true.cameras.items()}
    lens = true.cameras["cam3"].camera.lens.copy()
    lens[:2] *= 1.08
    wrong = {**given_lenses, "cam3": msgspec.structs.replace(given_lenses["cam3"], lens=lens)}
    settings = RigFromPeopleSettings(every_s=0.2)
    right, off = (place_rig(solve_people(collect_tracks(frames), of, settings)) for of in (given_lenses, wrong))
    assert right.wrong_lenses == ()
    assert "cam3" in off.wrong_lenses
    assert not off.good
    assert off.cameras["cam3"].position_sd_mm > 3 * right.cameras["cam3"].position_sd_mm
    (note,) = [note for note in off.notes if note.startswith("camera cam3: the people contradict its given lens")]
    likely = float(note.split("more likely ")[1].split()[0])
    assert likely == pytest.approx(true.cameras["cam3"].camera.lens[0], rel=0.03)
