"""The status, the sensors and the recording as HTML. Every text that came over the wire is escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import PurePath

from mocapella.model.scene import Phase
from mocapella.model.session import RecordingHealth, SensorHealth, SessionStatus
from mocapella.viewer.palette import Rgb, SensorColours

_GREEN, _AMBER, _BLUE, _RED, _GREY = "#3ddc97", "#ffb84d", "#5eb0ff", "#ff6b6b", "#8a97ab"
_PHASE_COLOUR: dict[str, str] = {
    Phase.TRACKING: _GREEN,
    Phase.CALIBRATING: _BLUE,
    Phase.WAITING_FOR_SENSORS: _AMBER,
    Phase.NEEDS_RECALIBRATION: _AMBER,
    Phase.STOPPED: _GREY,
}
_NEWEST_NOTICES = 4
_SMALL = "font-size:13px;line-height:1.45"
NO_SENSOR = "No sensor delivers"


def status_html(status: SessionStatus | None) -> str:
    """The state in large letters, what it waits for, why, and how much goes in and out."""
    if status is None:
        return _headline("No server", _RED, "Waiting for the server; start it with: mocapella serve", "")
    silent = _silent(status)
    title, colour = status.phase.capitalize(), _PHASE_COLOUR.get(status.phase, _GREY)
    people, sensors = status.people, _plural(len(status.sensors), "sensor", "sensors")
    if status.running and silent:
        colour, sensors = _AMBER, f"{len(status.sensors) - len(silent)} of {sensors}"
        if len(silent) == len(status.sensors):
            title, colour, people = NO_SENSOR, _RED, 0
    facts = f"{_plural(people, 'person', 'people')} · {sensors} · {status.scenes_hz:.0f} results/s"
    return _headline(title, colour, _detail(status, silent), facts)


def stage_text(status: SessionStatus | None) -> str:
    """Why nobody is on the Tracking stage, in one line."""
    if status is None:
        return "No server"
    if status.running and status.sensors and len(_silent(status)) == len(status.sensors):
        return NO_SENSOR
    title, why = status.phase.capitalize(), _detail(status, {})
    if status.phase == Phase.STOPPED:
        why = "press Start to track"
    elif status.phase == Phase.TRACKING:
        title, why = "Nobody is in view", ""
    elif status.phase == Phase.CALIBRATING:
        to_go = f" ({_to_go(status)})" if status.frames_remaining else ""
        why = status.reason if status.reason.startswith("nobody") else f"stand still{to_go}"
    return f"{title}: {why}" if why else title


def sensors_html(status: SessionStatus | None, colours: SensorColours) -> str:
    """The sensors, one below the other, in the colours of their skeletons: narrow, to stand beside the 3D scene."""
    rows = status.sensors if status else ()
    body = "".join(_sensor_row(row, colours.of(row.name)) for row in rows)
    return (
        f'<div class="mocapella-sensors" style="padding:0 12px 8px;{_SMALL};font-variant-numeric:tabular-nums">'
        + (body or f'<div style="color:{_GREY}">No sensor yet.</div>')
        + "</div>"
    )


def recording_html(recording: RecordingHealth | None) -> str:
    """What is being recorded, how large and how whole it is, or what went wrong."""
    if recording is None or not (recording.active or recording.path or recording.problem):
        return _note("Not recording.", _GREY)
    name = escape(PurePath(recording.path).name)
    facts = (
        f"{_duration(recording.seconds)} · {_size(recording.size_bytes)} · {recording.frames} frames · "
        f"{recording.scenes} results"
    )
    lost = f'<span style="color:{_RED if recording.lost else _GREEN}">{recording.lost} lost</span>'
    headline = f'<span style="color:{_RED}">●</span> Recording <b>{name}</b>' if recording.active else f"Last: {name}"
    problem = f'<div style="color:{_RED}">{escape(recording.problem)}</div>' if recording.problem else ""
    return _note(f"<div>{headline}</div><div>{facts} · {lost}</div>{problem}", "inherit")


def notices_html(status: SessionStatus | None) -> str:
    """The newest notices, the newest first."""
    newest = status.notices[-_NEWEST_NOTICES:][::-1] if status else ()
    if not newest:
        return _note("Nothing to report.", _GREY)
    lines = (
        f'<div style="padding:2px 0;opacity:{1.0 - 0.15 * age:.2f}">{escape(text)}</div>'
        for age, text in enumerate(newest)
    )
    return _note("".join(lines), "inherit")


def _headline(title: str, colour: str, detail: str, facts: str) -> str:
    return (
        '<div class="mocapella-status" style="padding:10px 14px 10px">'
        f'<div style="font-size:30px;line-height:1.15;font-weight:650;letter-spacing:-0.01em;color:{colour}">'
        f"{escape(title)}</div>"
        f'<div style="font-size:15px;line-height:1.35;margin-top:4px">{escape(detail)}</div>'
        f'<div style="font-size:13px;margin-top:6px;color:{_GREY}">{escape(facts)}</div></div>'
    )


def _silent(status: SessionStatus) -> dict[str, str]:
    """The sensors that deliver nothing now, by name, and what is wrong with each."""
    return {row.name: _health(row)[0] for row in status.sensors if row.silent}


def _detail(status: SessionStatus, silent: Mapping[str, str]) -> str:
    parts = []
    if status.phase == Phase.WAITING_FOR_SENSORS and status.sensors_missing:
        parts.append(f"{_plural(status.sensors_missing, 'sensor', 'sensors')} missing")
    if status.phase == Phase.CALIBRATING and status.frames_remaining:
        parts.append(f"{_to_go(status)}: stand still")
    reasons = status.reason.split("; ")
    parts += [reason for reason in reasons if reason and reason.removesuffix(": silent") not in silent]
    if status.running:
        parts += [f"{name}: {what}" for name, what in silent.items()]
    return " · ".join(parts)


def _to_go(status: SessionStatus) -> str:
    return f"{status.frames_remaining} of {status.frames_wanted} frames to go"


def _sensor_row(row: SensorHealth, colour: Rgb) -> str:
    health, health_colour = _health(row)
    place = " (this machine)" if row.local else ""
    dropped = row.dropped + row.rejected
    facts = [_plural(row.bodies, "person", "people"), f"{row.rate_hz:.1f} Hz"]
    if row.latency is not None and not row.silent:
        facts.append(f"latency {row.latency * 1000:.1f} ms")
    losses = [f'<span style="color:{_AMBER if dropped else "inherit"}">{dropped} dropped</span>']
    if row.clock_offset is not None:
        bound = "" if row.clock_bound is None else f" ± {row.clock_bound * 1000:.1f}"
        losses.append(f"clock {row.clock_offset * 1000:+z.1f}{bound} ms")
    return (
        '<div style="padding:2px 0 4px">'
        f'<div style="display:flex;justify-content:space-between;gap:10px"><span style="overflow-wrap:anywhere">'
        f'<span style="color:{colour.css}">●</span> <b>{escape(row.name)}</b>{place}</span>'
        f'<span style="color:{health_colour};text-align:right">{escape(health)}</span></div>'
        f'<div style="font-size:12px;color:{_GREY}">{" · ".join(facts)}<br>{" · ".join(losses)}</div></div>'
    )


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


def _plural(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def _duration(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def _size(size_bytes: int) -> str:
    if size_bytes < 1_000_000:
        return f"{size_bytes / 1000:.0f} kB"
    return f"{size_bytes / 1e6:.1f} MB"
