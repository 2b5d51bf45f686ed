"""Lanes are looked up by the frame's type; one that raises, or that nobody has, is an empty lane with its name."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.walkers import Room

from mocapella.model import frame_types
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.images import image_frame
from mocapella.model.markers import marker_frame
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.viewer.bones import line_strokes
from mocapella.viewer.gallery import gallery_drawing
from mocapella.viewer.lanes import Lane, LaneDrawing, LaneSpace, draw_lane, kept, lane_of
from mocapella.viewer.palette import Rgb
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.readout import notices_html
from mocapella.viewer.view_state import ViewMemory

SPACE = LaneSpace(np.zeros(3), np.eye(4), Rgb(255, 255, 255))


class BellFrame(SensorFrame, frozen=True, eq=False):
    """Of somebody's sensor."""


BELL = BellFrame("bell", 0, 0, 0, 0)


def ring(frame: BellFrame, space: LaneSpace) -> LaneDrawing:
    points = space.origin + np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return LaneDrawing(line_strokes(points, space.colour.paint, 0.01))


def crack(frame: BellFrame, space: LaneSpace) -> LaneDrawing:
    raise ValueError("it is <cracked>")


def forget(frame: BellFrame, space: LaneSpace) -> None:
    return None


def melt(frame: BellFrame, space: LaneSpace) -> LaneDrawing:
    strokes = ring(frame, space).lines
    strokes.positions[:] = np.nan
    return LaneDrawing(strokes)


PICTURES = Lane(ring, size_px=lambda frame: (640, 480))


@pytest.fixture
def bells(monkeypatch):
    """Registers bells with the lane of that name."""
    monkeypatch.setattr(frame_types, "_BY_CLASS", {})

    def register(lane: str) -> ViewMemory:
        kind = msgspec  # any module: nothing is encoded here
        monkeypatch.setitem(
            FRAME_TYPES, "bells",
            frame_types.FrameType(1, "bells", BellFrame, kind.json.encode, kind.json.decode, format=None, lane=lane),  # type: ignore[arg-type]
        )  # fmt: skip
        known = ViewMemory()
        known.learn(None, {"bell": BELL}, None)
        return known

    return register


@pytest.mark.parametrize("name", FRAME_TYPES)
def test_every_lane_that_is_named_can_be_imported(name):
    troubles = PluginErrors()
    reference = FRAME_TYPES[name].lane
    if reference:
        from mocapella.registry import load

        assert load(reference).draw
    assert troubles.lines == ()


def test_a_plug_ins_lane_is_drawn_beside_ours(bells):
    known = bells(f"{__name__}:ring")
    frames = {"bell": BELL, **Room().frames(0.0)}
    known.learn(None, frames, None)
    drawing = gallery_drawing(frames, known)
    assert list(drawing.spaces) == ["bell", "front", "left", "right"]
    assert len(drawing.lines) == 1 + 3 * 2 * 24
    np.testing.assert_allclose(drawing.lines.positions[0], drawing.spaces["bell"].origin, atol=1e-6)
    assert known.troubles.lines == ()


@pytest.mark.parametrize(
    ("lane", "said"),
    [
        (f"{__name__}:crack", "ValueError: it is <cracked>"),
        (f"{__name__}:forget", "it makes NoneType; a LaneDrawing is wanted"),
        (f"{__name__}:melt", "positions have a value that is not finite"),
        ("nowhere:AT_ALL", "cannot be imported"),
    ],
)
def test_a_lane_that_raises_is_empty_the_others_are_drawn_and_it_is_told_once(bells, lane, said):
    known = bells(lane)
    frames = {"bell": BELL, **Room().frames(0.0)}
    for _ in range(3):
        known.learn(None, frames, None)
        drawing = gallery_drawing(frames, known)
        assert "bell" in drawing.spaces
        assert len(drawing.lines) == 3 * 2 * 24
    (line,) = known.troubles.lines
    assert line.startswith("lane of bells cannot be drawn: ")
    assert said in line
    html = notices_html(None, known.troubles.lines)
    assert "lane of bells" in html
    assert "<cracked>" not in html


def test_a_type_without_a_lane_or_that_nobody_reads_has_an_empty_lane():
    troubles = PluginErrors()
    for frame in (UnknownFrame("stranger", 0, 0, 0, 0, "gongs", b""), BELL):
        assert lane_of(frame, troubles) is None
        assert len(draw_lane(frame, SPACE, troubles).lines) == 0
        assert kept(frame, troubles) is None
    assert troubles.lines == ()


def test_an_image_is_an_edge_of_its_shape_and_is_kept_without_its_pixels():
    troubles = PluginErrors()
    frame = image_frame("c1", bytes(1000), time_ns=1, format="jpeg", size_px=(640, 480))
    lines = draw_lane(frame, SPACE, troubles).lines
    assert len(lines) == 4
    assert np.ptp(lines.positions[:, 0]) / np.ptp(lines.positions[:, 1]) == pytest.approx(640 / 480, rel=1e-4)
    thin = kept(frame, troubles)
    assert thin is not None
    assert len(thin.data) == 0
    assert len(draw_lane(thin, SPACE, troubles).lines) == 4
    known = ViewMemory()
    known.learn(None, {"c1": frame}, None)
    assert known.sizes_px == {"c1": (640, 480)}
    across, high = known.fields["c1"]
    assert across > high
    assert len(draw_lane(image_frame("c1", None, time_ns=1), SPACE, troubles).lines) == 0


def test_a_field_of_view_that_the_frames_know_is_taken_also_with_an_image_size(bells, monkeypatch):
    known = bells(f"{__name__}:PICTURES")
    assert known.fields["bell"] == pytest.approx((60.0, 46.83), abs=0.01)  # a guess
    monkeypatch.setattr(BellFrame, "field_of_view_deg", (90.0, 70.0))
    known.learn(None, {"bell": BELL}, None)
    assert known.fields["bell"] == (90.0, 70.0)


def test_sensors_whose_pictures_stand_over_the_stage_have_no_lane():
    known = ViewMemory()
    frames = {
        name: marker_frame(name, ("red",), time_ns=1, size_px=(640, 480), positions_px=[[1, 2]]) for name in "abc"
    }
    known.learn(None, frames, None)
    assert list(gallery_drawing(frames, known, ("b",)).spaces) == ["a", "c"]
