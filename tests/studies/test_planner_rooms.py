"""A room's file is read once, and what is wrong in it is named with the remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from mocapella.decoding import decode_toml
from mocapella.errors import InputError
from mocapella.studies.planner.planned_room import (
    SENSOR_MODELS,
    PlannedSensors,
    example_room,
    read_room,
    room_from_toml,
    solid_at,
)
from mocapella.studies.planner.polygons import crosses_itself, inside, polygon_area

SITES = [{"along": [[0.2, 0.2], [3.8, 0.2]], "heights_m": [1.0]}]
ROOM: dict[str, Any] = {"width": 4.0, "depth": 4.0, "height": 2.5, "sites": SITES}


def decoded(**changes: Any) -> Any:
    return room_from_toml(tomli_w.dumps(ROOM | changes).encode(), "room.toml")


def test_the_example_is_a_room() -> None:
    room = room_from_toml(example_room().encode(), "example")
    assert (room.width, room.depth, room.sensor.count) == (6.0, 5.0, 3)
    assert len(room.boxes) == len(room.cylinders) == 1
    assert set(decode_toml(example_room())) <= {*room.__dataclass_fields__}


def test_the_whole_floor_is_the_area_if_none_is_given() -> None:
    assert polygon_area(
        np.array(decoded(corner=[-1.0, 2.0], sites=[{"points": [[0, 3]], "heights_m": [1.0]}]).floor)
    ) == pytest.approx(16)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"boxes": [{"centre": [3.9, 2.0], "size": [1.0, 1.0, 1.0]}]}, r"boxes\[0\]: \(4\.4, 2\.5\) reaches outside"),
        ({"boxes": [{"centre": [2.0, 2.0], "size": [1.0, 3.0, 1.0]}]}, r"no higher than the room, 2\.5 m"),
        ({"cylinders": [{"centre": [0.1, 2.0], "radius": 0.3, "height": 1.0}]}, "cylinders.0.: .* reaches outside"),
        ({"cylinders": [{"centre": [2.0, 2.0], "radius": 0.3, "height": 9.0}]}, "no higher than the room"),
        ({"area": [[0, 0], [5, 0], [5, 2]]}, r"area: \(5, 0\) is outside the room; the room has x from 0 to 4"),
        ({"area": [[1, 1], [3, 3], [3, 1], [1, 3]]}, "area crosses itself; give its corners in their order"),
        ({"area": [[1, 1], [3, 3]]}, "area is 2; it must be from 3 to 200 points"),
        ({"area": [[1, 1], [1.01, 1], [1, 1.01]]}, "area in m² is 0.0001; it must be 0.01 m² or more"),
        ({"sensor": {"count": 0}}, "sensor.count is 0; it must be from 1 to 16"),
        ({"sensor": {"kind": "kinect"}}, r"sensor\.kind is 'kinect'; it must be .*did you mean kinect-v"),
        ({"sensor": {"fov_deg": [70.0]}}, "sensor.fov_deg .* two angles"),
        ({"sensor": {"range_m": [3.0, 1.0]}}, "a nearest and a greater farthest depth"),
        ({"sites": []}, "from 1 to 200 groups of places"),
        ({"sites": [{"points": [[1, 1]]}]}, "room: .*heights_m"),
        ({"sites": [{"heights_m": [1.0]}]}, "exactly one of points, along and within"),
        (
            {"sites": [{"points": [[1, 1]], "along": [[0, 0], [1, 1]], "heights_m": [1.0]}]},
            "exactly one of points, along and within",
        ),
        ({"sites": [{"points": [[1, 9]], "heights_m": [1.0]}]}, r"sites\[0\].points: \(1, 9\) is outside the room"),
        ({"sites": [{"points": [[1, 1]], "heights_m": [3.0]}]}, r"heights_m is 3\.0; it must be no higher"),
        ({"people": {"heights_m": [1.9, 1.5]}}, "the smallest and the greatest height"),
        ({"people": {"postures": ["sitt"]}}, "did you mean sit"),
        ({"width": 1e6}, "width is 1000000.0; it must be from 1 to 100 m"),
        ({"width": float("nan")}, "width is nan"),
        ({"cell_m": 0.0}, "cell_m is 0.0; it must be from 0.05 to 2 m"),
        ({"widht": 4.0}, r"unknown key 'widht'.*did you mean width\?"),
    ],
)
def test_a_mistake_is_named_with_the_remedy(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        decoded(**changes)
    assert str(raised.value).startswith("room.toml: ")
    assert "mocapella plan --example" in str(raised.value)


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no TOML"):
        room_from_toml(b"width = ", "room.toml")
    with pytest.raises(InputError, match="cannot be read"):
        read_room(tmp_path / "none.toml")


def test_a_kind_s_optics_can_be_replaced() -> None:
    model = PlannedSensors("kinect-v1", 1, (80.0, 50.0)).model
    assert (model.fov_deg, model.range_m) == ((80.0, 50.0), SENSOR_MODELS["kinect-v1"].range_m)


COORDINATE = st.floats(-10, 10).map(lambda x: round(x, 3))
STAR = st.lists(st.floats(0.5, 5.0), min_size=5, max_size=12)


def star(radii: list[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A polygon around the origin, whose corners are at even angles."""
    angle = np.arange(len(radii)) * 2 * np.pi / len(radii)
    return np.array(radii)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@given(STAR, COORDINATE, COORDINATE)
def test_a_star_does_not_cross_itself_wherever_it_is(radii: list[float], x: float, z: float) -> None:
    polygon = star(radii)
    there = polygon + np.array([x, z])
    assert not crosses_itself(there)
    assert polygon_area(there) == pytest.approx(polygon_area(polygon), rel=1e-6)


@given(STAR, st.floats(0.05, 3.0))
def test_a_point_is_inside_a_star_as_far_as_its_edge(radii: list[float], factor: float) -> None:
    polygon = star(radii)
    middles = (polygon + np.roll(polygon, -1, axis=0)) / 2
    if abs(factor - 1) > 0.01:
        assert (inside(polygon, factor * middles) == (factor < 1)).all()


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [2, 2], [2, 0], [0, 2]],
        [[0, 0], [2, 0], [1, 0], [1, 1]],  # an edge that folds back
        [[0, 0], [1, 0], [1, 0], [0, 1]],  # a corner twice
        [[0, 0], [2, 0], [2, 1], [1, 0], [0, 1]],  # a corner on an edge
    ],
)
def test_an_outline_that_touches_itself_is_found(corners: list[list[float]]) -> None:
    assert crosses_itself(np.array(corners, dtype=float))


def test_what_is_within_an_obstacle_is_solid() -> None:
    things = {
        "boxes": [{"centre": [1.0, 1.0], "size": [1.0, 1.0, 0.2], "yaw_deg": 90.0}],
        "cylinders": [{"centre": [3.0, 3.0], "radius": 0.5, "height": 1.0}],
    }
    at = np.array([[1.0, 1.4], [1.4, 1.0], [3.3, 3.0], [3.0, 3.6]])
    assert solid_at(decoded(**things), at).tolist() == [True, False, True, False]
