"""``mocapella track arm``: arms and hands in recorded depth images."""

from __future__ import annotations

import csv
import statistics
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli.app import track_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import (
    RIG_HELP,
    AllPoints,
    JsonOut,
    console,
    need_cameras,
    say,
    telling_of_compiling,
    write_json,
)
from mocapella.cli.pictures import Fps
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.detectors.arm_gestures import WithGestures
    from mocapella.model.camera import Camera
    from mocapella.sources.depth_files import DepthRecording, RecordedDepth

_SHOWN_EVERY_S: Final = 0.2
_MOST_NAMED: Final = 5

Intrinsics = Annotated[
    str | None,
    typer.Option(
        "--intrinsics",
        metavar="F,CX,CY",
        help="Intrinsics in pixels, or FX,FY,CX,CY, then K1,K2,P1,P2,K3; if the source has none, or to correct them.",
    ),
]
Unit = Annotated[
    str | None,
    typer.Option(
        "--unit",
        metavar="METRES",
        help="Metres per depth unit, such as 0.001, or kinect-raw for a Kinect v1's 11-bit images.",
    ),
]
Rig = Annotated[
    str | None,
    typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} FILE:CAMERA chooses one; in place of --intrinsics."),
]
DEFAULT_DETECTOR: Final = "kinematic-arm"


def check_detector(name: str | None) -> str | None:
    """Return the name of a detector of arms if there is one; None for None. For ``help``, print the list and exit.

    Raises:
        SettingsError: no detector has this name.
    """
    from mocapella.detectors import arm_detector, arm_detectors

    if name == "help":
        known = arm_detectors()
        width = max(map(len, known))
        typer.echo("\n".join(f"{each:<{width}}  {detector.summary}" for each, detector in known.items()))
        raise typer.Exit
    return None if name is None else arm_detector(name).name


def _refuse_method(name: str | None) -> None:
    if name is not None:
        raise SettingsError(not_method(name))


def not_method(name: str) -> str:
    """Return the message that the former option ``--method NAME`` is now ``--detector NAME``."""
    from mocapella.detectors import RENAMED

    return f"--method {name}: the option is --detector now; write --detector {RENAMED.get(name, name)}"


Detector = Annotated[
    str,
    typer.Option(
        "--detector",
        metavar="NAME",
        help="Detector of arms; `--detector help` lists the detectors.",
        callback=check_detector,
    ),
]
RenamedMethod = Annotated[str | None, typer.Option("--method", metavar="NAME", hidden=True, callback=_refuse_method)]
Stages = Annotated[
    Path | None,
    typer.Option("--stages", metavar="FOLDER", help="Write images of the detector's stages, a folder for each image."),
]


def detector_keys(context: typer.Context) -> Iterator[str]:
    """Yield lines of ``--set help``: settings of the detector that ``--detector`` names before it, and of gestures."""
    from mocapella.detectors import arm_detector
    from mocapella.kinematics.gestures import GestureSettings

    name = str(context.params.get("detector", DEFAULT_DETECTOR))
    title = f"Settings of the detector {name} (of another: --detector NAME --set help):"
    yield from lines_of_dataclass(arm_detector(name).settings(), title)
    yield from lines_of_dataclass(GestureSettings, "Settings of the gestures, with every detector:", "gestures.")


@track_app.command("arm")
def arm(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH…",
            help="16-bit PNGs, folders of them, takes (TAKE, TAKE:SENSOR), or rendered:SCENE/SEED, of the scenes that "
            "`mocapella demo arm --scene help` lists.",
        ),
    ],
    intrinsics: Intrinsics = None,
    unit: Unit = None,
    rig: Rig = None,
    fps: Fps = None,
    detector: Detector = DEFAULT_DETECTOR,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, detector_keys)] = None,
    method: RenamedMethod = None,
    independent: Annotated[
        bool, typer.Option("--independent", help="Detect arms anew in each image: the images are no video.")
    ] = False,
    all_points: AllPoints = False,
    stages: Stages = None,
    table: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write a table: a row for each joint.")
    ] = None,
    json: JsonOut = None,
) -> None:
    """Find arms and hands in recorded depth images.

    docs/arms/recordings.md describes files, depth.toml and results. A camera is served by mocapella node arm. Whole
    bodies as lines: mocapella lab depth lines.

    Example:  mocapella track arm frames/ --intrinsics 476.0,313.7,242.8 --unit 0.000125 --json arms.json
    """
    need_cameras("track arm")
    from mocapella.cli import INTERRUPTED
    from mocapella.cli.depth_recordings import depth_options, depth_recordings
    from mocapella.detectors import arm_detectors, make_detector
    from mocapella.exports.arm_rows import table_rows
    from mocapella.live.signals import interruptible
    from mocapella.sources.depth_options import complete

    options = depth_options(intrinsics, unit, rig, fps)
    _, detector_settings = read_settings(NoKeys, settings_file, settings)
    found = []
    try:
        with interruptible(), telling_of_compiling(f"the detector {detector}"), ExitStack() as open_files:
            writer = None if table is None else _table(open_files, table)
            for recording in depth_recordings(paths, options):
                camera = complete(recording.state, recording.name)
                finds = make_detector(detector, camera, detector_settings, independent_s=0.0 if independent else None)
                if stages is not None and finds.stages is None:
                    able = ", ".join(name for name, known in arm_detectors().items() if known.stages is not None)
                    raise SettingsError(f"--stages: the detector {detector} has none; detectors that do: {able}")
                run = _Run(recording, camera, finds, stages, all_points)
                for row in run.rows():
                    if writer is not None:
                        writer.writerows(table_rows(recording.name, row))
                found.append(run)
    except KeyboardInterrupt:
        say("stopped before the end")
        raise typer.Exit(INTERRUPTED) from None
    write_json(json, {"detector": detector, "recordings": [run.result() for run in found]})
    for run in found:
        run.tell()


def _table(stack: ExitStack, path: Path) -> Any:
    from mocapella.exports.arm_rows import COLUMNS

    try:
        file = stack.enter_context(path.open("w", encoding="utf-8", newline=""))
    except OSError as error:
        raise SettingsError(f"--csv {path}: {error.strerror}; name a file in a folder that exists") from error
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    return writer


class _Run:
    """A detector over one recording."""

    def __init__(
        self, recording: DepthRecording, camera: Camera, detector: WithGestures, stages: Path | None, all_points: bool
    ) -> None:
        from mocapella.kinematics.arm_quality import ArmQualityMeter
        from mocapella.sources.depth_options import HandSizeCheck, UnitCheck

        unit_m = recording.state.unit_m
        assert unit_m is not None  # `complete` guarantees it
        self._unit_m, self._check = unit_m, UnitCheck(unit_m, recording.name)
        self._sizes = HandSizeCheck(camera.lens, camera.size_px, unit_m)
        self.recording, self.camera, self.detector = recording, camera, detector
        self._stages, self._all_points = stages, all_points
        self._rows: list[dict[str, Any]] = []
        self.counts: Counter[str] = Counter()
        self._took_s: list[float] = []
        self._reasons: Counter[str] = Counter()
        self._quality = ArmQualityMeter()

    def rows(self) -> Iterator[dict[str, Any]]:
        """Detect arms in one image after the other, and yield each image's row of the JSON.

        Raises:
            InputError: the unit cannot be right, or the images cannot be used.
        """
        from mocapella.conventions import NS_PER_S

        zero_ns, at_s, shown_s = None, -1.0, 0.0
        with console.status(f"{self.recording.name}: reading …") as status:
            for number, image in enumerate(self.recording.images()):
                zero_ns = image.time_ns if zero_ns is None else zero_ns
                # A camera that was started again has a new clock; a detector wants time to rise.
                at_s = max((image.time_ns - zero_ns) / NS_PER_S, at_s + 1e-3 if number else 0.0)
                row = self._row(image, at_s)
                self._rows.append(row)
                self._reasons.update([row["reason"]] if row["reason"] else [])
                yield row
                if time.monotonic() > shown_s + _SHOWN_EVERY_S:
                    shown_s = time.monotonic()
                    name = self.recording.name.replace("[", "(")
                    status.update(f"{name}: image {number + 1} of {self.recording.count} …")

    def _row(self, image: RecordedDepth, at_s: float) -> dict[str, Any]:
        import numpy as np

        from mocapella.exports.arm_rows import frame_row
        from mocapella.model.arms import SeenArms

        self.counts["images"] += 1
        if image.depth is None:
            self.counts["damaged"] += 1
            found = SeenArms((), image.problem)
        else:
            self._check.update(image.depth)
            empty = not image.depth.any()
            self.counts["empty"] += empty
            metres = image.depth * np.float32(self._unit_m)
            begin_s = time.perf_counter()
            found = self.detector.update(metres, at_s)
            self._took_s.append(time.perf_counter() - begin_s)
            if empty and not found.reason:
                found = SeenArms(found.arms, "nothing was measured in the whole image")
            if self._stages is not None:
                self._write_stages(metres, image.file)
        self._quality.update(found.arms, at_s)
        self._sizes.update(found.arms)
        self.counts["with_arms"] += bool(found.arms)
        self.counts["arms"] += len(found.arms)
        return frame_row(image.file, at_s, found, self.camera.lens, all_points=self._all_points)

    def _write_stages(self, metres: Any, file: str) -> None:
        from mocapella.cli.depth_recordings import write_stages

        assert self._stages is not None
        assert self.detector.stages is not None  # `arm` guarantees it
        write_stages(self._stages, self.counts["images"] - 1, file, self.detector.stages(metres))

    def _problems(self) -> list[str]:
        """Return problems of the recording, and doubts about its intrinsics and unit."""
        doubt = self._sizes.problem if self.counts["with_arms"] else self._check.doubt(self.camera)
        return [*self.recording.state.problems, *([doubt] if doubt else [])]

    def result(self) -> dict[str, Any]:
        """Return the recording's part of the JSON."""
        return {
            "recording": self.recording.name,
            "size_px": list(self.camera.size_px),
            "lens": self.camera.lens.tolist(),
            "unit_m": self._unit_m,
            "counts": {name: self.counts[name] for name in ("images", "with_arms", "arms", "empty", "damaged")},
            "median_ms": round(1e3 * statistics.median(self._took_s), 3) if self._took_s else None,
            "quality": self._quality.quality.as_json(),
            "problems": self._problems(),
            "frames": self._rows,
        }

    def _arms_in_words(self) -> str:
        """Describe the tracked arms by side, and the images of each gesture."""
        sides: dict[int, Counter[str]] = {}
        gestures: Counter[str] = Counter()
        for arm in (arm for row in self._rows for arm in row["arms"]):
            sides.setdefault(arm["id"], Counter())[arm["handedness"]] += 1
            gestures.update([arm["gesture"]] if arm["gesture"] else [])
        if not sides:
            return ""
        of_side = Counter(counts.most_common(1)[0][0] for counts in sides.values())
        of_side["of unknown side"] = of_side.pop("unknown", 0)
        told = ", ".join(f"{number} {side}" for side, number in of_side.most_common() if number)
        seen = ", ".join(f"{gesture} {number}" for gesture, number in gestures.most_common())
        return f"; arms: {told}{f'; gestures: {seen}' if seen else ''}"

    def tell(self) -> None:
        """Print the counts, the problems, and the most frequent reasons for images without arms."""
        n = self.counts
        lacking = [f"{n[name]} {words}" for name, words in
                   (("empty", "with nothing measured"), ("damaged", "damaged")) if n[name]]  # fmt: skip
        said = f"; {', '.join(lacking)}" if lacking else ""
        say(f"{self.recording.name}: arms in {n['with_arms']} of {n['images']} images{said}{self._arms_in_words()}")
        for problem in self._problems():
            say(f"{self.recording.name}: {problem}")
        for reason, count in self._reasons.most_common(_MOST_NAMED):
            say(f"  {count} times: {reason}")
