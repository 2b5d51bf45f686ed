"""What a notebook does: load a recording, look at it, and hand it to other libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.take_making import KIND, info, record

import mocapella
from mocapella.errors import InputError, NoServerError, SettingsError
from mocapella.exports.c3d_file import write_c3d
from mocapella.exports.needs import needed
from mocapella.recording.take_writer import TakeWriter


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("takes") / "walk-1.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 30)
    writer.close()
    return path


def test_a_take_is_loaded_with_or_without_its_ending(take: Path) -> None:
    for path in (take, str(take), take.with_suffix("")):
        recording = mocapella.load(path)
        assert recording.sensors == ("front", "side")
        assert recording.people is not None
        assert recording.people.keypoints == KIND.joints
        assert recording.hands is recording.arms is recording.bodies is recording.objects is recording.points is None
        assert len(recording.people) == len(list(recording.scenes())) == 60
        assert recording.labels[0] == {
            "participant": 7, "placement": "right-90", "scenario": "walk", "method": "stand-still",
        }  # fmt: skip
    assert recording.views is not None
    assert recording.views.individuals == ("person_0@front", "person_0@side")


def test_tables_and_data_sets_have_what_is_in_the_take(take: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    frame = people.to_pandas()
    assert len(frame) == 60 * len(KIND) == len(people.to_polars())
    assert set(frame["placement"]) == {"right-90"}
    found = people.to_xarray()
    np.testing.assert_array_equal(found.position.values, np.transpose(people.positions, (0, 3, 2, 1)))
    assert found.attrs["source_file"].endswith("walk-1.mcap")
    assert people.at_rate(10.0).rate_hz == 10.0


def test_it_can_be_read_as_text_and_as_html(take: Path) -> None:
    recording = mocapella.load(take)
    assert "sensors: front, side" in repr(recording)
    assert ".people: <people: person_0; 25 keypoints, 60 frames" in repr(recording)
    assert "<td>person_0</td><td>100%</td><td>100%</td>" in recording._repr_html_()


def test_a_plot_has_a_line_for_each_individual_and_axis(take: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    figure = people.plot("Head")
    assert [axis.get_ylabel() for axis in figure.axes] == ["x [m]", "y [m]", "z [m]"]
    np.testing.assert_array_equal(
        figure.axes[1].lines[0].get_ydata(), people.positions[:, 0, people.keypoints.index("Head"), 1]
    )
    with pytest.raises(SettingsError, match=r"no keypoint 'Hed'; known: .*\(did you mean Head\?\)"):
        people.plot("Hed")


def test_a_plot_of_angles_has_both_sides_in_a_panel_with_states_and_uncertainty(take: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    angles = people.joint_angles()
    k = angles.names.index("knee_angle_r")
    angles.states[5, 0, k], angles.states[9, 0, k] = 1, 0
    angles.angles[9, 0, k], angles.sd[:, 0, k] = np.nan, 0.1
    figure = angles.plot("knee_angle_l", "knee_angle_r")
    (axes,) = figure.axes
    assert axes.get_title() == "knee_angle"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["person_0 left", "person_0 right"]
    right, dots = axes.lines[2:]
    expected = np.degrees(angles.angles[:, 0, k])
    measured = np.isin(np.arange(len(angles)), (5, 9), invert=True)
    np.testing.assert_array_equal(right.get_ydata()[measured], expected[measured])
    assert np.isnan(right.get_ydata()[[5, 9]]).all()
    np.testing.assert_array_equal(dots.get_ydata(), expected[[5]])
    assert len(axes.collections) >= 1  # the band of the standard deviation
    every = angles.plot()
    shown = [one.get_title() for one in every.axes if one.get_visible()]
    known = np.isfinite(angles.angles).any(axis=(0, 1))
    assert set(shown) == {name.removesuffix("_l").removesuffix("_r") for name in np.array(angles.names)[known]}
    with pytest.raises(SettingsError, match=r"no angle 'knee_angle'; known: .*knee_angle"):
        angles.plot("knee_angle")
    angles.angles[:] = np.nan
    with pytest.raises(SettingsError, match="no angle of people is ever known, so there is nothing to plot"):
        angles.plot()


def test_in_a_sensors_space_it_needs_the_sensors_pose(take: Path) -> None:
    with pytest.raises(SettingsError, match="no pose of a sensor 'front'"):
        mocapella.load(take).seen_from("front")


def test_a_damaged_take_gives_what_can_be_read_and_names_the_rest(take: Path, tmp_path: Path) -> None:
    data = take.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) * 2 // 3])
    recording = mocapella.load(tmp_path / "torn.mcap")
    assert recording.people is not None
    assert 0 < len(recording.people) < 60
    assert "problem: torn.mcap" in repr(recording)
    assert "<li>torn.mcap" in recording._repr_html_()


def test_a_take_without_people_has_none(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "empty.mcap", info=info(), reserve_bytes=0)
    writer.close()
    recording = mocapella.load(tmp_path / "empty.mcap")
    assert recording.people is recording.views is None
    assert repr(recording) == "<Recording empty.mcap: 0.0 s>"


def test_points_of_a_file_are_loaded(take: Path, tmp_path: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    own = people.at_rate()
    write_c3d(own, tmp_path / "a.c3d")
    recording = mocapella.load(tmp_path / "a.c3d")
    assert recording.points is not None
    np.testing.assert_allclose(recording.points.positions, own.positions, atol=1e-6)
    assert (recording.sensors, recording.labels, recording.problems, recording.views) == ((), {}, (), None)
    assert recording.seconds == pytest.approx((len(own) - 1) / own.rate_hz)
    assert list(recording.scenes()) == []
    with pytest.raises(SettingsError, match=r"a\.c3d has no sensors: only a take has"):
        recording.seen_from("front")


@pytest.mark.parametrize("name", ["walk.txt", "walk", "walk.fbx"])
def test_another_file_is_refused_with_the_known_endings(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("x")
    with pytest.raises(InputError, match=r"is no recording that can be loaded.*\.mcap, \.trc, \.c3d, \.json"):
        mocapella.load(tmp_path / name)
    with pytest.raises(InputError, match="there is no such file"):
        mocapella.load(tmp_path / "gone")
    with pytest.raises(InputError, match=r"no\.mcap"):
        mocapella.load(tmp_path / "no.mcap")


def test_connecting_without_a_server_says_so() -> None:
    with pytest.raises(NoServerError):
        next(mocapella.connect("tls/127.0.0.1:1"))


def test_netcdf_of_the_library_opens_in_xarray(take: Path, tmp_path: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    people.to_xarray().to_netcdf(tmp_path / "a.nc", engine="scipy")
    with needed("xarray").open_dataset(tmp_path / "a.nc", engine="scipy") as found:
        assert found.sizes["time"] == 60


def test_a_unit_is_refused_for_a_study_log(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("Tracker_Time\n")
    with pytest.raises(SettingsError, match=r"unit 'cm': log\.csv is no BVH"):
        mocapella.load(tmp_path / "log.csv", unit="cm")


def test_a_take_is_found_by_its_name(take: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    (tmp_path / "takes" / "walk.mcap").write_bytes(take.read_bytes())
    monkeypatch.chdir(tmp_path)
    for name in ("walk", "walk.mcap", "takes/walk"):
        assert mocapella.load(name).people is not None
    with pytest.raises(InputError, match="is a folder"):
        mocapella.load("takes")


def test_a_table_of_another_kind_is_refused_with_those_that_can_be_loaded(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="give a table of `mocapella export csv`, bodies of an Azure Kinect"):
        mocapella.load(tmp_path / "a.csv")
