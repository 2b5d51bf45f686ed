"""The legend of the skeletons' colours, over the lower right corner of the 3D scene."""

from __future__ import annotations

from html import escape
from typing import Final

import viser

from mocapella.viewer.palette import FILLED, FUSED, INFERRED, OBSTACLE, PEOPLE, Rgb
from mocapella.viewer.panel import WIDTH_PX
from mocapella.viewer.perspective import FREE

_STYLE: Final = f"""
.mocapella-legend {{
  position: fixed; right: {WIDTH_PX + 14}px; bottom: 12px; z-index: 5; pointer-events: none;
  padding: 8px 12px; border-radius: 8px; background: rgba(9, 12, 19, 0.72); color: #c6cfdd;
  font-size: 12.5px; line-height: 1.55;
}}
.mocapella-legend i {{
  display: inline-block; width: 20px; margin-right: 8px; vertical-align: middle; border-radius: 3px;
}}
@media (max-width: 760px), (max-height: 480px) {{ .mocapella-legend {{ display: none; }} }}
"""
_THICK, _THIN = 6, 2


class Legend:
    """The legend of the skeletons' colours in one browser, hidden until `show`; ``gui`` are the browser's controls."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._shown: tuple[object, ...] = ()
        self._html = gui.add_html("", visible=False)

    def show(self, perspective: str, *, people: bool, obstacle: bool, views: bool = True) -> None:
        """Update the legend; nothing is sent if the arguments are unchanged.

        Args:
            perspective: a sensor's name, or `FREE`.
            people: whether skeletons of people are shown; without them there is no legend.
            obstacle: whether obstacles are shown.
            views: whether a person has views: the reports of single sensors.
        """
        now = perspective, people, obstacle, views
        if now != self._shown:
            self._shown = now
            self._html.content = legend_html(perspective, obstacle=obstacle, views=views) if people else ""
            self._html.visible = people


def legend_html(perspective: str, *, obstacle: bool, views: bool = True) -> str:
    """Return the legend of a perspective as HTML; a sensor's name is escaped.

    Args:
        perspective: a sensor's name, or `FREE`.
        obstacle: whether obstacles are shown.
        views: whether a person has views: the reports of single sensors.
    """
    if perspective == FREE or not views:
        rows = [_row(FUSED, _THICK, "measured by at least one sensor" if views else "measured")]
    else:
        sensor = escape(perspective)
        rows = [
            _row(FUSED, _THICK, f"measured by <b>{sensor}</b>"),
            _row(FILLED, _THICK, f"hidden from <b>{sensor}</b>, filled in from the other sensors"),
        ]
    rows.append(_row(INFERRED, _THIN, "inferred: no sensor measures it" if views else "inferred"))
    if views:
        rows.append(_row(PEOPLE[0], _THIN, "what each sensor reports, in the person's colour"))
    if obstacle:
        rows.append(_row(OBSTACLE, 12, "obstacle"))
    return f'<style>{_STYLE}</style><div class="mocapella-legend">{"".join(rows)}</div>'


def _row(colour: Rgb, height_px: int, text: str) -> str:
    return f'<div><i style="height:{height_px}px;background:{colour.css}"></i>{text}</div>'
