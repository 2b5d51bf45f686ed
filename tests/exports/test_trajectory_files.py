"""Each file of trajectories holds the same positions, names, states and times, within its precision."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError, TakeExistsError
from mocapella.exports.arm_rows import STATES
from mocapella.exports.c3d_file import LARGEST_RESIDUAL_MM, MOST_POINTS, write_c3d
from mocapella.exports.needs import needed
from mocapella.exports.new_file import new_file
from mocapella.exports.trajectory_arrays import as_dataset, began, write_netcdf, write_npz
from mocapella.exports.trajectory_tables import COLUMNS, as_pandas, as_polars, write_csv, write_parquet, write_wide_csv
from mocapella.exports.trc_file import T_OPENSIM_WORLD, write_trc
from mocapella.model.trajectories import Trajectories
from mocapella.recording.c3d_file import read_c3d
from mocapella.recording.trc_file import read_trc

seeds = st.integers(0, 2**32 - 1)


def walk(seed: int = 0, frames: int = 12, people: int = 2, points: int = 4) -> Trajectories:
    """People who come and go, with unknown, inferred and measured keypoints, at 30 Hz."""
    rng = np.random.default_rng(seed)
    states = rng.integers(0, 3, (frames, people, points)).astype(np.uint8)
    states[rng.random((frames, people)) < 0.2] = 0
    positions = np.where(states[..., None] > 0, rng.normal(size=(*states.shape, 3)) * 3.0, np.nan)
    sd = np.where(states > 0, rng.uniform(0.001, 0.4, states.shape), np.nan).astype(np.float32)
    names = tuple(f"person_{i}" for i in range(people))
    return Trajectories(
        "people", np.arange(frames) / 30.0, np.repeat([0, 1], [frames // 2, frames - frames // 2]), names,
        tuple(f"joint {k}" for k in range(points)), positions, states, sd, ((0, 1),), rate_hz=30.0,
        began_unix_ns=1_700_000_000_123_456_789,
        labels={0: {"participant": 7, "placement": "right-90", "scenario": "walk"}, 1: {"participant": -9999}},
    )  # fmt: skip


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def check_long_rows(own: Trajectories, rows: list[dict[str, Any]]) -> None:
    """Compare a long table, read by another program, with the arrays."""
    expected = [
        (frame, i, k)
        for frame in range(len(own))
        for i in range(len(own.individuals))
        if own.present[frame, i]
        for k in range(len(own.keypoints))
    ]
    assert len(rows) == len(expected)
    for row, (frame, i, k) in zip(rows, expected, strict=True):
        run = int(own.runs[frame])
        assert (row["individual"], row["keypoint"]) == (own.individuals[i], own.keypoints[k])
        assert row["state"] == STATES[own.states[frame, i, k]]
        assert int(row["run"]) == run
        assert (row["participant"], row["placement"]) == (("7", "right-90") if run == 0 else ("", ""))
        assert float(row["time_s"]) == pytest.approx(own.times_s[frame], abs=1e-6)
        values = [row[name] for name in ("x_m", "y_m", "z_m", "sd_m")]
        numbers = [math.nan if value in {"", None} else float(value) for value in values]
        np.testing.assert_allclose(numbers, [*own.positions[frame, i, k], own.sd[frame, i, k]], atol=6e-6)


@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_the_long_tables_have_a_row_for_each_keypoint_of_those_who_are_there(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    own, folder = walk(seed), tmp_path_factory.mktemp("long")
    write_csv(own, folder / "a.csv")
    rows = rows_of(folder / "a.csv")
    check_long_rows(own, rows)
    if rows:
        assert tuple(rows[0]) == COLUMNS
    check_long_rows(own, as_polars(own).to_dicts())
    frame = as_pandas(own)
    check_long_rows(own, frame.to_dict("records"))
    write_parquet(own, folder / "a.parquet")
    check_long_rows(own, needed("polars").read_parquet(folder / "a.parquet").to_dicts())


def test_a_wide_table_has_a_row_for_each_frame(tmp_path: Path) -> None:
    own = walk()
    write_wide_csv(own, tmp_path / "a.csv")
    rows = rows_of(tmp_path / "a.csv")
    assert len(rows) == len(own)
    for frame, row in enumerate(rows):
        for i, person in enumerate(own.individuals):
            for k, joint in enumerate(own.keypoints):
                numbers = [float(row[f"{person}.{joint}.{axis}_m"] or "nan") for axis in "xyz"]
                np.testing.assert_allclose(numbers, own.positions[frame, i, k], atol=6e-6)
                assert row[f"{person}.{joint}.state"] == STATES[own.states[frame, i, k]]


def test_a_cell_is_no_formula(tmp_path: Path) -> None:
    """A spreadsheet runs cells that begin with =."""
    own = walk()
    bad = Trajectories(**{**vars(own), "individuals": ("=1+1", "b")})
    write_csv(bad, tmp_path / "a.csv")
    assert not any(row["individual"].startswith("=") for row in rows_of(tmp_path / "a.csv"))


def test_arrays_and_netcdf_are_exact(tmp_path: Path) -> None:
    own = walk()
    write_npz(own, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        for name in ("times_s", "runs", "positions", "states", "sd"):
            np.testing.assert_array_equal(arrays[name], getattr(own, name))
        assert arrays["keypoints"].tolist() == list(own.keypoints)
        assert int(arrays["began_unix_ns"]) == own.began_unix_ns
    write_netcdf(own, tmp_path / "a.nc")
    with needed("xarray").open_dataset(tmp_path / "a.nc", engine="scipy") as found:
        assert found.position.dims == ("time", "space", "keypoints", "individuals")
        np.testing.assert_array_equal(found.position.values, np.transpose(own.positions, (0, 3, 2, 1)))
        np.testing.assert_array_equal(found.confidence.values, np.moveaxis(own.states, 1, 2) / 2)
        assert found.individuals.values.tolist() == list(own.individuals)
        assert found.attrs["fps"] == 30.0
        assert found.attrs["began"] == "2023-11-14T22:13:20.123456+00:00"
    one = found.sel(individuals="person_1", keypoints="joint 2", space="z")
    assert one.position.shape == (len(own),)


def test_angles_are_in_the_data_set() -> None:
    own = walk(people=1)
    angles = np.random.default_rng(1).normal(size=(len(own), 1, 2))
    own = Trajectories(**{**vars(own), "angle_names": ("knee", "elbow"), "angles": angles})
    found = as_dataset(own)
    np.testing.assert_array_equal(found.angle.sel(angles="elbow", individuals="person_0").values, angles[:, 0, 1])
    assert began(Trajectories(**{**vars(own), "began_unix_ns": 0})) == ""


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_a_trc_that_is_written_is_read_again(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    own, path = walk(seed, people=1), tmp_path_factory.mktemp("trc") / "walk.trc"
    write_trc(own, path)
    found = read_trc(path)
    np.testing.assert_allclose(found.positions, own.positions, atol=1e-6)
    assert found.keypoints == own.keypoints
    assert found.rate_hz == 30.0
    assert path.read_text(encoding="utf-8").splitlines()[0].endswith("walk.trc")


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_a_c3d_that_is_written_is_read_again(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    own, path = walk(seed, people=1), tmp_path_factory.mktemp("c3d") / "walk.c3d"
    write_c3d(own, path)
    found = read_c3d(path)
    np.testing.assert_allclose(found.positions, own.positions, atol=1e-6)
    np.testing.assert_array_equal(found.states, own.states)
    assert found.keypoints == own.keypoints
    assert found.individuals == own.individuals
    assert found.rate_hz == 30.0
    fine = (own.states == 2) & (own.sd < 1e-3 * (LARGEST_RESIDUAL_MM - 1))
    np.testing.assert_allclose(found.sd[fine], own.sd[fine], atol=0.51e-3)
    assert np.isnan(found.sd[(own.states == 2) & (own.sd > 1e-3 * LARGEST_RESIDUAL_MM)]).all()


def test_a_c3d_has_more_frames_than_its_header_counts(tmp_path: Path) -> None:
    own = walk(frames=70_000, people=1, points=1)
    write_c3d(own, tmp_path / "long.c3d")
    assert len(read_c3d(tmp_path / "long.c3d")) == 70_000


def test_a_c3d_has_as_many_points_as_fit(tmp_path: Path) -> None:
    write_c3d(walk(people=1, points=MOST_POINTS), tmp_path / "a.c3d")
    assert len(read_c3d(tmp_path / "a.c3d").keypoints) == MOST_POINTS
    with pytest.raises(SettingsError, match=f"at most {MOST_POINTS} points, and these are {MOST_POINTS + 1}"):
        write_c3d(walk(people=1, points=MOST_POINTS + 1), tmp_path / "b.c3d")


def test_names_of_a_c3d_are_ascii_and_differ(tmp_path: Path) -> None:
    own = walk(people=1, points=4)
    names = ("Łäuft", "Łauft", "über\tall", "uber all")
    write_c3d(Trajectories(**{**vars(own), "keypoints": names, "individuals": ("Zoë",)}), tmp_path / "a.c3d")
    found = read_c3d(tmp_path / "a.c3d")
    assert found.keypoints == ("?auft", "?auft (2)", "uber?all", "uber all")
    assert found.individuals == ("Zoe",)
    as_pandas(found)


def test_what_is_all_inferred_is_read_as_inferred(tmp_path: Path) -> None:
    own = walk(people=1)
    states = np.minimum(own.states, 1)
    write_c3d(Trajectories(**{**vars(own), "states": states}), tmp_path / "a.c3d")
    np.testing.assert_array_equal(read_c3d(tmp_path / "a.c3d").states, states)


def test_a_rate_is_told_of_equal_steps_alone() -> None:
    own = walk()
    assert as_dataset(own).attrs["fps"] == 30.0
    assert (
        "fps" not in as_dataset(Trajectories(**{**vars(own), "times_s": own.times_s + 0.001 * (own.runs == 1)})).attrs
    )


def test_a_netcdf_that_is_too_large_is_refused_before_work(tmp_path: Path) -> None:
    own = walk(people=1, points=1)
    huge = np.broadcast_to(own.positions[:1], (100_000_000, 1, 1, 3))
    with pytest.raises(SettingsError, match="below 2 GiB in a netCDF"):
        write_netcdf(Trajectories(**{**vars(own), "positions": huge}), tmp_path / "a.nc")
    assert not (tmp_path / "a.nc").exists()


def test_somebody_who_looks_at_the_camera_looks_along_opensims_x() -> None:
    np.testing.assert_array_equal(T_OPENSIM_WORLD[:3, :3] @ [0.0, 0.0, -1.0], [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(T_OPENSIM_WORLD[:3, :3] @ [0.0, 1.0, 0.0], [0.0, 1.0, 0.0])
    assert np.linalg.det(T_OPENSIM_WORLD) == 1.0


def fail_after_half(part: Path) -> None:
    part.write_text("half")
    raise ValueError("half is there")


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(ValueError, match="half is there"), new_file(path) as part:
        fail_after_half(part)
    assert list(tmp_path.iterdir()) == []
    with new_file(path) as part:
        assert part.name == path.name
        part.write_text("whole")
    assert path.read_text() == "whole"
    with pytest.raises(TakeExistsError, match="--force"), new_file(path):
        pass
    with new_file(path, force=True) as part:
        part.write_text("new")
    assert [one.read_text() for one in tmp_path.iterdir()] == ["new"]
    with pytest.raises(SettingsError, match="name a file in a folder that exists"), new_file(tmp_path / "no" / "a"):
        pass


def test_of_a_folder_only_the_files_that_are_written_are_replaced(tmp_path: Path) -> None:
    """Other programs work in such a folder."""
    path = tmp_path / "a.opensim"
    for text, force in (("old", False), ("new", True)):
        with new_file(path, force=force) as part:
            part.mkdir()
            (part / "model.osim").write_text(text)
        (path / "result.mot").write_text("theirs")
    assert {one.name: one.read_text() for one in path.iterdir()} == {"model.osim": "new", "result.mot": "theirs"}
    assert (path.stat().st_mode & 0o111) == (path.stat().st_mode & 0o444) >> 2
    with pytest.raises(TakeExistsError, match="--force"), new_file(path):
        pass
    assert [one.name for one in tmp_path.iterdir()] == ["a.opensim"]


def test_a_missing_library_names_the_extra() -> None:
    with pytest.raises(SettingsError, match=r"no_such_module is not installed: uv sync --extra exports"):
        needed("no_such_module")
