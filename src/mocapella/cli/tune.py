"""``mocapella lab tune``: settings from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import tune_app
from mocapella.cli.common import JsonOut, say, working, write_json


@tune_app.callback()
def _tune() -> None:
    # Keeps `one-euro` a verb: without it typer takes a group's only command for the group itself.
    pass


@tune_app.command("one-euro")
def one_euro(
    still: Annotated[
        Path, typer.Argument(metavar="STILL.csv", help="Recording of markers at rest, two seconds or more.")
    ],
    fast: Annotated[Path, typer.Argument(metavar="FAST.csv", help="Recording of markers at their fastest.")],
    jitter: Annotated[
        float,
        typer.Option(metavar="MM|PX", help="Goal of step 1: RMS jitter at rest, in mm for 3D points, in px for 2D."),
    ],
    lag_ms: Annotated[float, typer.Option(metavar="MS", help="Goal of step 2: largest lag of fast motion.")],
    by_point: Annotated[
        bool, typer.Option("--by-point", help="Adapt the cut-off to the point's speed, not to each coordinate's.")
    ] = False,
    json: JsonOut = None,
) -> None:
    """Tune the 1-euro filter in two steps: at rest, lower the cutoff; in fast motion, raise beta.

    Both recordings are CSV of points in space or in one camera's picture; docs/triangulation.md describes them.

    Example:  mocapella lab tune one-euro still.csv fast.csv --jitter 0.3 --lag-ms 15
    """
    import msgspec

    from mocapella.errors import InputError
    from mocapella.recording.point_recordings import read_point_recording
    from mocapella.settings import check
    from mocapella.smoothing.one_euro import OneEuroSettings
    from mocapella.smoothing.one_euro_tuning import LONGEST_LAG_S, tune

    check(jitter > 0, "--jitter", jitter, "above 0")
    longest_ms = 1000 * LONGEST_LAG_S
    check(0 < lag_ms < longest_ms, "--lag-ms", lag_ms, f"above 0 and below {longest_ms:g} ms")
    at_rest, moving = read_point_recording(still), read_point_recording(fast)
    if at_rest.unit != moving.unit:
        raise InputError(f"in {moving.unit}, and {still} in {at_rest.unit}", file=fast, fix="give two of one kind")
    scale, unit = (1000.0, "mm") if at_rest.unit == "m" else (1.0, "px")
    with working("tuning …", status=INTERRUPTED):
        settings = OneEuroSettings(per_component=not by_point)
        tuned = tune(
            (at_rest.at_s, at_rest.points), (moving.at_s, moving.points), jitter / scale, lag_ms / 1000, settings
        )
    s = tuned.settings
    say(f"step 1, at rest: jitter {scale * tuned.raw_jitter:.3f} {unit} without a filter")
    cutoff = f"minimum cutoff {s.min_cutoff_hz:.4g} Hz, beta 0"
    say(f"  {cutoff}: {scale * tuned.jitter_at_rest:.3f} {unit}, {_goal(tuned.jitter_reached)}")
    say(f"step 2, in motion: {1000 * tuned.lag_without_beta_s:.1f} ms late with beta 0")
    say(f"  beta {s.beta_per_m:.4g} Hz/({at_rest.unit}/s): {1000 * tuned.lag_s:.1f} ms, {_goal(tuned.lag_reached)}")
    say(f"with both: jitter at rest {scale * tuned.jitter:.3f} {unit}")
    write_json(json, {**msgspec.to_builtins(tuned), "unit": at_rest.unit})
    if not (tuned.jitter_reached and tuned.lag_reached):
        say("a goal was not reached: record more steadily or with more frames a second, or allow more")
        raise typer.Exit(1)


def _goal(reached: bool) -> str:
    return "as wished" if reached else "NOT as wished"
