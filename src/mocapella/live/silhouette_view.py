"""Show a run's steps in a view of its own, during the run and afterwards."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import inverse
from mocapella.live.silhouette_run import SilhouetteRun, Step
from mocapella.live.view import beats
from mocapella.model.camera import CameraRig
from mocapella.model.images import ImageFrame, image_frame
from mocapella.model.observations import JointState
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedBody, TrackedBodyView, TrackerState
from mocapella.model.topology import topology
from mocapella.sensing.outline_picture import jpeg, outlined
from mocapella.tracker.initial_body import InitialBody
from mocapella.viewer import Viewer
from mocapella.viewer.body_mesh_cache import SHELF
from mocapella.viewer.picture_plane import CameraPicture

UInt8 = NDArray[np.uint8]

WIDTH_PX: Final = 560
"""Width of an image in the view."""
RATE_HZ: Final = 30.0
_NO_LINES: Final = np.zeros((0, 2), np.float32)
_TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Maps a sensor's axes, x left and y up, to a camera's, x right and y down."""


class RunView:
    """A view without a server: shows the scenes and images passed to it.

    Args:
        host: the interface to serve on, and no other.
        port: its port; 0 takes a free one.
        rig: rig of the cameras.
        bodies: initial bodies by name.

    Raises:
        AddressInUseError: another program listens there.
        SettingsError: this machine does not have the address.
    """

    def __init__(self, host: str, port: int, rig: CameraRig, bodies: Mapping[str, InitialBody]) -> None:
        # viser warns if a message is queued for a browser that is just disconnecting.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        self._builds = {name: body.build or f"the mesh of {name!r} in this run" for name, body in bodies.items()}
        for name, body in bodies.items():
            SHELF.put(self._builds[name], body.mesh)
        self.viewer = Viewer(host, port, command=None)
        self.viewer.tell_fields({name: _field_deg(rig, name) for name in rig.cameras})
        self._frames: dict[str, ImageFrame] = {
            name: image_frame(name, None, time_ns=0, size_px=placed.camera.size_px)
            for name, placed in rig.cameras.items()
        }
        self._scene = _first_scene(rig, bodies, self._builds)
        self._pictures: dict[str, CameraPicture] = {}
        self._kept = False
        self.beat()

    @property
    def url(self) -> str:
        """Address for a browser."""
        return self.viewer.url

    def show(self, scene: Scene, images: Mapping[str, UInt8]) -> None:
        """Show a scene, and the images of the same time; they stay until the next call.

        Args:
            scene: the result to draw.
            images: (height, width, 3) uint8 BGR by camera; compressed at most `WIDTH_PX` wide, not kept.
        """
        bodies = tuple(
            body if body.build else msgspec.structs.replace(body, build=self._builds.get(body.name, ""))
            for body in scene.bodies
        )
        self._scene, self._kept = scene.with_parts(bodies=bodies), True
        self._pictures = {
            name: CameraPicture(jpeg(outlined(image, (), min(WIDTH_PX, image.shape[1]))), image.shape[1::-1])
            for name, image in images.items()
        }
        self.beat()

    def beat(self) -> None:
        """Send the present scene and images to browsers; call it at a steady rate while there is no new scene."""
        self.viewer.show(self._scene, self._frames, None, pictures=self._pictures, keep=self._kept)

    def stay(self, stop: threading.Event, seconds: float | None = None) -> None:
        """Keep showing the finished run until ``stop`` is set, or for ``seconds``; None sets no limit."""
        self.viewer.end()
        end_s = None if seconds is None else time.monotonic() + seconds
        for now_s in beats(RATE_HZ, stop):
            self.beat()
            if end_s is not None and now_s >= end_s:
                return

    def close(self) -> None:
        """Stop serving."""
        self.viewer.close()


class SilhouetteView(RunView):
    """A view of one run of `mocapella track silhouettes`: a `RunView` with the rig and the bodies of ``run``."""

    def __init__(self, host: str, port: int, run: SilhouetteRun) -> None:
        super().__init__(host, port, run.rig, run.tracker.bodies)

    def tell(self, step: Step) -> None:
        """Show a step's scene and images."""
        self.show(step.scene, step.images)


def _first_scene(rig: CameraRig, bodies: Mapping[str, InitialBody], builds: Mapping[str, str]) -> Scene:
    """Return a scene of the initial bodies, before the first step."""
    views = tuple(TrackedBodyView(camera, np.nan, "", _NO_LINES, _NO_LINES) for camera in rig.cameras)
    made = tuple(
        TrackedBody(
            k, name, builds[name], body.pose.T_world_model, body.pose.angles, body.mesh.joint_names,
            tuple(body.mesh.landmarks), landmarks_at(body.mesh, body.pose),
            np.full(len(body.mesh.landmarks), JointState.NOT_TRACKED, np.uint8), lost=False, views=views,
        )
        for k, (name, body) in enumerate(bodies.items())
    )  # fmt: skip
    places = tuple(
        SensorPlace(name, inverse(placed.T_camera_world) @ _TO_SENSOR) for name, placed in rig.cameras.items()
    )
    state = TrackerState(Phase.WAITING_FOR_SENSORS)
    return Scene(-1, 0, "", 0, 0, topology("kinect_v2"), state, {"bodies": made}, places)


def _field_deg(rig: CameraRig, name: str) -> tuple[float, float]:
    """Return a camera's horizontal and vertical field of view [°], without distortion."""
    camera = rig.cameras[name].camera
    across, high = np.degrees(2 * np.arctan(0.5 * np.array(camera.size_px) / camera.lens[:2]))
    return float(across), float(high)
