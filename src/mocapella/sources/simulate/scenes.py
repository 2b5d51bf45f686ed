"""The named scenes of ``data/scenes.toml``: simulated rooms with people and the body sensors that see them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.settings import check, parse
from mocapella.sources.simulate.room import Room, SceneSettings, build_room


def scene_names() -> tuple[str, ...]:
    """Return the names that `load_scene` knows."""
    return tuple(_data()["scenes"])


def scene_summaries() -> dict[str, str]:
    """Return a one-line summary of each scene, by name."""
    return {name: scene["summary"] for name, scene in _data()["scenes"].items()}


def scene_settings(name: str) -> SceneSettings:
    """Look up a scene's settings by name; change them with `dataclasses.replace`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    return settings_from(_data(), name)


def settings_from(data: Mapping[str, Any], name: str) -> SceneSettings:
    """Parse the settings of the scene ``name`` from a file's tables ``sensors`` and ``scenes``.

    Raises:
        SettingsError: unknown scene, with the known ones, or an invalid value.
    """
    if name not in data["scenes"]:
        raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, data['scenes'])}")
    scene = {key: value for key, value in data["scenes"][name].items() if key != "summary"}
    sensors = [{"name": sensor, **data["sensors"][sensor]} for sensor in scene["sensors"]]
    return parse(SceneSettings, {"name": name, **scene, "sensors": sensors}, where=f"scene {name}")


def load_scene(
    name: str,
    *,
    seed: int = 0,
    topology: str = "kinect_v2",
    bvh: str | Path | None = None,
    bvh_person: int = 1,
    bvh_metres_per_unit: float | None = None,
) -> Room:
    """Build the room of a named scene.

    Args:
        name: one of `scene_names`.
        seed: the same seed gives the same frames to the bit.
        topology: name of the topology of the frames, such as ``kinect_v1``.
        bvh: a BVH file whose motion replaces one person's scenario; None for none.
        bvh_person: number of that person, from 1.
        bvh_metres_per_unit: the file's unit [m]; None scales its motion to the person's stature.

    Raises:
        SettingsError: an unknown scene or topology, or a number out of range.
        InputError: the BVH file cannot be used.
    """
    settings = dataclasses.replace(scene_settings(name), seed=seed, topology=topology)
    if bvh is not None:
        people = list(settings.people)
        check(1 <= bvh_person <= len(people), "bvh_person", bvh_person, f"from 1 to {len(people)}")
        i = bvh_person - 1
        people[i] = dataclasses.replace(people[i], bvh=str(bvh), bvh_metres_per_unit=bvh_metres_per_unit)
        settings = dataclasses.replace(settings, people=tuple(people))
    return build_room(settings)


@cache
def _data() -> dict[str, Any]:
    return own_toml("mocapella.sources.simulate", "data", "scenes.toml")
