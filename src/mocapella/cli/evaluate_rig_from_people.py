"""``mocapella lab evaluate rig-from-people``: cameras calibrated by people, against the true ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import RIG_HELP, JsonOut, console, participant_numbers, say, seconds_option, write_json
from mocapella.cli.evaluate import Seeds
from mocapella.cli.pictures import Fps
from mocapella.errors import CalibrationError, SettingsError

if TYPE_CHECKING:
    from mocapella.evaluation.rig_from_people import RigErrorRow


LENSES: Final = {(True, False): "given", (False, False): "found", (False, True): "alike"}
"""Names of the knowledge about lenses: given or not, and stated to be of one model or not."""


@evaluate_app.command("rig-from-people")
def rig_from_people(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILES…]", help="Keypoint files of cameras with a known rig; a simulation without."),
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} The truth of FILES.")] = None,
    fps: Fps = None,
    seeds: Seeds = "0,1,2",
    seconds: Annotated[float | None, seconds_option("Of the simulation; 30 s by default.")] = None,
    json: JsonOut = None,
) -> None:
    """Calibrate cameras from people, with lenses that are given, unknown, or of one model, and print the errors.

    Without FILES, two simulated people walk for 30 s before four cameras, with a detector's measured errors.

    Example:  mocapella lab evaluate rig-from-people --seeds 0,1,2,3
    """
    import msgspec

    from mocapella.evaluation.rig_from_people import run_frames, run_scene
    from mocapella.library.people_calibration import detected_frames
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.detection_files import read_detections

    rows: list[RigErrorRow] = []
    duration = {} if seconds is None else {"seconds": seconds}
    with console.status("calibrating …"):
        for lenses, same in ((True, False), (False, False), (False, True)):
            try:
                if not files:
                    for seed in participant_numbers(seeds, "--seeds") or []:
                        rows.append(run_scene("two-walk", seed, lenses=lenses, same_lenses=same, **duration))
                    continue
                if rig is None:
                    raise SettingsError("the errors of FILES need a true rig: give it with --rig")
                true = load_camera_rig(rig)
                frames = detected_frames(read_detections(files), true, None, fps)
                name = files[0].parent.name
                rows.append(run_frames(frames, true, name, lenses=lenses, same_lenses=same, every_s=0.05))
            except CalibrationError as error:
                say(str(error))
    write_json(json, {"rows": msgspec.to_builtins(rows)})
    if json != "-":
        show_rig_errors(rows, Console(highlight=False))


def show_rig_errors(rows: Sequence[RigErrorRow], out: Console) -> None:
    """Print the rows of `mocapella.evaluation.rig_from_people` as one table."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in (
        "", "lenses", "place\nmm", "turn\n°", "focal\n%", "clock\nms", "scale", "NEES", "stated/\nbound",
        "shift\npx", "good",
    ):  # fmt: skip
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for row in rows:
        table.add_row(
            f"{row.name[-8:]} {row.seed}", LENSES[row.lenses, row.same_lenses], f"{row.position_mm:.1f}",
            f"{row.direction_deg:.2f}", f"{row.focal_percent:.1f}", f"{row.clock_ms:.1f}", f"{row.stature_scale:.3f}",
            f"{row.nees:.2f}", f"{row.stated_mm:.0f}/{row.bound_mm:.0f}", f"{row.shift_px:.1f}",
            "yes" if row.good else "no",
        )  # fmt: skip
    out.print(table)
    out.print("worst camera of each rig, after the best rigid motion, with the true distance of two cameras as scale")
    out.print("alike: unknown lenses that are stated to be of one model (same_lenses)")
    out.print("scale: true scale by that of the people's stature")
    out.print("stated/bound: standard deviation of the worst position in mm, and the least that any estimate has")
    out.print("if the errors of keypoints are independent (Cramér–Rao)")
    out.print("shift: of a whole person in a camera against the true rig; ten pixels are an error of the true rig")
