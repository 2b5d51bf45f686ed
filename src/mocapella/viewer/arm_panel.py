"""Panel folder with quality metrics of the tracked arms, in one browser."""

from __future__ import annotations

from html import escape
from typing import Final

import numpy as np

from mocapella.model.arm_quality import ArmQuality
from mocapella.model.arms import ARM_JOINT_NAMES
from mocapella.model.scene import Scene
from mocapella.viewer.arm_strokes import COLOURS
from mocapella.viewer.palette import AMBER, GREEN, GREY
from mocapella.viewer.part_panel import PanelPlace, PanelState

EVERY_S: Final = 0.25
"""Shortest time between two updates of the metrics, so that they can be read [s]."""
_MANY: Final = 6.0
"""Rate of misdetections above which the panel shows it in amber [1/min]."""


class ArmPanel:
    """The folder "Arms" of one browser's panel, visible while the stage of arms is shown.

    Args:
        place: the browser's controls and the folder's position among the others.
    """

    def __init__(self, place: PanelPlace) -> None:
        self._folder = place.gui.add_folder("Arms", order=place.order, visible=False)
        with self._folder:
            self._text = place.gui.add_html("")
        self._visible, self._shown_s = False, -EVERY_S

    def show(self, state: PanelState) -> None:
        """Show or hide the folder, and update the metrics at most every `EVERY_S`.

        While the folder is visible, ``state.shown`` must have an attribute ``quality``, an `ArmQuality`. While one of
        the two is None, the earlier metrics stay.
        """
        if state.visible != self._visible:
            self._visible = self._folder.visible = state.visible
        if not state.visible or state.shown is None or state.now_s - self._shown_s < EVERY_S:
            return
        quality = state.shown.quality  # of this stage's memory while its folder is visible
        if quality is None:
            return
        self._shown_s = state.now_s
        self._text.content = quality_html(state.scene, quality)


def quality_html(scene: Scene | None, quality: ArmQuality) -> str:
    """Return each arm's gesture, each joint's noise [mm], and the misdetections per minute as HTML.

    Args:
        scene: the shown scene, for the gestures; None gives the text "No arm is seen.", as a scene without arms does.
        quality: the metrics; a NaN is shown as a dash.
    """
    grey = GREY.css
    hands = "".join(
        f"<div><b>{'Left' if arm.left else 'Right'} arm</b> · {escape(arm.gesture) or 'no gesture'}"
        f"{f' {100 * arm.gesture_sure:.0f} %' if arm.gesture else ''}{' · grabbing' if arm.grabbing else ''}</div>"
        for arm in (scene.arms if scene is not None else ())
    )
    rows = "".join(
        f'<tr><td><span style="color:{colour.css}">●</span> {name}</td>'
        f'<td style="text-align:right">{"–" if not np.isfinite(noise) else f"{1e3 * noise:.2f} mm"}</td></tr>'
        for name, colour, noise in zip(ARM_JOINT_NAMES, COLOURS, quality.noise_m, strict=True)
    )
    still = "measured now: an arm is still" if quality.still else "when an arm was last still"
    if not np.isfinite(quality.noise_m).any():
        still = "hold an arm still for 2 s to measure it"
    n, rate = quality.lately, quality.per_minute
    colour = grey if not np.isfinite(rate) else AMBER.css if rate > _MANY else GREEN.css
    said = "–" if not np.isfinite(rate) else f"{rate:.1f}"
    return (
        '<div class="mocapella-arms" style="padding:2px 12px 8px;font-size:13px;line-height:1.45;'
        f'font-variant-numeric:tabular-nums">{hands or "No arm is seen."}'
        f'<div style="margin-top:6px"><b>Noise</b> <span style="color:{grey}">{still}</span></div>'
        f'<table style="width:100%;border-spacing:0">{rows}</table>'
        '<div style="margin-top:6px"><b>Misdetections</b> '
        f'<span style="color:{colour}"><b>{said}</b> a minute</span></div>'
        f'<div style="font-size:12px;color:{grey}">in the last minute: {n.jumped} jumped · {n.appeared} appeared · '
        f"{n.vanished} vanished · {n.swapped} swapped · {n.lost} arms lost</div></div>"
    )
