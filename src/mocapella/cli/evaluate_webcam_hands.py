"""``mocapella lab evaluate webcam-hands``: score the hands of the method webcams in simulations and on a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, read_settings, set_option
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Recordings, Scenes, Seeds, figure_text, scene_table, show_scenes, split_names
from mocapella.cli.evaluate_webcams import webcams_keys

_WHO: Final = {
    "found_percent": "found\n%",
    "phantoms_percent": "phantoms\n%",
    "side_percent": "side\n%",
    "ids": "new\nids",
    "measured_percent": "measured\n%",
    "false_percent": "false\n%",
}
_WHERE: Final = {
    "median_mm": "median\nmm",
    "p95_mm": "95 %\nmm",
    "tips_mm": "tips\nmm",
    "alone_mm": "alone\nmm",
    "jitter_mm": "jitter\nmm",
    "normalised": "error\n/ sd",
}
_CLIP: Final = {
    "instants": "instants",
    "detected_percent": "both cameras detect a hand, %",
    "followed_percent": "followed, %",
    "ids": "ids",
    "measured_percent": "landmarks measured, %",
    "bones_percent": "scatter of the detections' bones, %",
    "seen_px": "from detections, median, px",
    "seen_percent": "the same, % of the hand",
    "withheld_px": "from withheld detections, median, px",
    "withheld_percent": "the same, % of the hand",
    "withheld_p95_percent": "the same, 95 %, % of the hand",
    "jitter_mm": "jitter, mm",
    "detections_jitter_mm": "jitter of the detections, mm",
}


@evaluate_app.command("webcam-hands")
def webcam_hands(
    scenes: Scenes = None,
    seeds: Seeds = "0",
    data: Recordings = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, webcams_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Score the hands of the method webcams: simulated ones against exact truth, a recorded one for consistency.

    docs/evaluation.md says how everything is scored. The recording needs MediaPipe, and has no reference.

    Example:  mocapella lab evaluate webcam-hands --scenes fist,crossed-arms --seeds 0,1 --json out.json
    """
    from mocapella.evaluation.study_tables import rounded
    from mocapella.evaluation.webcam_hands import evaluate
    from mocapella.sources.simulate.hand_keypoints import hand_keypoint_scenes

    if scenes == "help":
        show_scenes(hand_keypoint_scenes())
        return
    chosen = read_settings(NoKeys, settings_file, settings)[1]
    with console.status("making hands …") as status:
        result = evaluate(
            None if scenes is None else split_names(scenes), participant_numbers(seeds, "--seeds") or [], chosen,
            lambda text: status.update(f"scoring {text} …"),
        )  # fmt: skip
        if data is not None:
            result["clip"] = _clip(data, chosen, lambda text: status.update(f"detecting in {text} …"))
    result = rounded(result)
    write_json(json, result)
    if json != "-":
        show_webcam_hands(result, Console())


def _clip(folder: Path, settings: Mapping[str, Any], tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the figures of the recording.

    Raises:
        SettingsError: MediaPipe is not installed, or a setting is unknown.
        InputError: a file of the recording is missing or has another format.
    """
    import msgspec

    from mocapella.detectors.mediapipe_hands import MEDIAPIPE_HANDS, HandDetectorSettings, MediaPipeHands
    from mocapella.errors import SettingsError
    from mocapella.evaluation.hand_clips import read_hand_clip, score_hand_clip
    from mocapella.settings import parse
    from mocapella.tracker.webcams_settings import WebcamsSettings

    if problem := MEDIAPIPE_HANDS.missing():
        raise SettingsError(f"--data: {problem}")
    own = parse(WebcamsSettings, settings, where="settings of webcams")
    clip = read_hand_clip(folder, lambda: MediaPipeHands(HandDetectorSettings()), tell)
    figures: dict[str, Any] = msgspec.to_builtins(score_hand_clip(clip, own))
    return figures


def show_webcam_hands(result: dict[str, Any], out: Console) -> None:
    """Print the result of `mocapella.evaluation.webcam_hands.evaluate`, with ``clip`` if there is one, as tables."""
    seeds = ", ".join(map(str, result["seeds"]))
    for columns in (_WHO, _WHERE):
        title = f"mean of seeds {seeds}" if columns is _WHO else None
        empty = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        out.print(scene_table(result["scenes"], columns, empty))
    out.print(
        "found, median, 95 %, tips, jitter: hands that two cameras see; alone: hands\n"
        "that one camera sees; side: the right one; false: measured landmarks more than\n"
        "25 mm off; error / sd: of measured landmarks, 1 is consistent; new ids: sum",
        highlight=False,
    )
    if "clip" in result:
        table = Table(title="recording, without a reference", title_justify="left", box=SIMPLE_HEAD, padding=0)
        table.add_column("")
        table.add_column("", justify="right")
        for figure, words in _CLIP.items():
            table.add_row(words, figure_text(result["clip"][figure]))
        out.print(table)
        out.print("The unit of its calibration is unknown: the palm is scaled to an average one.", highlight=False)
