"""A run of silhouettes whose rows a test can look at."""

from __future__ import annotations

from mocapella.live.silhouette_run import SilhouetteRun
from mocapella.tracker.frame_sync import FrameSyncSettings
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouettes import SilhouettesTracker


class RunWithRows(SilhouetteRun):
    """Keeps what it found, which the run itself does not.

    Attributes:
        rows: of all frames so far, by name.
    """

    def __init__(self, meshes, rig, poses, hz=30.0, **how):
        bodies = {name: InitialBody(mesh, poses[name]) for name, mesh in meshes.items()}
        super().__init__(SilhouettesTracker(bodies, rig, sync=FrameSyncSettings(period_s=1 / hz), **how))
        self.rows = {name: [] for name in meshes}

    def step(self, shown):
        step = super().step(shown)
        for name, one in step.people.items():
            self.rows[name].append(one.row)
        return step
