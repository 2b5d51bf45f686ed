"""Former names of commands and options, with the present ones.

A command line that uses a former name ends with exit status 2 and one line that quotes the present name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

COMMANDS: Final[Mapping[str, str]] = {
    "align": "calibrate space",
    "arm": "track arm",
    "board": "calibrate board",
    "calibrate": "calibrate cameras",
    "colours": "calibrate colours",
    "depth": "lab depth",
    "evaluate": "lab evaluate",
    "hand": "calibrate hand",
    "hand measure": "calibrate hand",
    "silhouettes": "track silhouettes",
    "train": "lab train",
    "tune": "lab tune",
}
"""The present path of each command or group, by former path."""
CALIBRATIONS: Final = frozenset({"board", "cameras", "colours", "hand", "people", "space"})
"""Commands of the present group `calibrate`; before any other argument, `calibrate` is the former command."""

_NO_VIEW: Final = {"--headless": "--no-view"}
_CONTROLS: Final = {
    f"--{name}": f"--set {name.replace('-', '_')}={{}}"
    for name in ("fourcc", "exposure", "gain", "white-balance", "saturation", "contrast")
}
_NODE: Final = {"--loop": "--set loop=true", "--report": "--set report={}"}
OPTIONS: Final[Mapping[str, Mapping[str, str]]] = {
    "demo": {**_NO_VIEW, "--no-steadiness": "--set steadiness=false", "--corrupt": "--set corrupt={}"},
    "serve": {
        **_NO_VIEW,
        "--interface": "--host {}",
        "--view-port": "--set view_port={}",
        "--seconds": "--set seconds={}",
        "--takes": "--set takes={}",
        "--wait": "--set wait=true",
        "--reserve-gib": "--set reserve_gib={}",
        "--layout": "--set layout={}",
        "--save-layout": "--set save_layout={}",
        "--save-rig": "--set save_layout={}",
        "--hand": "--file hand={}",
        "--alignment": "--file alignment={}",
    },
    "replay": _NO_VIEW,
    "view": {"--port": "--view-port {}"},
    "node replay": {"--linger": "--set linger={}"},
    "node openvr": {"--hz": "--fps {}"},
    "node datagrams": {
        "--start": "--set start_to={}",
        "--start-text": "--set start_text={}",
        "--delay-ms": "--set delay_ms={}",
        "--sd-px": "--set sd_px={}",
        "--zero-is-lost": "--set zero_is_lost=true",
        "--by-host": "--set by_host=true",
    },
    "node arm": {
        **_NODE,
        "--publish-depth": "--set publish_depth=true",
        "--drop-after-ms": "--set drop_after_ms={}",
    },
    "node camera": {
        **_NODE,
        **{option: now for option, now in _CONTROLS.items() if option not in ("--saturation", "--contrast")},
        "--format": "--set format={}",
        "--quality": "--set quality={}",
        "--delay-ms": "--set delay_ms={}",
        "--linger": "--set linger={}",
    },
    "node markers": {
        **_NODE,
        **_CONTROLS,
        "--drop-after-ms": "--set drop_after_ms={}",
        "--timing": "--set timing={}",
    },
    "calibrate cameras": {"--intrinsics": "--rig {}"},
    "calibrate colours learn": {**_CONTROLS, "--background": "--empty {}"},
    "calibrate colours check": _CONTROLS,
    "calibrate hand": {
        "--base-height-mm": "--set base_height_mm={}",
        "--hand-length-mm": "--set hand_length_mm={}",
        "--lasting": "--set lasting={}",
        "--prepare": "--set prepare={}",
    },
    "calibrate space": {"--thing": "--object {}"},
    "track points": {
        "--method": "--solver {}",
        "--hz": "--fps {}",
        "--sd-px": "--set sd_px={}",
        "--least-confidence": "--set least_confidence={}",
        "--largest-error": "--set largest_error={}",
        "--order": "--set order={}",
    },
    "track silhouettes": {
        "--points": "--set points={}",
        "--model": "--set model={}",
        "--height": "--set height={}",
        "--hz": "--fps {}",
        "--other-size": "--set other_size={}",
        "--order": "--set order={}",
        "--live": "--set live=true",
        "--empty-room": "--set empty_room={}",
        "--late": "--set late={}",
        "--fourcc": "--set fourcc={}",
        "--no-steadiness": "--set steadiness=false",
        "--plot": "--set plot={}",
        "--beside": "--set beside={}",
        "--view-port": "--set view_port={}",
        "--no-browser": "--set browser=false",
    },
    "lab evaluate line-skeleton-grid": {"--sensor": "--depth-sensor {}"},
}
"""What to write for each former option, by present command and option; ``{}`` stands for the option's value."""


def moved(arguments: Sequence[str]) -> str:
    """Return the message that names the present form of a former command line; empty if it uses no former name.

    Args:
        arguments: the command line after the program's name.
    """
    path, rest = _former_path(arguments)
    now = COMMANDS.get(path, "")
    notes = [f"`mocapella {path}` is now `mocapella {now}`"] if now else []
    words = [*now.split(), *rest] if now else arguments
    notes += _moved_options(*_present_path(words))
    return "; ".join(notes)


def _former_path(arguments: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the longest former path that the command line begins with (empty if none), and the rest."""
    for length in (2, 1):
        path, rest = " ".join(arguments[:length]), arguments[length:]
        if path not in COMMANDS or len(arguments) < length:
            continue
        if path == "calibrate" and (not rest or rest[0] in CALIBRATIONS or rest[0] == "--help"):
            continue
        return path, rest
    return "", arguments


def _present_path(arguments: Sequence[str]) -> tuple[Mapping[str, str], Sequence[str]]:
    """Return the former options of the present command that the command line begins with, and the rest of the line."""
    for length in (3, 2, 1):
        path = " ".join(arguments[:length])
        if path in OPTIONS:
            return OPTIONS[path], arguments[length:]
    return {}, ()


def _moved_options(table: Mapping[str, str], words: Sequence[str]) -> list[str]:
    notes = []
    for k, word in enumerate(words):
        if word == "--":
            break
        option, equals, value = word.partition("=")
        if option not in table:
            continue
        now = table[option]
        if "{}" not in now:
            notes.append(f"`{option}` is now `{now}`")
            continue
        value = value if equals else "".join(words[k + 1 : k + 2])
        notes.append(f"`{option} {value}` is now `{now.format(value)}`")
    return notes
