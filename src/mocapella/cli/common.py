"""Parts that several commands share: options, addresses, and the output of results."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import logging
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer
from rich.console import Console
from rich.status import Status

from mocapella.cli.command_settings import KeySpec, lines_of_dataclass
from mocapella.errors import SettingsError, one_of, visible
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.model.session import RecordingHealth

T = TypeVar("T")

DEFAULT_PORT = 7447
PAGE_DRAWN: Final = "view: drawn in a browser"
"""Line that the command `view` prints when the first browser draws the view."""
WATCH_URL: Final = "view, to watch only: "
"""Beginning of the line with the view's URL for watchers."""
DEFAULT_VIEW_PORT = 7448
DEFAULT_TAKES = Path("takes")
DEFAULT_SCENE: Final = "obstacle"
SECONDS_HELP: Final = "Stop after this time."
SESSION_SECONDS: Final = "It begins after the compilation and includes the calibration; without it, at Ctrl-C."
DEFAULT_ADDRESS = f"tls/127.0.0.1:{DEFAULT_PORT}"

_LOG: Final = logging.getLogger("mocapella.cli")


class Terminal(Console):
    """Standard error; text for a terminal that has been closed is dropped, because the session goes on without it."""

    def on_broken_pipe(self) -> None:
        """Drop this text and later ones; Rich would end the program."""
        self.quiet = True


console = Terminal(stderr=True, highlight=False)
"""Console for messages to the user: standard error, because standard output is for results."""


def _check_json(target: str | None) -> str | None:
    """Check, before any work is done, that the result file of ``--json`` can be written; return the option's value."""
    if target is None or target == "-":
        return target
    path, problem = Path(target), ""
    if path.is_dir():
        problem = "it is a folder"
    elif not path.parent.is_dir():
        problem = f"there is no folder {path.parent}"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        problem = "it cannot be written to"
    if problem:
        raise SettingsError(
            f"--json {target}: {problem}; name a file in a folder that exists, or - for standard output"
        )
    return target


def check_out(path: Path) -> Path:
    """Check, before any work is done, that ``--out`` names a file that can be made or replaced; return its path.

    Raises:
        SettingsError: the path is a folder, or its folder does not exist or cannot be written to.
    """
    folder, problem = path.parent, ""
    if path.is_dir():
        problem = "it is a folder"
    elif not folder.is_dir():
        problem = f"there is no folder {folder}"
    elif not os.access(folder, os.W_OK | os.X_OK):  # an existing file is replaced by a new one
        problem = f"{folder} cannot be written to"
    if problem:
        raise SettingsError(f"--out {path}: {problem}; name a file in a folder that exists and that you may write to")
    return path


def seconds_option(detail: str) -> Any:
    """Return the typer option ``--seconds`` of a command, a number above 0; ``detail`` ends its help."""

    def check_seconds(value: float | None) -> float | None:
        valid = value is None or 0 < value < math.inf
        check(valid, "--seconds", value, "a number of seconds above 0, such as 30")
        return value

    return typer.Option("--seconds", metavar="SECONDS", help=f"{SECONDS_HELP} {detail}", callback=check_seconds)


def _list_methods(name: str) -> str:
    """Return the name of a tracking method; for ``help``, list all with their frames, results and exports, and exit."""
    if name == "help":
        from mocapella.exports.export import exports_of
        from mocapella.model.frame_types import FRAME_TYPES
        from mocapella.tracker.method import METHODS

        for method in METHODS.values():
            takes = [each.name for each in FRAME_TYPES.values() if each.type in method.frame_types]
            typer.echo(
                f"{method.name}: {method.summary}\n    frames: {', '.join(takes)}; results: {', '.join(method.parts)}; "
                f"exports: {', '.join(exports_of(method.parts))}"
            )
        raise typer.Exit
    return name


def method_option(detail: str = "") -> Any:
    """Return the typer option ``--method`` of a command; ``detail`` ends its help."""
    meaning = f"Tracking method; `--method help` lists them. {detail}".rstrip()
    return typer.Option("--method", metavar="NAME", help=meaning, callback=_list_methods)


def check_scene(name: str) -> str:
    """Return the name of a simulated scene, or the path of a scene file, if it is known; ``help`` lists the scenes.

    Raises:
        SettingsError: no scene has this name; lists the known ones.
        InputError: the scene file cannot be read.
    """
    from mocapella.sources.simulate import scene_settings, scene_summaries
    from mocapella.sources.simulate.scenes import is_scene_file

    if is_scene_file(name):
        scene_settings(name)
        return name

    scenes = scene_summaries()
    width = max(map(len, scenes)) + 2
    lines = [f"{scene:<{width}}{what}" for scene, what in scenes.items()]
    if name == "help":
        typer.echo("\n".join(lines))
        raise typer.Exit
    if name not in scenes:
        known = one_of(name, scenes)
        raise SettingsError(f"unknown scene {name!r}; known: {known}; `--scene help` describes them")
    return name


Connect = Annotated[
    str,
    typer.Option(
        "--connect",
        metavar="ADDRESS",
        help="Address of the server: [SESSION@]tls/HOST:PORT; or a file of `mocapella session invite`.",
        show_default=True,
    ),
]
JsonOut = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON to this file at the end; - is standard output.",
        callback=_check_json,
    ),
]
SceneName = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="NAME",
        help="Simulated scene; `--scene help` lists them. Or a scene file (TOML), such as of `mocapella plan`.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", metavar="NUMBER", help="Seed of the simulated noise.")]
Seconds = Annotated[float | None, seconds_option("Without it, at Ctrl-C.")]
View = Annotated[
    bool,
    typer.Option(
        "--view/--no-view",
        help="Serve the live view, whose URL is printed; by default if tracking is live.",
        show_default=False,
    ),
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Print the view's URL, open no browser.")]
TakeArgument = Annotated[Path, typer.Argument(metavar="TAKE", help="A take: a file, or its name without .mcap.")]
BusPort = Annotated[
    int,
    typer.Option("--port", metavar="PORT", min=1, max=65535, help="TCP port of the bus, where sensors connect."),
]
ViewPort = Annotated[
    int,
    typer.Option("--view-port", metavar="PORT", min=1, max=65535, help="TCP port of the live view."),
]
HOST_HELP: Final = "Network interface to listen on; 127.0.0.1 is this machine only, 0.0.0.0 is all interfaces."
Host = Annotated[str, typer.Option("--host", metavar="HOST", help=HOST_HELP)]
RIG_HELP: Final = "Camera rig of `mocapella calibrate cameras`, or another program's calibration."
UP_HELP: Final = "Up axis of the rig's world: y, z or -y; results have y up."
START_FORM: Final = "[PERSON=]FILE[:FRAME]"
START_HELP: Final = (
    "First poses of the bodies: JSON of named joints [m] of one or several people, or an earlier result of `mocapella "
    "track silhouettes`. Repeatable."
)
SPACE_HELP: Final = "Name of the other tracker's coordinate space."
PLOT_HELP: Final = "Draw a plot; needs matplotlib."


People = Annotated[
    str | None,
    typer.Option("--people", metavar="NAME,NAME,…", help="Individuals to take, such as person_0; all by default."),
]


def individual_names(people: str | None) -> tuple[str, ...]:
    """Return the names of ``--people``, each once; none if it is not given.

    Raises:
        SettingsError: it is given and has no name.
    """
    names = tuple(dict.fromkeys(name.strip() for name in (people or "").split(",") if name.strip()))
    if people is not None and not names:
        raise SettingsError("--people has no name; write names with commas, such as person_0,anna")
    return names


def drawable(plot: Path | None) -> Path | None:
    """Return a plot's file, None for none, unchanged; called before any work.

    Raises:
        SettingsError: a plot cannot be written there, see `mocapella.evaluation.plots.check_plot`.
    """
    if plot is not None:
        from mocapella.evaluation.plots import check_plot

        check_plot(plot)
    return plot


Plot = Annotated[Path | None, typer.Option("--plot", metavar="FILE", help=PLOT_HELP, callback=drawable)]
StudyFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the KinectMultiTrack study logs.")]
LAYOUT: Final = KeySpec(
    "Begin from this sensor layout (JSON), which is checked against people's motion; default, arms.", "file"
)
ORDER: Final = KeySpec(
    "Order of keypoints without names; auto: by their number and places.",
    choices=("auto", "BODY_25B", "BODY_25", "COCO_17", "COCO_18", "HALPE_26", "HALPE_136", "COCO_133", "BLAZEPOSE"),
)
FrameChoice = Annotated[
    str | None, typer.Option("--frames", metavar="odd|even|FROM:TO:STEP", help="Frames to use; all by default.")
]
PLACEMENT_HELP: Final = "Sensor placement of the study log, such as right-90."
Placement = Annotated[
    str | None,
    typer.Option("--placement", metavar="NAME", help=f"{PLACEMENT_HELP} For study logs only."),
]
RecordTo = Annotated[
    str | None,
    typer.Option(
        "--record",
        metavar="TAKE",
        help="Record a take from the start: a name in the folder takes, or a path such as ./walk-1.",
    ),
]
AllPoints = Annotated[
    bool, typer.Option("--all-points", help="All 23 points of an arm (21 hand landmarks, palm, elbow), not 8 joints.")
]
Every = Annotated[int, typer.Option("--every", metavar="N", min=1, help="Write every n-th result only.")]
OUT_HELP: Final = "File to write; an existing file is replaced."


Method = Annotated[str, method_option()]
SensorsExpected = Annotated[
    int,
    typer.Option("--sensors", metavar="NUMBER", min=1, help="Number of sensors to wait for before calibrating."),
]
Participants = Annotated[
    str | None,
    typer.Option(
        "--participants", metavar="P,P,…", help="Numbers of the participants to use, such as 0,1,20; all by default."
    ),
]


def method_keys(context: typer.Context) -> Iterator[str]:
    """Yield lines of ``--set help``: settings of the tracking method that ``--method`` names before it."""
    from mocapella.tracker.method import METHODS

    name = str(context.params.get("method", "default"))
    yield from lines_of_dataclass(
        METHODS.find(name).settings, f"Settings of the method {name} (of another: --method NAME --set help):"
    )


def method_setting_names(name: str) -> list[str]:
    """Return the names of a tracking method's settings.

    Raises:
        SettingsError: no method has this name.
    """
    from mocapella.tracker.method import METHODS

    return [field.name for field in dataclasses.fields(METHODS.find(name).settings)]


def chosen(context: typer.Context, name: str, value: T) -> T | None:
    """Return an option's value if the command line gives it, or None for a default.

    Args:
        context: context of the command.
        name: name of the command's parameter.
        value: value of the parameter.
    """
    source = context.get_parameter_source(name)
    return value if source is not None and source.name == "COMMANDLINE" else None


def participant_numbers(text: str | None, option: str = "--participants") -> list[int] | None:
    """Parse participants' numbers such as ``0,1,20``; return None if the option is not given.

    Args:
        text: the option's value; None if it is not given.
        option: name of the option, for errors.

    Raises:
        SettingsError: the text has another form.
    """
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise SettingsError(f"{option} {text!r} cannot be used; write numbers with commas, such as 0,1,20")
    return [int(part) for part in parts]


def need_cameras(what: str) -> None:
    """Check that OpenCV is installed, which ``what`` needs, such as ``demo arm``.

    Raises:
        SettingsError: OpenCV is missing; the message names the extra of the package that contains it.
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # its warnings repeat our errors in words of its own
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if importlib.util.find_spec("cv2") is None:
        raise SettingsError(f"{what} needs OpenCV: uv sync --extra cameras (elsewhere: install 'mocapella[cameras]')")


def warn_if_open(what: str, host: str, port: int) -> None:
    """Print a warning if other machines can connect to a service at ``host`` and ``port``.

    ``what`` is the subject and verb of the warning, such as ``the view is``.
    """
    from mocapella.wire.address import is_loopback

    if not is_loopback(f"tls/{host}:{port}"):
        say(f"WARNING: {what} open to everyone who can reach {host}:{port}")


def recording_row(take: RecordingHealth) -> dict[str, Any] | None:
    """Return a take's final state as a JSON object for ``--json``; None if nothing was recorded."""
    if not take.path:
        return None
    return {
        "path": take.path,
        "frames": take.frames,
        "scenes": take.scenes,
        "lost": take.lost,
        "size_bytes": take.size_bytes,
        "seconds": take.seconds,
        "problem": take.problem,
        "unknown": [dataclasses.asdict(end) for end in take.unknown],
    }


def exit_by(recording: dict[str, Any] | None) -> None:
    """Exit with status 1 if the recording, a result of `recording_row`, has a problem."""
    if recording is not None and recording["problem"]:
        raise typer.Exit(1)


@contextmanager
def working(text: str, *, status: int) -> Iterator[Status]:
    """Show ``text`` while the context is active; Ctrl-C meanwhile ends the command with exit status ``status``.

    The value of the context shows another text with its method ``update``.
    """
    from mocapella.live.signals import interruptible

    try:
        with interruptible(), console.status(text) as shown:
            yield shown
    except KeyboardInterrupt:
        say("stopped before the end")
        raise typer.Exit(status) from None


def get_ready(method: str, *, status: int = 0) -> None:
    """Load a tracking method's compiled kernels; compile missing ones first, with a note on standard error.

    Args:
        method: name of the tracking method; an unknown one has no kernels.
        status: exit status of the command after Ctrl-C.

    Raises:
        typer.Exit: Ctrl-C was pressed meanwhile.
    """
    from mocapella.live.compilation import Compilation
    from mocapella.tracker import is_compiled, warm_up

    with working(f"loading the method {method} …", status=status) as shown:
        if is_compiled(method):
            return
        _tell_of_compiling(f"the method {method}")
        with Compilation(method) as compilation:
            compilation.wait(lambda: shown.update(f"compiling the method {method}: {compilation.progress}"))
        warm_up(method)


@contextmanager
def telling_of_compiling(what: str) -> Iterator[None]:
    """Print a note that ``what`` is being compiled if numba compiles a kernel while the context is active."""
    from mocapella.compiled import on_first_compilation

    with on_first_compilation(lambda: _tell_of_compiling(what)):
        yield


def _tell_of_compiling(what: str) -> None:
    say(f"compiling {what} for this machine: this once, for one to several minutes")


def take_file(path: Path) -> Path:
    """Return the path of a take's file: the suffix .mcap is added if it is missing.

    Raises:
        RecordingError: the name is no valid name of a take.
    """
    from mocapella.recording.disk import take_path

    return take_path(path.parent, path.name)


def record_file(text: str, takes: Path = DEFAULT_TAKES) -> Path:
    """Return the path of the take that ``--record`` names.

    Args:
        text: the option's value; a name without a folder is a take in ``takes``.
        takes: folder of the takes, which is created if it is used.

    Raises:
        RecordingError: the name is no valid name of a take, or the folder cannot be created.
    """
    from mocapella.recording.disk import ensure_folder

    if Path(text).name != text:
        return take_file(Path(text))
    path = take_file(takes / text)
    ensure_folder(takes)
    return path


def say(text: str) -> None:
    """Print a line to the user on standard error, and write it to the log."""
    _LOG.info("%s", text)
    show(text)


def show(text: str) -> None:
    """Print a line to the user on standard error, without wrapping, and with escape sequences made visible."""
    with suppress(OSError):  # a terminal that hung up, or a file on a full disk
        console.print(visible(text, keep="\n\t"), markup=False, soft_wrap=True)


def say_if_never_tracked(summary: dict[str, Any], of: str = "") -> None:
    """Print the reason if a run has received frames and never tracked anything.

    Args:
        summary: summary of the run, with ``frames_in`` and ``never_tracked``, the reason.
        of: prefix of the line, such as the file's name and a colon.
    """
    if summary["frames_in"] and summary["never_tracked"]:
        say(f"{of}nobody was tracked: {summary['never_tracked']}")


def write_json(target: str | None, value: Any) -> None:
    """Write a result as JSON to the target of ``--json``: a file, or ``-`` for standard output; None writes nothing.

    Raises:
        SettingsError: the file cannot be written.
    """
    if target is None:
        return
    text = json.dumps(value, indent=2, ensure_ascii=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise SettingsError(f"--json {target}: {error.strerror}; name a file in a folder that exists") from error


def parse_size(text: str) -> tuple[int, int]:
    """Parse an image size such as ``640x480`` as (width, height) [px].

    Raises:
        SettingsError: the text has another form.
    """
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not all(side.isascii() and side.isdigit() and len(side) <= 5 for side in (width, height)):
        raise SettingsError(f"--size {text!r} cannot be used; write it as 640x480")
    return int(width), int(height)


def most_of(summary: Mapping[str, Any]) -> str:
    """Return the largest numbers of simultaneously tracked parts, by type, as text such as ``most people: 2``.

    Args:
        summary: summary of a run, with ``most_people`` and so on for each type of scene part.
    """
    from mocapella.model.part_types import PART_TYPES

    counted = [name for name, kind in PART_TYPES.items() if kind.counted is not None]
    there = [name for name in counted if summary[f"most_{name}"]] or ["people"]
    return ", ".join(f"most {name}: {summary[f'most_{name}']}" for name in there)
