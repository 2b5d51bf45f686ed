"""``mocapella calibrate space``: the pose of another tracker's space in the world of the cameras."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import calibrate_app
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    OUT_HELP,
    SPACE_HELP,
    Connect,
    JsonOut,
    check_out,
    console,
    say,
    seconds_option,
    working,
    write_json,
)
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.calibration.space_alignment import SpaceAlignmentSettings, SpaceFit
    from mocapella.calibration.space_observations import SpaceObservations
    from mocapella.live.align_guide import AlignGuideSettings
    from mocapella.recording.take_reader import Take


@calibrate_app.command("space")
def align(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help=f"{OUT_HELP} A TOML for serve --file alignment=FILE.", callback=check_out
        ),
    ],
    body: Annotated[str, typer.Option(metavar="NAME", help="The other tracker's name of the moved object.")],
    take: Annotated[
        Path | None,
        typer.Argument(metavar="TAKE", help="A take of the method hands; without it, live and guided."),
    ] = None,
    space: Annotated[
        str, typer.Option("--space", metavar="NAME", help=f"{SPACE_HELP} May be omitted if there is only one.")
    ] = "",
    marker: Annotated[str, typer.Option(metavar="NAME", help="Marker fixed on the object; or --object.")] = "",
    object_: Annotated[
        str, typer.Option("--object", metavar="NAME", help="The object, by its tags or markers; or --marker.")
    ] = "",
    vertical: Annotated[
        bool, typer.Option("--vertical", help="Both spaces have y up: one angle fewer to estimate.")
    ] = False,
    seconds: Annotated[float | None, seconds_option("At the latest, and without a take only; 60 s by default.")] = None,
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Calibrate the pose of another tracker's space (OSC, OpenVR) in the world of the cameras, and its latency.

    Fix a tag or a marker on the object that the other tracker follows, and run `serve --method hands` with both.
    Move the object for 20 s through all of the space that the cameras see, tilting and turning it about every axis.
    Live, the command prints every second which motion is missing, and ends when the estimate is good. For a take of
    such a motion, it prints at the end which motion was missing.

    Example:  mocapella calibrate space --body LHR-1 --object wand --out vr.toml
    """
    from mocapella.calibration.space_alignment import SpaceAlignmentSettings
    from mocapella.calibration.space_observations import SpaceObservations
    from mocapella.live.align_guide import AlignGuideSettings
    from mocapella.model.space import SpaceAlignment, rows_of, save_space

    if take is not None and seconds is not None:
        raise SettingsError("--seconds is for the live way; a take is read whole")
    observations = SpaceObservations(body, space=space, thing=object_, marker=marker, source=take)
    settings = SpaceAlignmentSettings(vertical=vertical)
    if take is None:
        guide = AlignGuideSettings() if seconds is None else AlignGuideSettings(seconds=seconds)
        fit = _guided(observations, settings, guide, connect)
    else:
        fit = _of_take(take, observations, settings)
    space = observations.space
    alignment = SpaceAlignment(
        space, rows_of(fit.T_world_space), fit.delay_s, fit.position_sd_m, fit.rotation_sd_rad, fit.delay_sd_s
    )
    save_space(out, alignment)
    lever = [round(float(x), 4) for x in fit.lever_m[0]]
    write_json(
        json,
        {
            "space": space,
            "body": body,
            "out": str(out),
            "T_world_space": fit.T_world_space.tolist(),
            "lever_m": lever,
            **{name: getattr(fit, name) for name in fit.__struct_fields__ if name not in ("T_world_space", "lever_m")},
        },
    )
    say(
        f"{space}: known to {1e3 * fit.position_sd_m:.1f} mm and {math.degrees(fit.rotation_sd_rad):.2f}°; its poses "
        f"are {1e3 * fit.delay_s:.0f} ± {1e3 * fit.delay_sd_s:.0f} ms late; {1e3 * fit.residual_m:.1f} mm are left at "
        f"{fit.instants} instants, {fit.left_out} of them left out"
    )
    say(f"{object_ or marker} is at {lever} m of {body}, ± {1e3 * fit.lever_sd_m:.1f} mm")
    say(f"alignment saved to {out}: mocapella serve --method hands --file alignment={out}")


def _of_take(path: Path, observations: SpaceObservations, settings: SpaceAlignmentSettings) -> SpaceFit:
    from mocapella.recording.take_reader import read_take

    with working("reading …", status=INTERRUPTED):
        recorded: Take = read_take(path)
        observations.update(arrival.frame for arrival in recorded.arrivals())
        observations.update(scene for _, scene in recorded.scenes())
        return observations.align(settings)


def _guided(
    observations: SpaceObservations, settings: SpaceAlignmentSettings, guide: AlignGuideSettings, connect: str
) -> SpaceFit:
    from rich.text import Text

    from mocapella.live.align_guide import AlignGuide
    from mocapella.live.signals import interruptible
    from mocapella.wire.reader import Following
    from mocapella.wire.session import open_reader

    session = open_reader(connect)
    try:
        with interruptible(), console.status("") as line:
            shown = ""

            def show(text: str) -> None:
                nonlocal shown
                if console.is_terminal:
                    line.update(Text(text))
                elif text != shown:  # in a log, nothing can be replaced
                    say(text)
                shown = text

            return AlignGuide(Following(session).take, observations, guide, settings, say=say, show=show).run()
    except KeyboardInterrupt:
        say("stopped before the end; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    finally:
        session.close()  # type: ignore[no-untyped-call]
