"""A run of silhouettes whose rows a test can look at."""

from __future__ import annotations

from mocapella.live.silhouette_run import SilhouetteRun


class RunWithRows(SilhouetteRun):
    """Keeps what it found, which the run itself does not.

    Attributes:
        rows: of all frames so far, by name.
    """

    def __init__(self, meshes, rig, settings=None, say=lambda _text: None):
        super().__init__(meshes, rig, settings, say)
        self.rows = {name: [] for name in meshes}

    def step(self, shown):
        step = super().step(shown)
        for name, one in step.people.items():
            self.rows[name].append(one.row)
        return step
