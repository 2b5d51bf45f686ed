"""Pictures are always the same to the byte, told apart in grey, and drawn from what was measured."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.study_results import KINECT, MEANS_CM, gathered, strip, study

from mocapella.errors import SettingsError
from mocapella.studies.picture_files import COLOURS, FORMATS, HATCHES, MARKERS, StudyPicture, file_stem
from mocapella.studies.pictures import study_pictures, time_courses
from mocapella.studies.pooled_tasks import pooled_tasks
from mocapella.studies.stick_figures import MOST_STRIPS, bones_of

SMALL = {key: mean for key, mean in MEANS_CM.items() if key[0] == "walk"}


def drawn(seed: int = 0) -> tuple[StudyPicture, ...]:
    return study_pictures(study(seed, participants=3, means_cm=SMALL))


@pytest.fixture(scope="module")
def pictures() -> tuple[StudyPicture, ...]:
    return drawn()


@pytest.mark.slow
def test_each_kind_of_picture_is_drawn_in_each_format(pictures: tuple[StudyPicture, ...]) -> None:
    kinds = ["bars", "joints-walk", "time", "joint-time-walk", "joint-value-walk"]
    assert [one.name for one in pictures] == [f"{kind}-stand-still-between-sensors" for kind in kinds]
    starts = {"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}
    for one in pictures:
        assert {name: content[: len(starts[name])] for name, content in one.files.items()} == starts
        assert one.title
        assert one.caption.endswith(".")
        assert one.about == "stand-still, between sensors"


@pytest.mark.slow
def test_nothing_in_them_is_of_this_moment_or_machine(pictures: tuple[StudyPicture, ...]) -> None:
    for one in pictures:
        assert b"<dc:date>" not in one.files["svg"]
        assert b"CreationDate" not in one.files["pdf"]
        assert b"Software" not in one.files["png"]


@pytest.mark.slow
def test_they_are_the_same_to_the_byte_whatever_the_users_style(pictures: tuple[StudyPicture, ...]) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red", "svg.hashsalt": None}):
        again = drawn()
        assert mpl.rcParams["font.size"] == 20
    assert [one.files for one in again] == [one.files for one in pictures]


@pytest.mark.slow
def test_other_differences_give_other_pictures(pictures: tuple[StudyPicture, ...]) -> None:
    others = drawn(1)
    assert all(one.files["png"] != other.files["png"] for one, other in zip(pictures, others, strict=True))


def luminance(colour: str) -> float:
    return sum(w * int(colour[k : k + 2], 16) / 255 for w, k in ((0.299, 1), (0.587, 3), (0.114, 5)))


def test_placements_are_told_apart_in_grey() -> None:
    first = [luminance(colour) for colour in COLOURS[:3]]
    assert min(abs(a - b) for k, a in enumerate(first) for b in first[:k]) > 0.05
    assert len(set(COLOURS)) == len(set(HATCHES)) == len(set(MARKERS)) == 8


def test_courses_are_means_of_their_bins() -> None:
    (tasks,) = pooled_tasks(study(2, participants=3, means_cm={("walk", "90"): 9.0}, seconds=5.3)).values()
    at, courses = time_courses(tasks)
    assert at[:2] == pytest.approx([0.25, 0.75])
    assert courses.shape == (3, 11)
    assert courses[0, 0] == pytest.approx(tasks[0].over_time_cm[:5].mean())
    assert courses[0, 10] == pytest.approx(tasks[0].over_time_cm[50:].mean())


def test_the_people_of_one_task_are_in_one_picture_and_left_out_ones_are_counted() -> None:
    strips = [strip(participant=str(who), person=person) for who in range(MOST_STRIPS + 2) for person in range(2)]
    results = gathered((), KINECT)
    found = study_pictures(type(results)(results.files, KINECT, (), tuple(strips[:2]), (), ()))
    assert [one.name for one in found] == ["sticks-stand-still-90-obstacle-0"]
    assert "not drawn" not in found[0].caption
    assert "fused" not in found[0].caption


@pytest.mark.slow
def test_more_timelines_than_a_report_shows_are_spread_over_the_tasks() -> None:
    strips = [strip(participant=str(who)) for who in range(MOST_STRIPS + 2)] + [strip("exchange", "20")]
    results = gathered((), KINECT)
    found = study_pictures(type(results)(results.files, KINECT, (), tuple(strips), (), ()))
    assert len(found) == MOST_STRIPS
    assert found[0].name == "sticks-stand-still-90-exchange-20"
    assert all(one.caption.endswith("3 other timelines are not drawn.") for one in found)


def test_bones_are_those_of_the_named_joints() -> None:
    assert len(bones_of(KINECT)) == 24
    assert bones_of(("Head", "Neck")) in (((0, 1),), ((1, 0),))
    assert bones_of(("nose", "ear")) == ()


def test_a_view_without_anybody_and_a_strip_of_nothing_are_drawn() -> None:
    one = strip()
    empty = type(one)(*[getattr(one, name) for name in one.__struct_fields__[:7]], one.positions * np.nan, one.measured)
    results = gathered((), KINECT)
    (found,) = study_pictures(type(results)(results.files, KINECT, (), (empty,), (), ()))
    assert found.files.keys() == set(FORMATS)


@given(words=st.lists(st.text(max_size=9), max_size=3))
def test_a_stem_is_a_plain_name(words: list[str]) -> None:
    stem = file_stem(*words)
    assert stem == file_stem(stem)
    assert all(c.isascii() and (c.isalnum() or c == "-") for c in stem)


@pytest.mark.slow
def test_methods_whose_names_make_one_stem_have_pictures_of_their_own() -> None:
    only = {("walk", "90"): 9.0}
    one, other = (study(0, participants=2, means_cm=only, method=name) for name in ("a:b", "a;b"))
    both = gathered(one.summaries + other.summaries, one.joints)
    names = [picture.name for picture in study_pictures(both)]
    assert len(set(names)) == len(names) == 10


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(SettingsError, match=r"matplotlib is not installed.*mocapella\[studies\]"):
        drawn()
