"""Track several bodies by their silhouettes at once.

Pixels where another person is expected are no evidence for or against a body. People who pass in front of each other
are therefore tracked by the cameras that see them apart, and by their predicted motion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.body_fitter import BodyFitter, FittedBody
from mocapella.tracker.silhouette_keypoints import BodyKeypoints, SeenKeypoints, keypoints_of_bodies
from mocapella.tracker.silhouette_settings import SilhouetteSettings

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

GROWN_PX = 4
"""Margin around another person's expected pixels; pixels inside it may be that person's [px]."""


class BodiesFitter:
    """The fitters of all bodies, by name; a body is tracked once `start` has set its pose.

    Args:
        meshes: mesh of each body, by the body's name.
        rig: the cameras' intrinsics and poses.
        settings: the settings of every stage; the defaults if None.

    Attributes:
        fitters: the fitter of each body, by the body's name.
        others: (height, width) masks, by body and camera: pixels that the other bodies were expected to cover in the
            last frame.
    """

    def __init__(
        self, meshes: Mapping[str, RiggedMesh], rig: CameraRig, settings: SilhouetteSettings | None = None
    ) -> None:
        self.fitters = {name: BodyFitter(mesh, rig, settings) for name, mesh in meshes.items()}
        self.others: dict[str, dict[str, Bool]] = {}
        self._followed: set[str] = set()

    def start(self, name: str, pose: TreePose, time_ns: int, *, there: bool = False) -> None:
        """Begin or restart the tracking of a body at an approximate pose, at rest; a restart keeps its backgrounds.

        Args:
            name: name of the body.
            pose: approximate pose of the body.
            time_ns: time of the pose, on the common clock.
            there: whether the person is certainly there, see `BodyFitter.start`.

        Raises:
            SettingsError: no body has that name, or no camera sees it there at its first start.
        """
        if name not in self.fitters:
            raise SettingsError(f"there is no body {name!r}; known: {one_of(name, self.fitters)}")
        self.fitters[name].start(pose, time_ns, there=there)
        self._followed.add(name)

    def stop(self, name: str) -> None:
        """Stop tracking a body until its next `start`; an unknown name is ignored."""
        self._followed.discard(name)

    def memory(self) -> list[Any]:
        """Return all state between two frames, for `recall` and a tracker's snapshot; after `start` of all.

        Its mutable values are shared, not copied.
        """
        return [{name: fitter.memory() for name, fitter in self.fitters.items()}, self._followed]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same bodies, rig and settings."""
        fitters, self._followed = memory
        for name, fitter in self.fitters.items():
            fitter.recall(fitters[name])

    def reset(self) -> None:
        """Forget all poses and backgrounds; no body is tracked until its next `start`."""
        self._followed, self.others = set(), {}
        for fitter in self.fitters.values():
            fitter.reset()

    def learn_background(self, images: Mapping[str, UInt8]) -> None:
        """Learn every fitter's background model from images of the empty room; after `start` of all.

        ``images`` are (height, width) or (height, width, 3) uint8 BGR, by camera; unknown cameras are ignored.

        Raises:
            InputError: an image of another size than before.
        """
        for fitter in self.fitters.values():
            fitter.learn_background(images)

    def update(
        self,
        images: Mapping[str, UInt8],
        time_ns: int,
        waiting: Collection[str] = (),
        keypoints: Mapping[str, SeenKeypoints] | None = None,
    ) -> dict[str, FittedBody]:
        """Fit every tracked body to the next frame.

        Args:
            images: simultaneous images (height, width) or (height, width, 3) uint8 BGR, by camera; some may be missing.
            time_ns: capture time, on the common clock.
            waiting: names of lost bodies; they are fitted, but their predicted pixels stay evidence for other bodies.
            keypoints: all people's keypoints in these images, by camera; None for none. Lost bodies get none.

        Returns:
            The fitted bodies, by name; a body that was not started, or was stopped, is missing.
        """
        present = {name: fitter for name, fitter in self.fitters.items() if name in self._followed}
        covered = {
            name: fitter.covered(fitter.expected(time_ns), GROWN_PX)
            for name, fitter in present.items()
            if len(present) > 1 and name not in waiting
        }
        of_bodies = self._keypoints_of(present, time_ns, waiting, keypoints) if keypoints else {}
        out, self.others = {}, {}
        for name, fitter in present.items():
            others: dict[str, Bool] = {}
            for other, masks in covered.items():
                if other != name:
                    others = {camera: mask | others.get(camera, False) for camera, mask in masks.items()}
            self.others[name] = others
            out[name] = fitter.update(images, time_ns, others, keypoints=of_bodies.get(name))
        return out

    def _keypoints_of(
        self,
        present: Mapping[str, BodyFitter],
        time_ns: int,
        waiting: Collection[str],
        keypoints: Mapping[str, SeenKeypoints],
    ) -> dict[str, BodyKeypoints]:
        """Return the keypoints of each body that is not lost, by name."""
        places = {
            name: ([*fitter.mesh.landmarks], fitter.body.standing(fitter.expected(time_ns)).landmarks)
            for name, fitter in present.items()
            if name not in waiting
        }
        if not places:
            return {}
        first = present[next(iter(places))]
        return keypoints_of_bodies(keypoints, places, first.eyes, first.settings.keypoints)
