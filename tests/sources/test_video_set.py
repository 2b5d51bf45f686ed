"""Videos of several cameras in step, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.silhouette_pictures import ring, write_folders, write_video

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.lens import project, undistort
from mocapella.sources.video import Frames
from mocapella.sources.video_set import VideoSet

SIZE = (64, 48)
RIG = ring(2, SIZE)


def shades(count, size=SIZE):
    return [np.full((size[1], size[0], 3), 10 * k + 5, np.uint8) for k in range(count)]


def two(folder: Path, counts=(6, 6), rates=(30.0, 30.0), sizes=(SIZE, SIZE)):
    for name, count, hz, size in zip(("c1", "c2"), counts, rates, sizes, strict=True):
        write_video(folder / f"{name}.avi", shades(count, size), hz)
    return {name: folder / f"{name}.avi" for name in ("c2", "c1")}


def test_frames_of_one_number_come_together_in_the_rigs_order(tmp_path):
    shown = VideoSet(two(tmp_path), RIG, frames=Frames(1, None, 2))
    found = list(shown)
    assert [one.frame for one in found] == [1, 3, 5]
    assert [one.time_ns for one in found] == [round(k * 1e9 / 30) for k in (1, 3, 5)]
    assert shown.count == 3
    assert shown.rate_hz == 30.0
    assert shown.notes == []
    for one in found:
        assert list(one.images) == ["c1", "c2"]
        assert all(abs(float(image.mean()) - (10 * one.frame + 5)) < 2 for image in one.images.values())


def test_the_shortest_counts_and_that_is_said(tmp_path):
    shown = VideoSet(two(tmp_path, counts=(6, 4)), RIG)
    assert [one.frame for one in shown] == [0, 1, 2, 3]
    assert shown.count == 4
    assert shown.notes == ["the videos differ in length (c2 4, c1 6 frames): the shortest, 4 frames, counts"]


def test_a_video_that_ends_before_its_header_says_is_said(tmp_path):
    shown = VideoSet(two(tmp_path), RIG)
    shown.videos["c1"] = msgspec.structs.replace(shown.videos["c1"], count=9)
    assert len(list(shown)) == 6
    assert shown.notes == [f"{tmp_path / 'c1.avi'} ends before frame 6, though its header states 9 frames"]


@pytest.mark.parametrize("hz", [None, 25.0])
def test_other_rates_are_an_error_that_names_both_unless_said(tmp_path, hz):
    paths = two(tmp_path, rates=(30.0, 25.0))
    if hz is not None:
        assert VideoSet(paths, RIG, rate_hz=hz).rate_hz == hz
        return
    with pytest.raises(InputError, match=r"c1\.avi.*frame rate: 30.*c2\.avi 25; convert all videos to one rate"):
        VideoSet(paths, RIG)


def test_another_size_is_refused_and_says_what_would_work(tmp_path):
    paths = two(tmp_path, sizes=(SIZE, (60, 48)))
    with pytest.raises(InputError, match=r"c2\.avi: field size.*60 × 48 px.*64 × 48 px; --set other_size=crop"):
        VideoSet(paths, RIG)
    with pytest.raises(SettingsError, match=r"other_size is 'crob'.*did you mean crop"):
        VideoSet(paths, RIG, other_size="crob")
    with pytest.raises(InputError, match=r"no scale of the whole picture.*try --set other_size=crop"):
        VideoSet(paths, RIG, other_size="scale")


def test_a_video_on_its_side_is_named(tmp_path):
    with pytest.raises(InputError, match="turn the video"):
        VideoSet(two(tmp_path, sizes=(SIZE, SIZE[::-1])), RIG)


def test_cropped_pixels_stay_where_they_were(tmp_path):
    shown = VideoSet(two(tmp_path, sizes=(SIZE, (60, 48))), RIG, other_size="crop")
    camera = shown.rig.cameras["c2"].camera
    assert camera.size_px == (60, 48)
    np.testing.assert_array_equal(camera.lens, RIG.cameras["c2"].camera.lens)
    assert any("60 × 48" in note and "--set other_size=crop" in note for note in shown.notes)


@pytest.mark.parametrize("factor", [2, 0.5])
def test_a_scaled_picture_shows_the_same_directions(tmp_path, factor):
    size = (int(SIZE[0] * factor), int(SIZE[1] * factor))
    shown = VideoSet(two(tmp_path, sizes=(SIZE, size)), RIG, other_size="scale")
    before, after = RIG.cameras["c2"].camera, shown.rig.cameras["c2"].camera
    pixels = np.random.default_rng(0).uniform(0, 40, (20, 2))
    # The pixel's edges, not their middles, are scaled: the first one begins at -0.5.
    scaled = (pixels + 0.5) * factor - 0.5
    np.testing.assert_allclose(undistort(scaled, after.lens), undistort(pixels, before.lens), atol=1e-9)
    points = np.random.default_rng(1).uniform([-1, -1, 3], [1, 1, 5], (20, 3))
    np.testing.assert_allclose(
        (project(points, before.lens) + 0.5) * factor - 0.5, project(points, after.lens), atol=1e-9
    )


def test_what_cannot_be_used_is_named(tmp_path):
    paths = two(tmp_path)
    with pytest.raises(InputError, match="no videos are named"):
        VideoSet({}, RIG)
    with pytest.raises(InputError, match=r"c1\.avi: field camera: 'c9'.*no such camera; the rig's are c1, c2"):
        VideoSet({"c9": paths["c1"]}, RIG)
    with pytest.raises(InputError, match=r"nothing\.avi: is not there"):
        VideoSet({"c1": tmp_path / "nothing.avi"}, RIG)
    (tmp_path / "text.avi").write_text("no video")
    with pytest.raises(InputError, match=r"text\.avi: is no video that can be read"):
        VideoSet({"c1": tmp_path / "text.avi"}, RIG)
    with pytest.raises(InputError, match="two cameras are the same of the rig"):
        VideoSet({"c1": paths["c1"], "C1": paths["c2"]}, RIG)
    with pytest.raises(InputError, match=r"--frames.*has none of the selected frames; it has 6 frames"):
        VideoSet(paths, RIG, frames=Frames(6))


def test_folders_of_images_need_a_rate(tmp_path):
    write_folders(tmp_path, [{"c1": shades(3)[k], "c2": shades(3)[k]} for k in range(3)])
    folders = {name: tmp_path / name for name in ("c1", "c2")}
    with pytest.raises(InputError, match="give it with --fps"):
        VideoSet(folders, RIG)
    shown = VideoSet(folders, RIG, rate_hz=50.0)
    assert (shown.count, len(list(shown))) == (3, 3)


def test_images_of_a_folder_that_change_their_size_are_named(tmp_path):
    write_folders(
        tmp_path, [{"c1": shades(1)[0], "c2": shades(1)[0]}, {"c1": shades(1)[0], "c2": shades(1, (32, 32))[0]}]
    )
    shown = VideoSet({name: tmp_path / name for name in ("c1", "c2")}, RIG, rate_hz=50.0)
    with pytest.raises(InputError, match=r"c2: field frame 1: \(32, 32\).*make all 64 × 48 px"):
        list(shown)
