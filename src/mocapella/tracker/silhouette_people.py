"""Several bodies that are followed by their silhouettes at once.

Where somebody else is expected, an image says nothing of a body: neither that it is there nor that it is not. So people
who pass in front of each other are held by the cameras that see them apart, and by where they were going.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouettes import Followed, SilhouetteTracker

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

GROWN_PX = 4
"""So near to where somebody is expected, pixels may be of them [px]."""


class SilhouettePeople:
    """Bodies by name; each begins when it is told where it is.

    Attributes:
        trackers: by name.
        others: (height, width) by name and camera, where the last frame was of others and said nothing of them.
    """

    def __init__(
        self, meshes: Mapping[str, RiggedMesh], rig: CameraRig, settings: SilhouetteSettings | None = None
    ) -> None:
        self.trackers = {name: SilhouetteTracker(mesh, rig, settings) for name, mesh in meshes.items()}
        self.others: dict[str, dict[str, Bool]] = {}
        self._followed: set[str] = set()

    def start(self, name: str, pose: TreePose, time_ns: int) -> None:
        """Somebody is about there, and at rest.

        Raises:
            SettingsError: there is nobody of that name, or no camera sees a body there.
        """
        if name not in self.trackers:
            raise SettingsError(f"there is no body {name!r}; known: {one_of(name, self.trackers)}")
        self.trackers[name].start(pose, time_ns)
        self._followed.add(name)

    def stop(self, name: str) -> None:
        """Follow somebody no more."""
        self._followed.discard(name)

    def learn_background(self, images: Mapping[str, UInt8]) -> None:
        """Take in images of the empty room, as of `SilhouetteTracker`."""
        for tracker in self.trackers.values():
            tracker.learn_background(images)

    def update(self, images: Mapping[str, UInt8], time_ns: int, waiting: Collection[str] = ()) -> dict[str, Followed]:
        """Everybody who is followed, in the next frame.

        Args:
            images: of one instant, by camera.
            time_ns: of capture.
            waiting: who is looked for where they were last, and covers nothing there.
        """
        present = {name: tracker for name, tracker in self.trackers.items() if name in self._followed}
        covered = {
            name: tracker.covered(tracker.expected(time_ns), GROWN_PX)
            for name, tracker in present.items()
            if len(present) > 1 and name not in waiting
        }
        out, self.others = {}, {}
        for name, tracker in present.items():
            others: dict[str, Bool] = {}
            for other, masks in covered.items():
                if other != name:
                    others = {camera: mask | others.get(camera, False) for camera, mask in masks.items()}
            self.others[name] = others
            out[name] = tracker.update(images, time_ns, others)
        return out
