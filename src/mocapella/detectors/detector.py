"""Interfaces of detectors: the descriptor that registers one, and the object that it makes for one camera.

A detector takes one camera's depth images and returns observations in that camera's frame. Trackers fuse the cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.model.arms import SeenArms
    from mocapella.model.camera import Camera


class ArmDetector(Protocol):
    """Interface of detectors of arms in the depth images of one camera, one image after the other.

    Attributes:
        name: the detector's name, as in its descriptor.
    """

    name: str

    def update(self, depth: NDArray[np.float32], at_s: float) -> SeenArms:
        """Detect the arms in the next image.

        Args:
            depth: (height, width) [m]; 0 where nothing was measured. The caller may reuse its memory afterwards.
            at_s: the image's capture time [s].

        Returns:
            The arms, or the reason why there is none.

        Raises:
            SettingsError: the image has another size than the camera's.
        """
        ...

    def reset(self) -> None:
        """Forget all earlier images."""
        ...


@dataclass(frozen=True)
class Detector:
    """The descriptor of a detector, which turns the images of one camera into observations.

    A descriptor's module imports no kernels, so that names and summaries can be listed quickly; `settings` and `make`
    import their modules when they are called.

    Attributes:
        interface: version of the interface, see `mocapella.registry`.
        name: name on the command line, and in `mocapella.model.arms.ArmFrame.method`.
        summary: one line for users who choose.
        frame_type: type of the frames that a camera's node sends with it, such as ``arms``.
        settings: function that returns the class of its settings, a frozen dataclass.
        make: function that makes a detector for a camera and settings; for the frame type ``arms`` an `ArmDetector`.
        stages: function of a made detector and a depth image, (height, width) [m]. It returns the intermediate results
            of the image processing as images, by name in order: (height, width) gray or (height, width, 3) BGR. It does
            not change the detector's state. None if the detector has no such stages.
    """

    interface: int
    name: str
    summary: str
    frame_type: str
    settings: Callable[[], type[Any]]
    make: Callable[[Camera, Any], Any]
    stages: Callable[[Any, NDArray[np.float32]], Mapping[str, NDArray[np.uint8]]] | None = None
