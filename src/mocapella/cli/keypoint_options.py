"""Options that name a keypoint detector and its model, and the detector that they name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli.command_settings import lines_of_dataclass
from mocapella.cli.common import need_cameras
from mocapella.errors import InputError

if TYPE_CHECKING:
    from mocapella.detectors.keypoint_detector import PeopleDetector

DEFAULT_KEYPOINTS: Final = "mediapipe"


def _list_detectors(name: str | None) -> str | None:
    """Return the name of a keypoint detector; for ``help``, list all, and exit."""
    if name == "help":
        from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS

        for one in KEYPOINT_DETECTORS.values():
            missing = one.missing()
            typer.echo(f"{one.name}: {one.summary}" + (f"\n    {missing}" if missing else ""))
        raise typer.Exit
    return name


KeypointDetectorName = Annotated[
    str | None,
    typer.Option(
        "--detector",
        metavar="NAME",
        help="Detector of keypoints; `--detector help` lists the detectors.",
        show_default=False,
        callback=_list_detectors,
    ),
]
ModelFile = Annotated[
    Path | None,
    typer.Option("--model", metavar="FILE", help="The detector's model: an ONNX file, or a .task of MediaPipe."),
]


def detector_keys(context: typer.Context) -> Iterator[str]:
    """Yield lines of ``--set help``: settings of the detector that ``--detector`` names before it."""
    from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS

    name = str(context.params.get("detector") or DEFAULT_KEYPOINTS)
    title = f"Settings of the detector {name} (of another: --detector NAME --set help):"
    yield from lines_of_dataclass(KEYPOINT_DETECTORS.find(name).settings(), title)


def opened_detector(verb: str, name: str | None, model: Path | None, settings: Mapping[str, Any]) -> PeopleDetector:
    """Make the keypoint detector of a command's options.

    Args:
        verb: the command, for an error.
        name: name of the detector; None for the default.
        model: the model's file; None without.
        settings: the detector's settings by name, as texts of ``--set``.

    Raises:
        SettingsError, InputError: as in `mocapella.detectors.keypoint_detector.make_keypoint_detector`.
    """
    need_cameras(verb)
    from mocapella.detectors.keypoint_detector import make_keypoint_detector

    try:
        return make_keypoint_detector(name or DEFAULT_KEYPOINTS, settings, model)
    except ImportError as error:
        raise InputError(f"the detector {name or DEFAULT_KEYPOINTS} cannot be loaded ({error})") from error
