"""Read the files given to a method on the command line into settings, which a take stores for its replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from mocapella.calibration.sensor_layout import is_layout
from mocapella.decoding import read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.model.camera_rig_file import encode_camera_rig, load_camera_rig
from mocapella.model.hand_file import encode_hand_shape, load_hand_shape
from mocapella.model.space import as_settings, load_space
from mocapella.registry import load
from mocapella.settings import merged
from mocapella.tracker.method import METHODS


def settings_of_files(method: str, files: Mapping[str, Path | Sequence[Path] | None]) -> dict[str, Any]:
    """Read a tracking method's files, such as a camera rig, into settings, which a take stores for its replay.

    Args:
        method: name of the tracking method.
        files: one or several paths by the option's name, such as ``rig``; None or empty for options not given.

    Raises:
        SettingsError: the method does not use such a file; names the methods that do.
        InputError: a file cannot be used.
    """
    told: dict[str, Any] = {}
    for option, given in files.items():
        paths = [given] if isinstance(given, Path) else list(given or ())
        if not paths:
            continue
        readers = METHODS.find(method).files
        if option not in readers:
            able = [one.name for one in METHODS.values() if option in one.files]
            for other in able[:1]:
                load(METHODS[other].files[option])(paths)  # a fault of the file itself is raised first
            wanted = f"methods that do: {', '.join(able)}" if able else "no method does"
            name = f"--{option} {paths[0]}" if option in ("rig", "start") else f"--file {option}={paths[0]}"
            raise SettingsError(f"{name}: the method {method} wants no such file; {wanted}")
        told = merged(told, load(readers[option])(paths))
    return told


def settings_of_rig_for_recording(method: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings that use the clock offsets of a rig that is given for a recording.

    `mocapella calibrate people` states clocks on the times of the recording's frames. Live sessions have other clocks.

    Args:
        method: name of the tracking method.
        settings: settings of `settings_of_files`, and others.

    Returns:
        The settings, with ``rig_clocks`` where a rig is among them, the method has this setting, and none is given.
    """
    able = "rig_clocks" in {one.name for one in fields(METHODS.find(method).settings)}
    return {"rig_clocks": True, **settings} if able and "rig" in settings else dict(settings)


def camera_rig(paths: Sequence[Path]) -> dict[str, Any]:
    """Read a camera rig file into the setting ``rig``: its checked content, encoded as text again.

    ``paths`` is the list of the files given with the option; it must have one.

    Raises:
        InputError: the file cannot be used; if it is a sensor layout, the message names the setting for it, ``layout``.
        SettingsError: none or several are given.
    """
    path = _one(paths, "--rig")
    try:
        return {"rig": encode_camera_rig(load_camera_rig(path))}
    except InputError:
        if path.is_file() and is_layout(read_whole(path, fix="name a camera rig")):
            raise InputError("is a sensor layout", file=path, fix="use --set layout=FILE") from None
        raise


def bodies_rig(paths: Sequence[Path]) -> dict[str, Any]:
    """Read a camera rig file into the settings of bodies that are fitted beside body sensors: ``rig``, nested.

    ``paths`` must have one file. The result merges with the other settings of the method ``default``.

    Raises:
        InputError: the file cannot be used.
        SettingsError: none or several are given.
    """
    return {"bodies": {"silhouettes": camera_rig(paths)}}


def hand_shape(paths: Sequence[Path]) -> dict[str, Any]:
    """Read a hand file into the setting ``hand``: its text. ``paths`` must have one file.

    Raises:
        InputError: the file cannot be used.
        SettingsError: none or several are given.
    """
    return {"hand": encode_hand_shape(load_hand_shape(_one(paths, "--file hand"))).decode()}


def spaces(paths: Sequence[Path]) -> dict[str, Any]:
    """Read files of `mocapella calibrate space`, the poses of other trackers' frames, into the setting ``spaces``.

    ``paths`` may have any number of files, one for each space.

    Raises:
        InputError: a file cannot be used.
    """
    return {"spaces": [as_settings(load_space(path)) for path in paths]}


def _one(paths: Sequence[Path], option: str) -> Path:
    if len(paths) != 1:
        raise SettingsError(f"{option} is given {len(paths)} times; give it once")
    return paths[0]
