"""The outlines drawn by hand are what a scoring takes them for: polygons that do not cross themselves, of a person."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

ROOT: Final = Path(__file__).resolve().parents[2]
LABELS: Final = ROOT / "tests" / "labels" / "pose2sim_single_person_outlines.toml"
SIZES: Final = {"cam01": (1080, 1920), "cam02": (1080, 1920), "cam03": (1088, 1920), "cam04": (1088, 1920)}
FRAMES: Final = (5, 27, 50, 72, 94)

Polygon = NDArray[np.float64]


def turn(a: Polygon, b: Polygon, c: Polygon) -> NDArray[np.float64]:
    """(...,) twice the area of the triangles a, b, c, positive where they turn from x to y."""
    return np.asarray((b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0])


def crossings(a: Polygon, b: Polygon) -> NDArray[np.bool_]:
    """(len(a), len(b)): which edge of one closed polygon (n, 2) crosses which of the other."""
    p, q, r, s = a[:, None], np.roll(a, -1, 0)[:, None], b[None], np.roll(b, -1, 0)[None]
    return (turn(p, q, r) * turn(p, q, s) < 0) & (turn(r, s, p) * turn(r, s, q) < 0)


def area(polygon: Polygon) -> float:
    """[px²] of a simple polygon (n, 2)."""
    return abs(float(turn(polygon[0], polygon, np.roll(polygon, -1, 0)).sum())) / 2


def within(points: Polygon, polygon: Polygon) -> NDArray[np.bool_]:
    """(len(points),): which points (n, 2) lie in the polygon, by the parity of the edges to their right."""
    a, b, (x, y) = polygon[None], np.roll(polygon, -1, 0)[None], np.moveaxis(points[:, None], -1, 0)
    spans = (a[..., 1] > y) != (b[..., 1] > y)
    height = np.where(spans, b[..., 1] - a[..., 1], 1.0)
    right = x < a[..., 0] + (y - a[..., 1]) / height * (b[..., 0] - a[..., 0])
    return np.asarray((spans & right).sum(1) % 2 == 1)


def circle(n: int, radius: float = 1.0) -> Polygon:
    angles = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angles), np.sin(angles)], -1)


@given(st.integers(3, 60), st.integers(0, 2**32 - 1))
def test_a_star_seen_from_its_middle_does_not_cross_itself_and_holds_what_is_nearer(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    radii = rng.uniform(1, 5, n)
    star = circle(n) * radii[:, None]
    assert not crossings(star, star).any()
    k = rng.integers(n)
    assert within(star[[k]] * 0.99, star).all()
    assert not within(star[[k]] * 1.01, star).any()
    # A fan of triangles about the middle has the same area.
    fan = 0.5 * np.sin(2 * np.pi / n) * (radii * np.roll(radii, -1)).sum()
    assert area(star) == pytest.approx(fan)
    assert area(np.roll(star, k, 0)[::-1]) == pytest.approx(fan)


@given(st.integers(4, 60), st.floats(0, 2 * np.pi))
def test_two_neighbours_of_a_circle_exchanged_make_a_crossing(n: int, angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    polygon = circle(n) @ np.array([[c, s], [-s, c]])
    polygon[[0, 1]] = polygon[[1, 0]]
    assert crossings(polygon, polygon).sum() == 2  # one crossing, seen from either edge


@pytest.mark.parametrize(("near", "far", "cross", "inside"), [(0, 1.4, 0, 1), (1.6, 2.4, 1, 0), (2.6, 9, 0, 0)])
@given(st.floats(0, 1))
def test_what_sticks_out_crosses(near: float, far: float, cross: bool, inside: bool, share: float) -> None:
    person, hole = circle(40, 2.0), circle(40, 0.5) + np.array([near + share * (far - near), 0.01])
    assert crossings(person, hole).any() == cross
    assert within(hole, person).all() == inside


Outline = dict[str, Any]


def outlines() -> list[Outline]:
    drawn: list[Outline] = tomllib.loads(LABELS.read_text(encoding="utf-8"))["outline"]
    for each in drawn:
        each |= {kind: [np.array(polygon, float) for polygon in each[kind]] for kind in ("person", "without")}
    return drawn


def faults(outline: Outline) -> set[str]:
    """What makes an outline useless."""
    person, without, size = outline["person"], outline["without"], np.array(SIZES[outline["camera"]])
    everything, found = [*person, *without], set()
    for k, polygon in enumerate(everything):
        # The image's border is half a pixel beyond the middle of its first pixel.
        if not ((polygon >= -0.5) & (polygon <= size - 0.5)).all():
            found.add("leaves the image")
        if not np.linalg.norm(polygon - np.roll(polygon, 1, 0), axis=1).all():
            found.add("a vertex twice")
        if any(crossings(polygon, other).any() for other in everything[k:]):
            found.add("crosses")
    for k, hole in enumerate(without):
        if sum(within(hole, polygon).all() for polygon in person) != 1:
            found.add("a hole beside the person")
        if any(within(hole, other).any() for other in without[:k] + without[k + 1 :]):
            found.add("a hole in a hole")
    # As drawn: 4 to 8 percent, most where the person is near.
    share = (sum(map(area, person)) - sum(map(area, without))) / size.prod()
    if not 0.03 < share < 0.1:
        found.add("no person's area")
    return found


def test_five_frames_of_each_camera_are_drawn() -> None:
    assert [(each["camera"], each["frame"]) for each in outlines()] == [(c, f) for c in SIZES for f in FRAMES]
    assert all(set(each) <= {"camera", "frame", "person", "without", "note"} for each in outlines())


@pytest.mark.parametrize("outline", outlines(), ids=lambda each: f"{each['camera']}-{each['frame']}")
def test_an_outline_has_no_faults(outline: Outline) -> None:
    assert not faults(outline)


@pytest.mark.parametrize("fault", ["crosses", "leaves the image", "a hole beside the person", "no person's area"])
def test_a_planted_fault_is_found(fault: str) -> None:
    outline = next(each for each in outlines() if each["without"])
    person, hole = outline["person"][0], outline["without"][0]
    if fault == "crosses":
        person[[3, 90]] = person[[90, 3]]
    elif fault == "leaves the image":
        person[:, 0] -= person[:, 0].min() + 1
    elif fault == "a hole beside the person":
        hole[:, 0] -= hole[:, 0].max()
    else:
        person *= 0.5
    assert fault in faults(outline)


@pytest.mark.parametrize("fault", ["a vertex twice", "a hole in a hole"])
def test_a_second_one_is_found(fault: str) -> None:
    outline = next(each for each in outlines() if each["without"])
    person, hole = outline["person"][0], outline["without"][0]
    if fault == "a vertex twice":
        outline["person"] = [np.insert(person, 7, person[7], axis=0)]
    else:
        outline["without"] = [hole, hole.mean(0) + 0.5 * (hole - hole.mean(0))]
    assert faults(outline) == {fault}


def test_the_videos_have_the_size_and_the_frames_that_were_drawn(single_person: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    for camera, size in SIZES.items():
        video = cv2.VideoCapture(str(single_person / "videos" / f"{camera}.mp4"))
        assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == size
        assert video.get(cv2.CAP_PROP_FRAME_COUNT) > max(FRAMES)
        video.release()
