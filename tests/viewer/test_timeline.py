"""What was shown is kept, bounded, and played as fast as it was; each browser is where it wants to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fitted_scenes import body, scene
from support.silhouette_pictures import pose_at, somebody
from support.walkers import Room

from mocapella.viewer import timeline as module
from mocapella.viewer.perspective import Perspectives
from mocapella.viewer.picture_plane import CameraPicture
from mocapella.viewer.stages import ROOM
from mocapella.viewer.timeline import Moment, Playhead, PlayState, ShownPicture, Timeline, size_of

MESH = somebody()
SEEN = Perspectives()


def moment(k, picture=None, *, at_s=None, frames=None):
    made = scene(k, body(MESH, pose_at(MESH, 0.01 * k)), at_s=at_s)
    pictures = {} if picture is None else {"c1": ShownPicture(picture, made, made.at_ns / 1e9)}
    return Moment(made.at_ns / 1e9, made, frames or {}, ROOM, made, SEEN, pictures)


def picture(size=300):
    return CameraPicture(bytes(size), (640, 480))


@pytest.fixture
def timeline():
    return Timeline()


def steps(timeline):
    return [timeline[number].scene.step for number in range(timeline.first, timeline.last + 1)]


def test_the_newest_is_shown_until_somebody_stops_it_and_then_it_is_played(timeline):
    head, now_s = Playhead(timeline), 100.0
    assert head.state is PlayState.NOTHING
    for k in range(5):
        timeline.add(moment(k))
        head.update(now_s + 0.03 * k)
    assert (head.shown, head.state) == (4, PlayState.FOLLOWING)
    head.playing, head.wish = False, 1
    head.update(now_s + 1)
    timeline.add(moment(5))
    head.update(now_s + 2)
    assert (head.shown, head.state) == (1, PlayState.PAUSED)
    assert head.behind_s == pytest.approx(4 / 30)
    head.playing = True
    places = []
    for k in range(12):
        head.update(now_s + 3 + k / 60)
        places.append(head.shown)
    assert places == sorted(places)
    assert places[0] == 1
    assert places[-1] == 5
    assert places.count(3) in (1, 2, 3)  # 30 frames a second, shown 60 times
    timeline.done = True
    head.update(now_s + 4)
    head.update(now_s + 4)
    assert (head.playing, head.state) == (False, PlayState.END)
    head.update(now_s + 5)
    head.playing = True
    head.update(now_s + 6)
    assert (head.shown, head.state) == (0, PlayState.PLAYING)


def test_who_is_behind_can_follow_the_newest_again(timeline):
    head = Playhead(timeline)
    for k in range(9):
        timeline.add(moment(k))
    head.playing, head.wish = False, 2
    head.update(1.0)
    head.newest = True
    head.update(2.0)
    assert (head.shown, head.playing, head.state) == (8, True, PlayState.FOLLOWING)
    timeline.add(moment(9))
    head.update(3.0)
    assert head.shown == 9


def test_two_browsers_are_each_where_they_want_to_be(timeline):
    one, other = Playhead(timeline), Playhead(timeline)
    for k in range(4):
        timeline.add(moment(k))
    one.playing = False
    for head in (one, other):
        head.update(1.0)
    timeline.add(moment(4))
    for head in (one, other):
        head.update(2.0)
    assert (one.shown, other.shown) == (3, 4)


def test_a_scene_is_kept_once_and_none_is_kept_without_a_scene(timeline):
    first = moment(0)
    for _ in range(3):
        timeline.add(first)
    timeline.add(Moment(0.0, None, {}, ROOM, None, SEEN, {}))
    assert len(timeline) == 1


def test_old_pictures_are_let_go_where_there_are_many_and_scenes_stay(timeline, monkeypatch):
    scenes = size_of(moment(0).scene)
    monkeypatch.setattr(module, "KEPT_BYTES", 10 * scenes + 3 * 100_000 + 2000)
    for k in range(10):
        timeline.add(moment(k, picture(100_000)))
    assert [len(timeline[k].pictures) for k in range(10)] == [0] * 7 + [1] * 3
    assert steps(timeline) == list(range(10))


def test_a_picture_that_many_moments_show_counts_once_and_as_long_as_one_has_it(timeline, monkeypatch):
    scenes = size_of(moment(0).scene)
    monkeypatch.setattr(module, "KEPT_BYTES", 20 * scenes + 100_000 + 2000)
    one = picture(100_000)
    for k in range(10):
        timeline.add(moment(k, one))
    assert all(timeline[k].pictures for k in range(10))
    for k in range(10, 20):
        timeline.add(moment(k, picture(100_000) if k == 10 else timeline[10].pictures["c1"].picture))
    assert not any(timeline[k].pictures for k in range(10))
    assert all(timeline[k].pictures for k in range(10, 20))


def test_the_oldest_moments_are_let_go_and_who_looks_at_one_goes_on_looking_at_it(timeline, monkeypatch):
    scenes = size_of(moment(0).scene)
    monkeypatch.setattr(module, "KEPT_FRAMES", 20)
    monkeypatch.setattr(module, "LET_GO", 5)
    monkeypatch.setattr(module, "KEPT_BYTES", 25 * scenes + 11 * 20_000 + 5000)
    head = Playhead(timeline)
    for k in range(24):
        timeline.add(moment(k, picture(20_000)))
    head.playing, head.wish = False, 12
    head.update(1.0)
    timeline.add(moment(24, picture(20_000)))
    head.update(2.0)
    assert steps(timeline) == list(range(5, 25))
    assert timeline[head.shown].scene.step == 12
    for k in range(25, 300):
        timeline.add(moment(k, picture(20_000)))
        assert timeline._bytes <= module.KEPT_BYTES
        assert timeline._bytes == sum(timeline._scene_bytes) + sum(timeline._other_bytes)
    head.update(3.0)
    assert head.shown == timeline.first  # what it looked at is gone
    kept = [len(timeline[k].pictures) for k in range(timeline.first, timeline.last + 1)]
    assert kept == sorted(kept)
    assert 8 <= sum(kept) <= 13
    assert len(timeline) <= 25


def test_scenes_alone_are_bounded_too(timeline, monkeypatch):
    scenes = size_of(moment(0).scene)
    monkeypatch.setattr(module, "KEPT_BYTES", 30 * scenes)
    for k in range(200):
        timeline.add(moment(k))
    assert timeline._bytes <= 30 * scenes
    assert 20 <= len(timeline) <= 31
    assert timeline[timeline.last].scene.step == 199


def test_another_clock_begins_another_timeline_and_a_little_back_is_no_other(timeline):
    head = Playhead(timeline)
    for k in range(5):
        timeline.add(moment(k, at_s=100.0 + k))
    head.playing, head.wish = False, 1
    head.update(1.0)
    timeline.add(moment(5, at_s=103.9))
    assert len(timeline) == 6
    assert timeline[5].at_s == 104.0
    timeline.add(moment(0, at_s=3.0))
    head.update(2.0)
    assert (len(timeline), head.shown) == (1, 0)


@given(
    st.lists(st.floats(0.001, 0.3), min_size=2, max_size=30), st.lists(st.floats(0.001, 0.2), min_size=1, max_size=40)
)
def test_it_is_played_as_fast_as_it_was_however_often_it_is_shown(apart, beats):
    timeline = Timeline()
    at_s = np.cumsum(apart)
    for k, at in enumerate(at_s):
        timeline.add(moment(k, at_s=float(at)))
    head = Playhead(timeline)
    head.playing, head.wish = False, 0
    head.update(0.0)
    head.playing, now_s = True, 10.0
    head.update(now_s)
    for beat in beats:
        now_s += beat
        head.update(now_s)
        due_s = at_s[0] + now_s - 10.0
        assert timeline[head.shown].at_s <= due_s + 1e-6 or head.shown == 0
        if head.number is not None and head.shown < timeline.last:
            assert timeline[head.shown + 1].at_s > due_s - 1e-6


def test_scenes_of_the_last_seconds_and_the_one_nearest_to_a_time_are_found(timeline):
    for k in range(30):
        timeline.add(moment(k))
    at_s, scenes = timeline.lately(20, 0.2)
    assert [one.step for one in scenes] == list(range(14, 21))
    assert at_s == pytest.approx([k / 30 for k in range(14, 21)])
    near = timeline.scene_near(0.5 + 0.01, within_s=0.1)
    assert near is not None
    assert near.step == 15
    assert timeline.scene_near(5.0, within_s=0.1) is None
    assert Timeline().scene_near(0.0, within_s=1.0) is None
    assert Timeline().lately(0, 1.0) == ([], [])


def test_a_scene_takes_about_as_much_as_its_arrays():
    room = Room()
    frames = room.frames(0.0)
    arrays = 2 * (25 * 3 * 8 + 25 + 3 * (25 * 3 * 8 + 25 + 128))
    assert arrays < size_of(room.scene(0.0, frames)) < 4 * arrays
    assert size_of(frames["front"]) > frames["front"].positions.nbytes
