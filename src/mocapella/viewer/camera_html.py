"""Camera images and the quality of learnt marker colours, as HTML. All texts are escaped."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from typing import Any

from mocapella.viewer.camera_feed import CameraAnswer, FeedImage, FeedMode
from mocapella.viewer.marker_lane import marker_colour
from mocapella.viewer.palette import AMBER, GREEN, GREY, RED
from mocapella.viewer.pointing import SKIN, Point, Pointing, asks_for, where

_SMALL = "font-size:13px;line-height:1.45"
_RADIUS = 0.022
"""Radius of a marker's circle, as a fraction of the image's width."""
GOOD_KEPT, FAIR_KEPT = 0.9, 0.8
"""Recognised share of a colour's pixels: good from the first value on, poor below the second."""
_MOST_PROBLEMS = 6


def found(answer: CameraAnswer) -> dict[str, Point]:
    """Return x and y of each detected marker in the camera's image [px], by name; markers not seen are left out."""
    pairs = zip(answer.names or (), answer.positions_px or (), strict=False)
    return {name: (float(at[0]), float(at[1])) for name, at in pairs if at is not None}


def radius_px(size_px: tuple[int, int]) -> float:
    """Return the radius of the circle to draw around a marker, for an image of size (width, height) [px]."""
    return _RADIUS * size_px[0]


def picture_html(
    shot: FeedImage | None, shown: FeedMode, report: Mapping[str, Any], *, large: bool = False, looks: bool = True
) -> str:
    """Return a camera's image with a circle around each marker, or its mask, and the camera's problems as HTML.

    It is empty if nothing is shown, and a note of waiting or of the failure before the first image. After a failure,
    the last image is dimmed.

    Args:
        shot: the newest image and the failure of the last request; None without a request.
        shown: type of the image.
        report: newest report of the camera's node, see `CameraAnswer.report`.
        large: whether the image is shown in front of the stages, and therefore not in the panel.
        looks: whether the camera's node detects markers.
    """
    if shown is FeedMode.OFF or shot is None:
        return ""
    answer, lines = shot.answer, []
    if answer is None:
        lines.append(_line(shot.problem or "Waiting for the picture …", AMBER.css if shot.problem else GREY.css))
        return _box("".join(lines))
    assert answer.size_px is not None, "the feed passes no answer without a picture"
    width, height = answer.size_px
    circles = "" if shown is FeedMode.MASK else "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius_px(answer.size_px):.1f}" fill="none" '
        f'stroke="{marker_colour(name).css}" stroke-width="2" vector-effect="non-scaling-stroke"></circle>'
        for name, (x, y) in found(answer).items()
    )  # fmt: skip
    image = f"data:image/{'png' if answer.format == 'png' else 'jpeg'};base64,{base64.b64encode(answer.image).decode()}"
    dim = ";opacity:0.35" if shot.problem else ""
    view = (
        f'<div style="position:relative;aspect-ratio:{width}/{height};background:#0b101a;border-radius:4px;'
        f'overflow:hidden;margin-bottom:4px">'
        f'<img decoding="sync" alt="" src="{image}" style="position:absolute;width:100%;height:100%{dim}">'
        f'<svg viewBox="-0.5 -0.5 {width} {height}" style="position:absolute;width:100%;height:100%">{circles}</svg>'
        "</div>"
    )
    if shot.problem:
        lines.append(_line(shot.problem, RED.css))
    names = answer.names or []
    seen = f" · {len(found(answer))} of {len(names)} markers found" if names else " · no colours are learnt yet"
    fps = report.get("fps")
    rate = f" · {fps:.0f} pictures a second" if isinstance(fps, int | float) and fps else ""
    lines.append(_line(f"{width} × {height} px{seen if looks else ''}{rate}", GREY.css))
    said = _texts(report.get("problems"))[:_MOST_PROBLEMS]
    lines += [_line(text, AMBER.css) for text in said if names or "learnt" not in text]
    return _box(("" if large else view) + "".join(lines))


def pointing_html(pointing: Pointing, problem: str, note: str) -> str:
    """Return the next marker to click on and the markers already clicked as HTML.

    Args:
        pointing: progress of the user.
        problem: error in the markers' names, or of the learning; empty if there is none.
        note: advice to the user; may be empty.
    """
    rows = []
    for k, name in enumerate(pointing.names):
        at = pointing.done[k] if k < len(pointing.done) else None
        if k < len(pointing.done):
            sign, colour = (f"{at[0]:.0f}, {at[1]:.0f}" if at else "left out"), GREY.css
        elif k == len(pointing.done):
            sign, colour = "◂ click on it", "inherit"
        else:
            sign, colour = "", GREY.css
        weight = 650 if k == len(pointing.done) else 400
        on = f' <span style="color:{GREY.css}">{escape(where(name))}</span>' if where(name) else ""
        rows.append(
            f'<div style="display:flex;justify-content:space-between;gap:10px;font-weight:{weight}">'
            f'<span style="overflow-wrap:anywhere">{_dot(name)} {escape(name)}{on}</span>'
            f'<span style="color:{colour};white-space:nowrap;font-variant-numeric:tabular-nums">{sign}</span></div>'
        )
    headline = (
        '<div class="mocapella-pointing" style="font-size:15px;font-weight:650;margin:2px 0 6px">'
        f"{escape(asks_for(pointing.next))}</div>"
    )
    said = (_line(problem, RED.css) if problem else "") + (_line(note, GREY.css) if note else "")
    return _box(headline + "".join(rows) + said)


def waiting_html(text: str) -> str:
    """Return a text as HTML, in the style of a note that an operation is in progress."""
    return _box(_line(text, GREY.css))


def separability_html(separability: Mapping[str, Any]) -> str:
    """Return the recognised share of each marker colour's pixels and the problems as HTML.

    Args:
        separability: result of the learning, see `CameraAnswer.separability`.
    """
    kept, rows = separability.get("kept"), []
    for name, share in kept.items() if isinstance(kept, Mapping) else ():
        part = min(max(float(share), 0.0), 1.0) if isinstance(share, int | float) else 0.0
        colour, percent = GREEN if part >= GOOD_KEPT else AMBER if part >= FAIR_KEPT else RED, 100 * part
        bar = f'<div style="height:6px;border-radius:3px;width:{percent:.0f}%;background:{colour.css}"></div>'
        rows.append(
            '<div style="display:flex;align-items:center;gap:8px">'
            f'<span style="flex:0 0 38%;overflow-wrap:anywhere">{_dot(name)} {escape(str(name))}</span>'
            f'<div style="flex:1;height:6px;border-radius:3px;background:#2a3446">{bar}</div>'
            '<span style="flex:0 0 44px;text-align:right;font-variant-numeric:tabular-nums">'
            f"{percent:.0f} %</span></div>"
        )
    problems = _texts(separability.get("problems"))
    verdict = (
        _line("All colours can be told apart.", GREEN.css)
        if not problems
        else "".join(_line(text, AMBER.css) for text in problems)
    )
    head = (
        '<div class="mocapella-learnt" style="font-size:15px;font-weight:650;margin:2px 0 2px">'
        "Learnt, and not saved yet</div>"
        f'<div style="color:{GREY.css};margin-bottom:4px">Share of each colour told apart from all else:</div>'
    )
    return _box(head + "".join(rows) + f'<div style="margin-top:6px">{verdict}</div>')


def unsaved_html(camera: str) -> str:
    """Return a note as HTML that the marker colours that a camera uses are not saved in its node's profile."""
    return _box(_line(f"The colours that {camera} uses now are not saved.", AMBER.css))


def _texts(value: Any) -> list[str]:
    """Return the strings of a list that a node sent; empty for any other value."""
    return [text for text in value if isinstance(text, str)] if isinstance(value, list | tuple) else []


def _dot(name: str) -> str:
    css = "#d9a98a" if name == SKIN else marker_colour(name).css
    return f'<span style="color:{css}">●</span>'


def _line(text: str, colour: str) -> str:
    return f'<div style="color:{colour};overflow-wrap:anywhere">{escape(text)}</div>'


def _box(content: str) -> str:
    return f'<div class="mocapella-camera" style="padding:2px 12px 6px;{_SMALL}">{content}</div>'
