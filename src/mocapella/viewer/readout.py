"""Readouts of the session as HTML: state, sensors, people, recording and notices. Texts of the server are escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import PurePath
from types import MappingProxyType

from mocapella.model.conditions import conditions, is_warning, problems, trouble
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.names import plural
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Person, Phase, Scene, SensorPlace
from mocapella.model.session import RecordingHealth, SensorHealth, SessionStatus
from mocapella.model.study_status import StudyStatus
from mocapella.viewer.palette import AMBER, BLUE, GREEN, GREY, RED, Rgb, SensorColours, person_colour

_GREEN, _AMBER, _BLUE, _RED, _GREY = (colour.css for colour in (GREEN, AMBER, BLUE, RED, GREY))
_PHASE_COLOUR: dict[str, str] = {
    Phase.TRACKING: _GREEN,
    Phase.CALIBRATING: _BLUE,
    Phase.WAITING_FOR_SENSORS: _BLUE,
    Phase.NEEDS_RECALIBRATION: _AMBER,
    Phase.STOPPED: _GREY,
}
_NEWEST_NOTICES = 4
_MOST_LINES, _LONGEST_LINE = 3, 110
_SWAPPED = "⇄"
_SMALL = "font-size:13px;line-height:1.45"
DROPPED_SHARE = 0.05
"""Share of dropped frames since tracking began above which their number is shown in amber."""
NO_SENSOR = "No sensor delivers"
GETTING_READY = "Getting ready"
NO_PLACES: Mapping[str, SensorPlace] = MappingProxyType({})


def status_html(status: SessionStatus | None) -> str:
    """Return the session's state in large letters, the reason, and the counts and rates as HTML.

    ``status`` is None without a server.
    """
    if status is None:
        return _headline("No server", _RED, "Waiting for the server; start it with: mocapella serve", "")
    silent = _silent(status)
    title, colour = status.phase.capitalize(), _PHASE_COLOUR.get(status.phase, _GREY)
    if status.getting_ready:
        title, colour = GETTING_READY, _BLUE
    counts, sensors = status.counts, plural(len(status.sensors), "sensor", "sensors")
    if status.running and silent:
        colour, sensors = _AMBER, f"{len(status.sensors) - len(silent)} of {sensors}"
        if len(silent) == len(status.sensors):
            title, colour, counts = NO_SENSOR, _RED, {}
    elif status.phase == Phase.TRACKING and _warned(status):
        colour = _AMBER
    facts = f"{_counted(counts)} · {sensors} · {status.scenes_hz:.0f} results/s"
    return _headline(title, colour, _detail(status, silent), facts)


def run_html(state: str, scene: Scene | None, at_s: float, place: int, count: int) -> str:
    """Return the state of a run on files, without a server, in large letters, and the shown frame as HTML.

    Args:
        state: a `mocapella.viewer.timeline.PlayState`.
        scene: the shown scene; None before the first.
        at_s: capture time of the scene, on the scenes' common clock [s].
        place: number of the scene among the stored ones, from 1.
        count: number of stored scenes.
    """
    if scene is None or not count:
        return _headline(state, _BLUE, "", "the first pictures are waited for")
    nothing = _nothing_there(scene)
    colour = _AMBER if nothing else _BLUE if state == "End" else _GREEN
    return _headline(state, colour, nothing, f"frame {scene.sequence} · {at_s:.2f} s · {place} of {count}")


def _nothing_there(scene: Scene) -> str:
    """Return the text for a scene without its main parts; empty if one of them is tracked."""
    name = next(iter(scene.parts), "")
    kind = PART_TYPES.get(name)
    if kind is None or any(kind.there(part) for part in scene.of(name)):
        return ""
    return kind.none


def _counted(counts: Mapping[str, int]) -> str:
    """Return the counts of the newest scene's parts; of people if it has none."""
    said = []
    for name, count in counts.items():
        kind = PART_TYPES.get(name)
        if kind is not None and kind.counted is not None and (count or name == next(iter(counts))):
            said.append(plural(count, *kind.counted))
    return " · ".join(said) or plural(0, "person", "people")


def _none_of(counts: Mapping[str, int]) -> str:
    """Return the text of an empty stage, about the method's first part type."""
    kind = PART_TYPES.get(next(iter(counts), ""))
    return kind.none if kind is not None and kind.none else "Nobody is in view"


def stage_text(status: SessionStatus | None) -> str:
    """Return the reason why the Scene stage is empty, in one line; ``status`` is None without a server."""
    if status is None:
        return "No server"
    if status.running and status.sensors and len(_silent(status)) == len(status.sensors):
        return NO_SENSOR
    title, why = status.phase.capitalize(), _detail(status, {})
    if status.getting_ready:
        title = GETTING_READY
    elif status.phase == Phase.STOPPED:
        why = "press Start to track"
    elif status.phase == Phase.TRACKING:
        title, why = _none_of(status.counts), ""
    elif status.phase == Phase.CALIBRATING:
        still = status.frames_remaining and any(row.bodies and not row.silent for row in status.sensors)
        why = f"stand still ({_to_go(status)})" if still else " · ".join(_conditions(status, {}))
    return f"{title}: {why}" if why else title


def condition_lines(status: SessionStatus | None) -> tuple[str, ...]:
    """Return the tracker's problems and advice as a few short lines for a stage; the panel shows them in full.

    The first line is the session's phase, unless it is tracking. There are none without a server (``status`` None),
    and while the session does not run.
    """
    if status is None or not status.running:
        return ()
    said = _conditions(status, {})
    shown = [text if len(text) <= _LONGEST_LINE else text[: _LONGEST_LINE - 1] + "…" for text in said[:_MOST_LINES]]
    more = [f"and {len(said) - _MOST_LINES} more"] if len(said) > _MOST_LINES else []
    return (*([] if status.phase == Phase.TRACKING else [status.phase.capitalize()]), *shown, *more)


def sensors_html(
    status: SessionStatus | None, colours: SensorColours, places: Mapping[str, SensorPlace] = NO_PLACES
) -> str:
    """Return a row for each sensor with its rate, latency, losses and problems as HTML.

    Args:
        status: status of the session; None without a server.
        colours: colours of the sensors.
        places: poses of the newest scene's sensors, by sensor.
    """
    rows = status.sensors if status else ()
    begun = status is not None and not status.getting_ready
    body = "".join(_sensor_row(row, colours.of(row.name), places.get(row.name), begun=begun) for row in rows)
    return (
        f'<div class="mocapella-sensors" style="padding:0 12px 8px;{_SMALL};font-variant-numeric:tabular-nums">'
        + (body or f'<div style="color:{_GREY}">No sensor yet.</div>')
        + "</div>"
    )


def recording_html(recording: RecordingHealth | None) -> str:
    """Return the present or last recording as HTML: its name, duration, size, frames, lost frames and problems.

    Without one (``recording`` None or empty), the HTML says that nothing is recorded.
    """
    if recording is None or not (recording.active or recording.path or recording.problem):
        return _note("Not recording.", _GREY)
    name = escape(PurePath(recording.path).name)
    facts = (
        f"{_duration(recording.seconds)} · {_size(recording.size_bytes)} · {recording.frames} frames · "
        f"{recording.scenes} results"
    )
    lost = f'<span style="color:{_RED if recording.lost else _GREEN}">{recording.lost} lost</span>'
    headline = f'<span style="color:{_RED}">●</span> Recording <b>{name}</b>' if recording.active else f"Last: {name}"
    faults = filter(None, (recording.problem, *map(str, recording.unknown)))
    problem = "".join(f'<div style="color:{_RED}">{escape(fault)}</div>' for fault in faults)
    return _note(f"<div>{headline}</div><div>{facts} · {lost}</div>{problem}", "inherit")


def study_html(study: StudyStatus | None) -> str:
    """Return the line about the study that the session runs, with links to its pages; empty if it runs none."""
    if study is None:
        return ""
    who = f"participant {study.participant}, {study.phase}" if study.participant else "no participant yet"
    links = ", ".join(
        f'<a href="/{page}" target="_blank" style="color:#5eb0ff">{name}</a>'
        for page, name in (("study", "researcher's page"), ("participant", "participant's screen"))
    )
    return _note(f"<div>Study <b>{escape(study.title)}</b>: {escape(who)}</div><div>{links}</div>", "inherit")


def watching_html() -> str:
    """Return the line for a browser that only watches, as HTML."""
    return _note("You watch. To control the session, open the operator's address.", _GREY)


def notices_html(status: SessionStatus | None, troubles: tuple[str, ...] = (), refused: tuple[str, ...] = ()) -> str:
    """Return problems, drawing errors, refused requests and the newest notices, newest first, as HTML.

    Args:
        status: status of the session; None without a server.
        troubles: messages of `PluginErrors`.
        refused: lines of `PageRefusals`.
    """
    newest = status.notices[-_NEWEST_NOTICES:][::-1] if status else ()
    problems = (*(status.health.problems() if status else ()), *troubles)
    wrong = "".join(f'<div style="padding:2px 0;color:{_AMBER}">{escape(text)}</div>' for text in problems)
    wrong += "".join(f'<div style="padding:2px 0">{escape(text)}</div>' for text in refused)
    if not newest:
        return _note(wrong or "Nothing to report.", "inherit" if wrong else _GREY)
    lines = (
        f'<div style="padding:2px 0;opacity:{1.0 - 0.15 * age:.2f}">{escape(text)}</div>'
        for age, text in enumerate(newest)
    )
    return _note(wrong + "".join(lines), "inherit")


def _headline(title: str, colour: str, detail: str, facts: str) -> str:
    return (
        '<div class="mocapella-status" style="padding:10px 14px 10px">'
        f'<div style="font-size:30px;line-height:1.15;font-weight:650;letter-spacing:-0.01em;color:{colour}">'
        f"{escape(title)}</div>"
        f'<div style="font-size:15px;line-height:1.35;margin-top:4px">{escape(detail)}</div>'
        f'<div style="font-size:13px;margin-top:6px;color:{_GREY}">{escape(facts)}</div></div>'
    )


def _silent(status: SessionStatus) -> dict[str, str]:
    """Return the silent sensors by name, and the problem of each."""
    return {row.name: _health(row)[0] for row in status.sensors if row.silent}


def _detail(status: SessionStatus, silent: Mapping[str, str]) -> str:
    parts = []
    if status.phase == Phase.WAITING_FOR_SENSORS and status.sensors_missing:
        parts.append(f"{plural(status.sensors_missing, 'sensor', 'sensors')} missing")
    if status.phase == Phase.CALIBRATING and status.frames_remaining:
        parts.append(f"{_to_go(status)}: stand still")
    parts += _conditions(status, silent)
    if status.running:
        parts += [f"{name}: {what}" for name, what in silent.items()]
    return " · ".join(parts)


def _conditions(status: SessionStatus, silent: Mapping[str, str]) -> list[str]:
    """Return the tracker's conditions, except conditions that a sensor's own state already explains."""
    parts = [part for part in status.reason.split("; ") if part.removesuffix(": silent") not in silent]
    return conditions("; ".join(parts), [row.name for row in status.sensors])


def _warned(status: SessionStatus) -> bool:
    """Return whether a condition of the tracker is a warning, not only an unfinished calibration."""
    return any(is_warning(text) for _, text in problems(status.reason, [row.name for row in status.sensors]))


def _to_go(status: SessionStatus) -> str:
    return f"{status.frames_remaining} of {status.frames_wanted} frames to go"


def people_html(people: tuple[Person, ...]) -> str:
    """Return the people in their colours as HTML, with the sensors that see each.

    A sign marks sensors that have swapped left and right.
    """
    rows = "".join(
        f'<div style="display:flex;justify-content:space-between;gap:10px"><span style="overflow-wrap:anywhere">'
        f'<span style="color:{person_colour(person.id).css}">●</span> '
        f"<b>{escape(person.name or f'Person {person.id}')}</b></span>"
        f'<span style="color:{_GREY};white-space:nowrap">{f"person {person.id}" if person.name else ""}'
        f"{' · ' if person.name and person.views else ''}"
        f"{plural(len(person.views), 'view', 'views') if person.views else ''}</span></div>"
        f'<div style="font-size:12px;color:{_GREY};overflow-wrap:anywhere">{_seen_by(person)}</div>'
        for person in people
    )
    if people:  # always, so that the rows below do not move when labels are swapped
        rows += f'<div style="font-size:12px;color:{_GREY}">{_SWAPPED} left/right labels swapped, and repaired</div>'
    return f'<div class="mocapella-people">{_note(rows or "Nobody is in view.", "inherit" if people else _GREY)}</div>'


def _seen_by(person: Person) -> str:
    sign = f" {_SWAPPED}"
    return " · ".join(escape(view.sensor) + (sign if view.mirrored else "") for view in person.views)


def _sensor_row(row: SensorHealth, colour: Rgb, place: SensorPlace | None, *, begun: bool) -> str:
    health, health_colour = _health(row)
    where = " (this machine)" if row.local else ""
    dropped = row.dropped + row.rejected
    kind = FRAME_TYPES.get(row.sends)
    if kind is None or kind.counted is None:
        seen = escape(row.sends if kind is None else kind.shown or kind.name)
    else:
        seen = plural(row.bodies, *kind.counted)
    facts = [seen, f"{row.rate_hz:.1f} Hz"]
    if row.latency is not None and not row.silent:
        facts.append(f"latency {row.latency * 1000:.1f} ms")
    many = row.rejected > 0 or (begun and _drops_many(row))
    lines = [" · ".join(facts), f'<span style="color:{_AMBER if many else "inherit"}">{dropped} dropped</span>']
    if row.clock_offset is not None:
        bound_ms = None if row.clock_bound is None else row.clock_bound * 1000
        clock = [_whole(f"clock {_bounded(row.clock_offset * 1000, bound_ms)} ms")]
        if row.clock_drift_ppm is not None:
            clock.append(_whole(f"drift {_bounded(row.clock_drift_ppm, row.clock_drift_bound_ppm)} ppm"))
        lines.append(" · ".join(clock))
    return (
        '<div style="padding:2px 0 4px">'
        f'<div style="display:flex;justify-content:space-between;gap:10px"><span style="overflow-wrap:anywhere">'
        f'<span style="color:{colour.css}">●</span> <b>{escape(row.name)}</b>{where}</span>'
        f'<span style="color:{health_colour};text-align:right">{escape(health)}</span></div>'
        f'<div style="font-size:12px;color:{_GREY}">{"<br>".join(lines)}</div>'
        f"{_place(place)}</div>"
    )


def _bounded(value: float, bound: float | None) -> str:
    return f"{value:+z.1f}" + ("" if bound is None else f" ± {bound:.1f}")


def _whole(text: str) -> str:
    """Return a text that is not broken into lines, as HTML."""
    return f'<span style="white-space:nowrap">{text}</span>'


def _drops_many(row: SensorHealth) -> bool:
    """Return whether many frames were dropped since tracking began; before, compilation may need the processor."""
    frames, dropped = row.frames - row.frames_before, row.dropped - row.dropped_before
    return dropped > DROPPED_SHARE * (frames + dropped)


def _place(place: SensorPlace | None) -> str:
    """Return the quality of the sensor's pose and its problem; empty if the method reports none."""
    if place is None:
        return ""
    if place.T_world_sensor is None:
        known, colour = "place not known", _RED if is_warning(place.problem) else _GREY
    else:
        how = f"place{' known to' if place.quality[:1].isdigit() else ':'} {place.quality}"
        known, colour = how if place.quality else "reference for the others", _GREY
    tone = _AMBER if is_warning(place.problem) else _GREY
    problem = f'<div style="color:{tone}">{escape(trouble(place.problem))}</div>' if place.problem else ""
    return f'<div style="font-size:12px"><div style="color:{colour}">{escape(known)}</div>{problem}</div>'


def _health(row: SensorHealth) -> tuple[str, str]:
    if row.problem:
        return row.problem, _RED
    if not row.connected:
        return "gone", _RED
    if row.silent:
        return "silent", _AMBER
    return "good", _GREEN


def _note(content: str, colour: str) -> str:
    return f'<div style="padding:2px 12px 8px;{_SMALL};color:{colour}">{content}</div>'


def _duration(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def _size(size_bytes: int) -> str:
    if size_bytes < 1_000_000:
        return f"{size_bytes / 1000:.0f} kB"
    return f"{size_bytes / 1e6:.1f} MB"
