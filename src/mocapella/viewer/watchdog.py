"""Show a message on a page that has lost its server, so that people do not seem to stand still.

The server cannot notify such a page. The message is therefore present from the start, hidden by a style animation that
reveals it after `LIMIT_S`. Every `PERIOD_S` the element is replaced, which restarts the animation.
"""

from __future__ import annotations

import viser

PERIOD_S = 0.5
LIMIT_S = 2.0

_STYLE = f"""
@keyframes mocapella-lost {{ to {{ visibility: visible; }} }}
.mocapella-lost {{
  visibility: hidden; animation: mocapella-lost 0s {LIMIT_S}s forwards; pointer-events: none;
  position: fixed; inset: 0; z-index: 10000; background: #0b101a;
  display: flex; flex-direction: column; align-items: center; justify-content: center; text-align: center;
}}
[style*="opacity"]:has(.mocapella-lost) {{ opacity: 1 !important; }}
"""
"""Styles of the message. The last rule: viser dims its panel on a lost connection; the message must not be dimmed."""


class Watchdog:
    """The message "No server" in one browser, which appears `LIMIT_S` after the last call of `beat`.

    Args:
        gui: controls of the browser.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._beats, self._last_s = 0, 0.0
        self._html = gui.add_html(_html(0))

    def beat(self, now_s: float) -> None:
        """Keep the message hidden; call it in every update of the view.

        Args:
            now_s: the present time on this process's monotonic clock [s].
        """
        if now_s - self._last_s >= PERIOD_S:
            self._beats, self._last_s = self._beats + 1, now_s
            self._html.content = _html(self._beats)


def _html(beats: int) -> str:
    return (
        f'<style>{_STYLE}</style><div class="mocapella-lost" data-beats="{beats}">'
        '<div style="font-size:44px;font-weight:650;color:#ff6b6b">No server</div>'
        '<div style="font-size:18px;line-height:1.5;margin-top:10px;color:#c6cfdd">'
        "Nothing comes from the view any more: it has ended, or the network to it is down.<br>"
        "Start it again with <b>mocapella serve</b>; this page then goes on by itself, or "
        '<a href="" style="color:#5eb0ff;pointer-events:auto">load it again</a>.</div></div>'
    )
