"""`mocapella calibrate colours`: pictures → profile → mask, and what a user may get wrong."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

import mocapella.cli.colours  # noqa: F401 - registers the verbs
from mocapella.cli.app import app
from mocapella.errors import MocapellaError
from mocapella.sensing.colour_profile import load_profile
from mocapella.sources.simulate.hand_scene import HandShot, load_hand_scene

SCENE = load_hand_scene("demo", seed=3)


@cache
def shot() -> HandShot:
    """Not while tests are collected: all workers would compile for it at once."""
    return SCENE.at("left", 0.2)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["calibrate", "colours", *arguments])


def pointing() -> list[str]:
    clicks = zip(SCENE.names, shot().centres_px, strict=True)
    return [word for name, (x, y) in clicks for word in ("--point", f"{name}={x:.1f},{y:.1f}")]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("shot.png", shot().image)
    return tmp_path


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def test_what_is_pointed_at_is_found_again_and_drawn(here: Path) -> None:
    (here / "films").mkdir()
    cv2.imwrite("films/0.png", np.zeros_like(shot().image))
    cv2.imwrite("films/1.png", shot().image)
    cv2.imwrite("empty.png", np.full_like(shot().image, 90))
    done = run(
        *("learn", "films", "--frame", "1", "--name", "left", *pointing(), "--empty", "empty.png", "--empty"),
        *("films@0", "--set", "exposure=120", "--out", "left.json", "--json", "learnt.json"),
    )
    assert done.exit_code == 0, done.output
    profile, learnt = load_profile("left.json"), read(here / "learnt.json")
    assert profile.names == SCENE.names
    assert profile.controls.exposure == 120
    assert set(learnt["kept"]) == set(SCENE.names)
    assert "red" in done.output
    done = run("check", "shot.png", "--profile", "left.json", "--out", "mask.png", "--json", "seen.json")
    assert done.exit_code == 0, done.output
    seen = read(here / "seen.json")["markers"]
    off = [
        np.hypot(seen[n]["x_px"] - x, seen[n]["y_px"] - y)
        for n, (x, y) in zip(SCENE.names, shot().centres_px, strict=True)
    ]
    assert max(off) < 3.0
    mask = cv2.imread("mask.png")
    assert mask.shape == shot().image.shape
    assert np.median(mask) < 0.5 * np.median(shot().image)


def test_a_picture_to_point_at_is_written_as_it_is(here: Path) -> None:
    assert run("check", "rendered:demo/left", "--seed", "3", "--frame", "4", "--out", "plain.png").exit_code == 0
    np.testing.assert_array_equal(cv2.imread("plain.png"), shot().image)


def test_two_markers_of_one_colour_are_said(here: Path) -> None:
    assert run("learn", "shot.png", "--name", "left", *pointing(), "--out", "left.json").exit_code == 0
    double = (
        np.concatenate([shot().image[:, :160], shot().image[:, :160]], axis=1),
        np.concatenate([shot().image[:, 160:], shot().image[:, 160:]], axis=1),
    )
    counts = []
    for image in double:
        cv2.imwrite("double.png", image)
        done = run("check", "double.png", "--profile", "left.json", "--out", "m.png", "--json", "seen.json")
        assert done.exit_code == 0, done.output
        counts += [row["candidates"] for row in read(here / "seen.json")["markers"].values() if row]
        if 2 in counts:
            assert "one of 2 that could be it" in done.output + done.stderr
    assert 2 in counts


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("learn", "shot.png", "--name", "left", "--point", "red=3", "--out", "p.json"), "red=301,84"),
        (("learn", "shot.png", "--name", "left", "--point", "a=1,1", "--point", "a=2,2", "--out", "p.json"), "once"),
        (("learn", "shot.png", "--name", "left", "--point", "red=999,9", "--out", "p.json"), "outside the image"),
        (("learn", "shot.png", "--name", "a b", "--point", "red=9,9", "--out", "p.json"), "sensor name"),
        (
            ("learn", "shot.png", "--frame", "7", "--name", "left", "--point", "red=9,9", "--out", "p.json"),
            "no such picture",
        ),
        (("check", "shot.png", "--profile", "none.json", "--out", "m.png"), "none.json"),
        (("check", "none.png", "--out", "m.png"), "none.png"),
    ],
)
def test_what_cannot_be_used_says_what_could(here: Path, arguments: tuple[str, ...], says: str) -> None:
    done = run(*arguments)
    assert isinstance(done.exception, MocapellaError), done.output
    assert says in str(done.exception)
    assert not (here / "p.json").exists()
