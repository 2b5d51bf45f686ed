"""The status, the table of sensors and the recording as HTML. Every text that came over the wire is escaped."""

from __future__ import annotations

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
_DASH = "–"


def status_html(status: SessionStatus | None) -> str:
    """The state in large letters, what it waits for, why, and how much goes in and out."""
    if status is None:
        return _headline("No server", _RED, "Waiting for the server to answer.", "")
    colour = _PHASE_COLOUR.get(status.phase, _GREY)
    facts = (
        f"{_plural(status.people, 'person', 'people')} · {_plural(len(status.sensors), 'sensor', 'sensors')} · "
        f"{status.scenes_hz:.0f} results/s"
    )
    return _headline(status.phase.capitalize(), colour, _detail(status), facts)


def sensors_html(status: SessionStatus | None, colours: SensorColours) -> str:
    """The table of sensors, one row each, in the colours of their skeletons."""
    heads = "".join(
        f'<th style="padding:3px 10px;text-align:{side};font-weight:500;color:{_GREY}">{head}</th>'
        for head, side in (
            ("Sensor", "left"),
            ("People", "right"),
            ("Rate", "right"),
            ("Latency", "right"),
            ("Dropped", "right"),
            ("Clock offset", "right"),
            ("Health", "left"),
        )
    )
    rows = status.sensors if status else ()
    body = "".join(_sensor_row(row, colours.of(row.name)) for row in rows)
    if not rows:
        body = f'<tr><td colspan="7" style="padding:6px 10px;color:{_GREY}">No sensor yet.</td></tr>'
    return (
        '<div class="mocapella-sensors" style="padding:2px 6px 8px;overflow-x:auto">'
        '<table style="width:100%;border-collapse:collapse;font-size:13px;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums"><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'
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


def _detail(status: SessionStatus) -> str:
    parts = []
    if status.phase == Phase.WAITING_FOR_SENSORS and status.sensors_missing:
        parts.append(f"{_plural(status.sensors_missing, 'sensor', 'sensors')} missing")
    if status.phase == Phase.CALIBRATING and status.frames_remaining:
        parts.append(f"{status.frames_remaining} of {status.frames_wanted} frames to go: stand still")
    if status.reason:
        parts.append(status.reason)
    return " · ".join(parts)


def _sensor_row(row: SensorHealth, colour: Rgb) -> str:
    health, health_colour = _health(row)
    place = " (this machine)" if row.local else ""
    bound = "" if row.clock_bound is None else f" ± {row.clock_bound * 1000:.1f}"
    offset = _DASH if row.clock_offset is None else f"{row.clock_offset * 1000:+z.1f}{bound} ms"
    latency = _DASH if row.latency is None else f"{row.latency * 1000:.1f} ms"
    dropped = row.dropped + row.rejected
    cells = (
        (f'<span style="color:{colour.css}">●</span> <b>{escape(row.name)}</b>{place}', "left", "inherit"),
        (str(row.bodies), "right", "inherit"),
        (f"{row.rate_hz:.1f} Hz", "right", "inherit"),
        (latency, "right", "inherit"),
        (str(dropped), "right", _AMBER if dropped else "inherit"),
        (offset, "right", "inherit"),
        (escape(health), "left", health_colour),
    )
    return (
        "<tr>"
        + "".join(
            f'<td style="padding:3px 10px;text-align:{side};color:{text_colour}">{text}</td>'
            for text, side, text_colour in cells
        )
        + "</tr>"
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
    return f'<div style="padding:2px 12px 8px;font-size:13px;line-height:1.45;color:{colour}">{content}</div>'


def _plural(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def _duration(seconds: float) -> str:
    whole = int(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def _size(size_bytes: int) -> str:
    if size_bytes < 1_000_000:
        return f"{size_bytes / 1000:.0f} kB"
    return f"{size_bytes / 1e6:.1f} MB"
