"""The steps of a `SilhouetteRun` in the view, while it goes on and afterwards."""

from __future__ import annotations

import threading
import time
import warnings
from typing import Final

from mocapella.live.silhouette_run import SilhouetteRun, Step
from mocapella.live.view import beats
from mocapella.sensing.outline_picture import jpeg
from mocapella.tracker.silhouette_start import upright
from mocapella.viewer.body_panel import BodyViewFrame, EncodedPicture
from mocapella.viewer.body_stage import ShownBody
from mocapella.viewer.body_view import BodyView

WIDTH_PX: Final = 560
"""Of a picture in the view."""
RATE_HZ: Final = 30.0


class SilhouetteView:
    """A page for one run; arguments and errors as of `BodyView`."""

    def __init__(self, host: str, port: int, run: SilhouetteRun) -> None:
        # What is shown to a browser in the instant in which it leaves is nobody's concern; viser would warn of it.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        starts = {name: body.pose for name, body in run.tracker.bodies.items()}
        up = upright(*next((body.mesh, body.pose) for body in run.tracker.bodies.values()))
        self._view = BodyView(host, port, run.meshes, run.rig, starts=starts, up=up)

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return self._view.url

    def tell(self, step: Step) -> None:
        """Show a step."""
        pictures = {name: EncodedPicture(jpeg(one)) for name, one in step.pictures(WIDTH_PX).items()}
        bodies = {
            name: ShownBody(one.followed.pose, one.row.overlap, one.row.left_out, one.row.lost)
            for name, one in step.people.items()
        }
        time_s = next(one.row.time_s for one in step.people.values())
        self._view.add(BodyViewFrame(step.frame, time_s, bodies, pictures))
        self._view.show(time.monotonic())

    def stay(self, stop: threading.Event, seconds: float | None = None) -> None:
        """All frames have been: what was followed can be looked at until ``stop`` is set, or for some seconds."""
        self._view.end()
        end_s = None if seconds is None else time.monotonic() + seconds
        for now_s in beats(RATE_HZ, stop):
            self._view.show(now_s)
            if end_s is not None and now_s >= end_s:
                return

    def close(self) -> None:
        """Serve no more."""
        self._view.close()
