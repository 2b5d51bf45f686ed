"""Progress of a camera calibration as HTML: each camera's detections, the next step, and the rig's quality."""

from __future__ import annotations

from html import escape

from mocapella.model.board_progress import BoardProgress, CameraProgress, RigQuality
from mocapella.viewer.palette import AMBER, BLUE, GREEN, GREY, RED, SensorColours

WIDTH = 136
"""Width of a camera's small image; two fit beside each other in the panel [px]."""
_UNKNOWN_SIZE = (4, 3)
_DARK, _LINE = "#141b28", "#2c3748"


def board_html(progress: BoardProgress, colours: SensorColours, typed: str) -> str:
    """Return the progress of a camera calibration as HTML, with the next step in large letters.

    Args:
        progress: state of the calibration.
        colours: colours of the cameras.
        typed: description of the calibration board that the user has entered for the next calibration.
    """
    parts = [_headline(progress, typed)]
    if progress.problem:
        parts.append(f'<div style="color:{RED.css};padding-bottom:6px">{escape(progress.problem)}</div>')
    if progress.phase in ("filming", "calibrating"):
        pictures = "".join(_camera(camera, colours) for camera in progress.cameras)
        parts.append(f'<div style="display:flex;flex-wrap:wrap;gap:10px">{pictures}</div>')
        parts += [f'<div style="color:{GREY.css}">{escape(text)}</div>' for text in progress.hints[1:3]]
    if progress.phase == "done" and progress.quality is not None:
        parts.append(_quality(progress.quality, colours))
    body = "".join(parts)
    return f'<div class="mocapella-board" style="padding:2px 12px 8px;font-size:13px;line-height:1.45">{body}</div>'


def _headline(progress: BoardProgress, typed: str) -> str:
    if progress.phase == "idle":
        text = "Enter the board as it is printed, press Start calibration, and carry it before the cameras."
        return f'<div style="padding-bottom:4px">{text} <span style="color:{GREY.css}">{escape(typed)}</span></div>'
    colour, detail = AMBER, ""
    if progress.busy:
        title, colour = progress.busy, BLUE
    elif progress.phase == "calibrating":
        title, colour = "Calibrating …", BLUE
    elif progress.phase == "filming":
        title = progress.hints[0] if progress.hints else "All is seen: press Finish"
        colour = AMBER if progress.hints else GREEN
        detail = progress.board
        if len(progress.cameras) > 1:
            detail = f"{detail}; seen by two cameras or more at once: {_times(progress.shared)}"
    elif progress.used:
        title, colour, detail = "In use", GREEN, f"saved as {progress.file}"
    else:
        title, colour = "Calibrated", GREEN
        detail = f"saved as {progress.file}" if progress.saved else "not saved yet, and not in use yet"
    title = title[:1].upper() + title[1:]
    size = 22 if progress.phase == "done" and not progress.busy else 19
    return (
        f'<div class="mocapella-board-headline" style="font-size:{size}px;line-height:1.25;font-weight:600;'
        f'color:{colour.css};overflow-wrap:anywhere">{escape(title)}</div>'
        f'<div style="color:{GREY.css};padding-bottom:6px">{escape(detail)}</div>'
    )


def _camera(camera: CameraProgress, colours: SensorColours) -> str:
    width, height = camera.size_px or _UNKNOWN_SIZE
    rows, columns = len(camera.fields), len(camera.fields[0])
    wide, tall = width / columns, height / rows
    fields = "".join(
        f'<rect x="{x * wide:.1f}" y="{y * tall:.1f}" width="{wide:.1f}" height="{tall:.1f}" '
        f'fill="{GREEN.css if count else _DARK}" fill-opacity="{0.3 if count else 1}" stroke="{_LINE}" '
        f'stroke-width="{width / 150:.2f}"/>'
        for y, row in enumerate(camera.fields)
        for x, count in enumerate(row)
    )
    corners = "".join(
        f'<circle cx="{x + 0.5:.1f}" cy="{y + 0.5:.1f}" r="{width / 75:.1f}" fill="#ffffff"/>'
        for x, y in camera.corners_px
    )
    seen, colour = ("sees the board", GREEN) if camera.corners_px else ("no board", AMBER)
    if camera.problem and not camera.corners_px:
        colour = RED
    name = f'<span style="color:{colours.of(camera.name).css}">●</span> <b>{escape(camera.name)}</b>'
    return (
        f'<div class="mocapella-board-camera" style="width:{WIDTH}px">'
        f'<svg viewBox="0 0 {width} {height}" width="{WIDTH}" style="display:block;border-radius:4px">'
        f"{fields}{corners}</svg>"
        f'<div style="display:flex;justify-content:space-between;gap:6px;font-size:12px">'
        f'<span style="overflow-wrap:anywhere">{name}</span>'
        f'<span style="white-space:nowrap">{camera.views} {"view" if camera.views == 1 else "views"}</span></div>'
        f'<div style="font-size:12px;color:{colour.css}">{seen}</div></div>'
    )


def _quality(quality: RigQuality, colours: SensorColours) -> str:
    """Return the rig's quality as an HTML table with a column for each camera, since the panel is narrow."""
    cells = list(zip(*quality.rows, strict=True))
    right = 'style="text-align:right;padding:1px 0 1px 8px"'
    names = "".join(
        f'<th {right}><span style="color:{colours.of(name).css}">●</span> {escape(name)}</th>' for name in cells[0]
    )
    rows = "".join(
        f'<tr><td style="color:{GREY.css}">{escape(f"{words}, {unit}" if unit else words)}</td>'
        + "".join(f"<td {right}>{escape(value)}</td>" for value in values)
        + "</tr>"
        for (words, unit), values in zip(quality.headings[1:], cells[1:], strict=True)
    )
    table = (
        '<table class="mocapella-board-quality" style="width:100%;border-collapse:collapse;font-size:12px;'
        f'font-variant-numeric:tabular-nums"><tr><th></th>{names}</tr>{rows}</table>'
    )
    said = "".join(f'<div style="padding-top:4px">{escape(text)}</div>' for text in quality.sentences)
    tape = f'<div style="padding-top:4px;color:{AMBER.css}">{escape(quality.tape)}</div>' if quality.tape else ""
    hints = "".join(f'<div style="padding-top:4px;color:{GREY.css}">{escape(text)}</div>' for text in quality.hints)
    return table + said + tape + hints


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
