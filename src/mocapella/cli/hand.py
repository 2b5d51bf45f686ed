"""``mocapella calibrate hand``: measure a person's hand from a gesture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli.app import calibrate_app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    OUT_HELP,
    RIG_HELP,
    Connect,
    JsonOut,
    check_out,
    console,
    say,
    write_json,
)
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.kinematics.hand_bones import Bones
    from mocapella.kinematics.hand_gesture import GesturePoints, PhaseSpan
    from mocapella.model.hand import HandModel, HandShape
    from mocapella.model.scene import Scene
    from mocapella.recording.take_reader import Take

_PROPORTIONED: Final = ("thumb",)
"""Digits that the gesture does not measure; their bones are scaled in proportion to the fingers."""


@dataclass(frozen=True)
class HandKeys:
    """Settings of `calibrate hand`."""

    base_height_mm: Annotated[
        float, KeySpec("Height of the base's markers above the joints; negative: on the palm side.", "mm", -50, 50)
    ] = -12.5
    hand_length_mm: Annotated[
        float | None, KeySpec("Approximate length from wrist to tip of the middle finger; average if not given.", "mm")
    ] = None
    lasting: Annotated[str, KeySpec("Live: durations of the parts flat, knuckles and hook.", "S,S,S")] = "4,6,6"
    prepare: Annotated[float, KeySpec("Live: pause before each part.", "s", least=0)] = 3.0


@calibrate_app.command("hand")
def measure(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help=f"{OUT_HELP} The hand, for serve --file hand=FILE.", callback=check_out
        ),
    ],
    take: Annotated[
        Path | None, typer.Argument(metavar="TAKE", help="A take of the gesture; without it, live and guided.")
    ] = None,
    left: Annotated[bool, typer.Option("--left/--right", help="Which hand.")] = False,
    person: Annotated[str, typer.Option(metavar="NAME", help="Name of the person.")] = "",
    phases: Annotated[
        str | None,
        typer.Option(
            metavar="PART=FROM:TO,…",
            help="When each part is shown in the take, in its seconds: flat=0:4,knuckles=4:10,hook=10:16.",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} Of a take: track its marker frames again with it."),
    ] = None,
    tips: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME,…",
            help="Markers on the tips of thumb, index, middle, ring and little finger.",
            show_default=False,
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME,…",
            help="Three or four markers on the base: wrist, knuckles of index, little and middle finger; by default "
            "as in the take.",
        ),
    ] = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(HandKeys)] = None,
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Measure a person's finger bones from a short gesture, with three markers or more on the base of the hand.

    Three parts: the flat hand; straight fingers that bend at the knuckles; knuckles straight and fingers that curl.
    Live, it prints the instructions and the missing parts. The server runs with the same markers:
    mocapella serve --method hands --rig RIG.toml --set 'base=["cyan","white","orange"]'

    Example:  mocapella calibrate hand --base cyan,white,orange --right --person Ada --out ada.json
    """  # fmt: skip
    from mocapella.kinematics.hand_gesture import GesturePoints, spans_of_text
    from mocapella.kinematics.hand_tracker import base_layout
    from mocapella.model.hand import hand_model
    from mocapella.model.hand_file import save_hand_shape

    _check_inputs(take, phases, rig)
    spans = None if phases is None else spans_of_text(phases)
    recorded = None if take is None else _recorded(take)
    gesture = GesturePoints(*_names(recorded, tips, base))
    keys = read_keys(HandKeys, settings_file, settings)
    length_mm = keys.hand_length_mm
    model, length = hand_model("thesis"), None if length_mm is None else length_mm / 1000
    start = model.shape("left" if left else "right", hand_length_m=length, person=person)
    if len(gesture.base) > 4:
        raise SettingsError(f"--base has {len(gesture.base)} markers; give three or four of them")
    layout = base_layout(start, len(gesture.base), keys.base_height_mm / 1000)
    fit = partial(_fit, model=model, start=start, layout=layout)
    if recorded is None or spans is None:
        bones = _guided(gesture, fit, connect, keys.lasting, keys.prepare)
    else:
        for scene, phase in _shown(recorded, rig, gesture, spans):
            gesture.update(scene, phase)
        bones = fit(gesture)
    save_hand_shape(out, bones.shape)
    write_json(json, _row(bones, gesture, out))
    if json != "-":
        _show(bones, gesture, out)


def _check_inputs(take: Path | None, phases: str | None, rig: Path | None) -> None:
    """Check that a take comes with its phases, and a live measurement with neither these nor a rig.

    Raises:
        SettingsError: one is missing or too much.
    """
    if (take is None) != (phases is None):
        said = "a take wants --phases flat=0:4,knuckles=4:10,hook=10:16" if phases is None else "--phases is of a take"
        raise SettingsError(f"{said}; live, leave both out")
    if take is None and rig is not None:
        raise SettingsError("--rig is of a take; live, the server knows its cameras: mocapella serve --rig")


def _fit(gesture: GesturePoints, model: HandModel, start: HandShape, layout: Any) -> Bones:
    return gesture.measure(model, start, layout)


def _recorded(path: Path) -> Take:
    from mocapella.live.recordings import find_recording, is_take
    from mocapella.recording.take_reader import read_take

    file = find_recording(path)
    if not is_take(file):
        raise SettingsError(f"{file} is no take; record one with serve --method hands --record, or measure live")
    return read_take(file)


def _names(take: Take | None, tips: str | None, base: str | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the markers of tips and base: as given, else as in the take, else the defaults."""
    from mocapella.tracker.hands import HandsSettings

    usual = HandsSettings()
    told = {} if take is None else take.info.method_settings

    def chosen(given: str | None, name: str, default: tuple[str, ...]) -> tuple[str, ...]:
        if given is not None:
            return tuple(part.strip() for part in given.split(","))
        return tuple(map(str, told.get(name, default)))

    return chosen(tips, "tips", usual.tips), chosen(base, "base", usual.base)


def _shown(
    take: Take, rig: Path | None, gesture: GesturePoints, spans: tuple[PhaseSpan, ...]
) -> Iterator[tuple[Scene, str]]:
    """Yield the take's scenes within the phases of the gesture, each with its phase."""
    from mocapella.conventions import NS_PER_S
    from mocapella.errors import InputError
    from mocapella.kinematics.hand_gesture import phase_at

    began_ns = seconds = None
    for scene in _scenes(take, rig, gesture):
        began_ns = scene.at_ns if began_ns is None else began_ns
        seconds = (scene.at_ns - began_ns) / NS_PER_S
        phase = phase_at(spans, seconds)
        if phase is not None:
            yield scene, phase
    if seconds is None:
        fix = "record it with serve --method hands, or give --rig where it has the cameras' frames"
        raise InputError("has no scenes", file=take.path, fix=fix)
    if seconds < spans[-1].begin_s:
        fix = "say with --phases when the parts are shown"
        raise InputError(
            f"ends at {seconds:.1f} s, before the part {spans[-1].phase!r} begins", file=take.path, fix=fix
        )


def _scenes(take: Take, rig: Path | None, gesture: GesturePoints) -> Iterator[Scene]:
    if rig is None:
        yield from (scene for _, scene in take.scenes())
        return
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.tracker.hands import HandsSettings, HandsTracker

    first, second, third, fourth, fifth = gesture.tips
    settings = HandsSettings(tips=(first, second, third, fourth, fifth), base=gesture.base)
    tracker = HandsTracker(load_camera_rig(rig), settings)
    for arrival in take.arrivals():
        yield tracker.update(arrival)
    problems = tracker.report.rejected
    if problems and not tracker.report.kept:
        raise SettingsError(f"--rig {rig}: no frame of {take.path} can be used: {', '.join(problems)}")


def _guided(gesture: GesturePoints, fit: Any, connect: str, lasting: str, prepare: float) -> Bones:
    from mocapella.live.hand_guide import GuideSettings, HandGuide
    from mocapella.live.signals import interruptible
    from mocapella.wire.reader import Newest
    from mocapella.wire.session import open_reader

    try:
        flat, knuckles, hook = (float(part) for part in lasting.split(","))
    except ValueError:
        raise SettingsError(f"lasting {lasting!r} cannot be used; write it as 4,6,6") from None
    settings = GuideSettings(flat, knuckles, hook, prepare)
    session = open_reader(connect)
    try:
        with interruptible(), console.status("") as line:
            guide = HandGuide(Newest(session).scene, gesture, settings, say=say, show=line.update)
            return guide.run(fit)
    except KeyboardInterrupt:
        say("stopped before the end; nothing was written")
        raise typer.Exit(130) from None
    finally:
        session.close()  # type: ignore[no-untyped-call]


def _row(bones: Bones, gesture: GesturePoints, out: Path) -> dict[str, Any]:
    from mocapella.model.hand import DIGITS

    shape = bones.shape
    assert shape.lengths_sd is not None
    return {
        "out": str(out),
        "person": shape.person,
        "handedness": shape.handedness,
        "lengths_mm": {name: _mm(row) for name, row in zip(DIGITS, shape.lengths, strict=True)},
        "lengths_sd_mm": {name: _mm(row) for name, row in zip(DIGITS, shape.lengths_sd, strict=True)},
        "whole_sd_mm": dict(zip(DIGITS, _mm(bones.finger_sd_m), strict=True)),
        "proportioned": list(_PROPORTIONED),
        "knuckles_moved_deg": dict(zip(DIGITS[1:], bones.knuckles_deg.round(1).tolist(), strict=True)),
        "hook_moved_deg": dict(zip(DIGITS[1:], bones.hook_deg.round(1).tolist(), strict=True)),
        "instants": dict(zip(DIGITS[1:], bones.frames.tolist(), strict=True)),
        "residual_mm": round(1000 * bones.residual_m, 2),
        "base_places_mm": {name: _mm(place) for name, place in zip(gesture.base, bones.base_markers, strict=True)},
        "scenes": gesture.report.scenes,
        "kept": gesture.report.kept,
        "without_points": gesture.report.without_points,
    }


def _mm(values: Any) -> list[float]:
    return [round(1000 * float(value), 2) for value in values]


def _show(bones: Bones, gesture: GesturePoints, out: Path) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from mocapella.model.hand import DIGITS

    shape = bones.shape
    assert shape.lengths_sd is not None
    printed = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    printed.add_column("mm")
    for words in ("first bone", "second", "third", "whole"):
        printed.add_column(words, justify="right")
    printed.add_column("")
    for digit, name in enumerate(DIGITS):
        cells = [_with_sd(x, sd) for x, sd in zip(shape.lengths[digit], shape.lengths_sd[digit], strict=True)]
        whole = _with_sd(shape.lengths[digit].sum(), bones.finger_sd_m[digit])
        how = "in proportion to the fingers" if name in _PROPORTIONED else f"{bones.frames[digit - 1]} instants"
        printed.add_row(name, *cells, whole, how)
    console.print(printed)
    say(f"fingertips are {1000 * bones.residual_m:.1f} mm from this hand (root mean square)")
    places = ",".join(f"[{','.join(f'{x:.4f}' for x in place)}]" for place in bones.base_markers)
    say(f"written to {out}; mocapella serve --method hands --file hand={out} uses it")
    names = ",".join(f'"{name}"' for name in gesture.base)
    say(f"with the present markers of the base: --set 'base=[{names}]' --set 'base_places_m=[{places}]'")


def _with_sd(value: float, sd: float) -> str:
    return f"{1000 * value:.1f} ± {1000 * sd:.1f}"
