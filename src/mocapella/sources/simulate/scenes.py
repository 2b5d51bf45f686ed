"""Scenes by name, of ``data/scenes.toml``, or of a file: simulated rooms with people and sensors that see them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from mocapella.decoding import convert, decode_toml, own_toml, read_whole
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.settings import check, parse
from mocapella.sources.simulate.room import Room, SceneSettings, build_room


class _SceneFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The tables of a scene file."""

    sensors: dict[str, dict[str, Any]]
    scenes: dict[str, dict[str, Any]]


def scene_names() -> tuple[str, ...]:
    """Return the names that `load_scene` knows."""
    return tuple(_data()["scenes"])


def scene_summaries() -> dict[str, str]:
    """Return a one-line summary of each scene, by name."""
    return {name: scene["summary"] for name, scene in _data()["scenes"].items()}


def scene_settings(name: str) -> SceneSettings:
    """Look up a scene's settings by name, or read them from a file; change them with `dataclasses.replace`.

    Args:
        name: one of `scene_names`, or the path of a TOML file of one scene, such as that of `mocapella plan`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
        InputError: the file cannot be read, or has no such scene.
    """
    return read_scene(Path(name)) if is_scene_file(name) else settings_from(_data(), name)


def is_scene_file(name: str) -> bool:
    """Return whether the name of a scene is the path of a file."""
    return name.endswith(".toml")


def read_scene(path: Path) -> SceneSettings:
    """Read a scene file: tables ``sensors`` and ``scenes``, as in ``data/scenes.toml``, of one scene.

    Raises:
        InputError: the file cannot be read, is no TOML, or has no or several scenes or an invalid value.
    """
    fix = "write one with `mocapella plan room.toml --out FOLDER`"
    data = decode_toml(read_whole(path, fix=fix), file=path, fix=fix)
    found = convert(data, _SceneFile, what="scene file", file=path, fix=fix)
    if len(found.scenes) != 1:
        raise InputError(f"has {len(found.scenes)} scenes; a scene file has one", file=path, field="scenes", fix=fix)
    (name, scene), *_ = found.scenes.items()
    sensors = scene.get("sensors")
    known = isinstance(sensors, list) and all(isinstance(one, str) and one in found.sensors for one in sensors)
    if not known:
        what = "is no list of the names in the table sensors"
        raise InputError(what, file=path, field=f"scenes.{name}.sensors", value=sensors, fix=fix)
    try:
        return settings_from({"sensors": found.sensors, "scenes": found.scenes}, name)
    except SettingsError as error:
        raise InputError(str(error), file=path, fix=fix) from None


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
        name: one of `scene_names`, or the path of a scene file, see `read_scene`.
        seed: the same seed gives the same frames to the bit.
        topology: name of the topology of the frames, such as ``kinect_v1``.
        bvh: a BVH file whose motion replaces one person's scenario; None for none.
        bvh_person: number of that person, from 1.
        bvh_metres_per_unit: the file's unit [m]; None scales its motion to the person's stature.

    Raises:
        SettingsError: an unknown scene or topology, or a number out of range.
        InputError: the BVH file or the scene file cannot be used.
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
