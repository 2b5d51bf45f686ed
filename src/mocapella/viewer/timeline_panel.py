"""The folder of the timeline in one browser's panel: pause, play, and a slider over the stored moments."""

from __future__ import annotations

from typing import Final

import viser

from mocapella.viewer.inputs import set_value
from mocapella.viewer.palette import AMBER, GREY
from mocapella.viewer.timeline import Playhead, PlayState, Timeline

EVERY_S: Final = 0.2
"""Interval between updates of the slider while a browser follows live scenes [s]."""


class TimelinePanel:
    """The folder "Timeline". Callbacks of the browser only set requests of the playhead, which the drawing loop uses.

    Args:
        gui: controls of the browser.
        timeline: the stored moments.
        playhead: position of this browser on the timeline.
    """

    def __init__(self, gui: viser.GuiApi, timeline: Timeline, playhead: Playhead) -> None:
        self._timeline, self._playhead = timeline, playhead
        self._said, self._shown_s = "", -EVERY_S
        with gui.add_folder("Timeline"):
            self._words = gui.add_html(timeline_html(timeline, playhead))
            self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, color="gray", disabled=True)
            self._slider = gui.add_slider("Frame", 0, 1, 1, 0, disabled=True)
            self._newest = gui.add_button(
                "Newest", icon=viser.Icon.PLAYER_TRACK_NEXT, color="gray", visible=False, hint="Follow the live scene"
            )

        @self._button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._playhead.playing = not self._playhead.playing

        @self._slider.on_update
        async def _(event: viser.GuiEvent[viser.GuiSliderHandle[int]]) -> None:
            if event.client is not None:  # a user, not the loop
                self._playhead.playing, self._playhead.wish = False, int(event.target.value)

        @self._newest.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._playhead.newest = True

    def show(self, now_s: float) -> None:
        """Show the browser's position on the timeline.

        Args:
            now_s: the present time on this process's monotonic clock [s].
        """
        timeline, playhead = self._timeline, self._playhead
        label = "Pause" if playhead.playing else "Play"
        if self._button.label != label:
            self._button.label = label
            self._button.icon = viser.Icon.PLAYER_PAUSE if playhead.playing else viser.Icon.PLAYER_PLAY
        behind = playhead.number is not None and not timeline.done
        if self._newest.visible != behind:
            self._newest.visible = behind
        if playhead.state is PlayState.FOLLOWING and now_s - self._shown_s < EVERY_S:
            return
        self._shown_s = now_s
        said = timeline_html(timeline, playhead)
        if said == self._said:
            return
        self._said = self._words.content = said
        self._button.disabled = self._slider.disabled = not len(timeline)
        low, high = timeline.first, max(timeline.last, timeline.first + 1)
        if self._slider.max != high:
            self._slider.max = high
        if self._slider.min != low:
            self._slider.min = low
        if self._slider.value != playhead.shown and len(timeline):
            set_value(self._slider, playhead.shown)


def timeline_html(timeline: Timeline, playhead: Playhead) -> str:
    """Return the number of the shown moment, the number of stored moments, and the shown moment's age as HTML."""
    if not len(timeline):
        return _small("Nothing was shown yet.", GREY.css)
    count, place = len(timeline), playhead.shown - timeline.first + 1
    said = f"{place} of {count}"
    if playhead.state in (PlayState.FOLLOWING, PlayState.END):
        return _small(said, GREY.css)
    words = f"{playhead.state} · {playhead.behind_s:.1f} s ago" if not timeline.done else str(playhead.state)
    return _small(f"{words} · {said}", GREY.css if timeline.done else AMBER.css)


def _small(text: str, colour: str) -> str:
    return (
        f'<div class="mocapella-timeline" style="padding:2px 12px 4px;font-size:13px;color:{colour};'
        f'font-variant-numeric:tabular-nums">{text}</div>'
    )
