"""OAK cameras of Luxonis (OAK-D and later), by the package ``depthai``, version 3.

``Device(info)`` opens a camera of ``Device.getAllAvailableDevices()``, and ``Pipeline(device)`` its processing: a node
``StereoDepth`` makes depth images in millimetres (``RAW16``, 0 is not measured), rectified and so without distortion.
With colour, depth is aligned to the undistorted images of the camera ``CAM_A``: by the input ``inputAlignTo`` of
``StereoDepth``, on the platform RVC4 by a node ``ImageAlign``; a node ``Sync`` pairs images of one instant. An image's
``getTransformation().getIntrinsicMatrix()`` is its lens, and ``getTimestamp()`` its time on the host's monotonic clock.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any, Final

import numpy as np

from mocapella.errors import InputError
from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, none_there
from mocapella.sources.picture_source import ColourCamera, SourceState

SIZE_PX: Final = (640, 400)
"""Size of the images unless another is requested: a mono sensor's pixels, two by two."""
FPS: Final = 30.0
FIRST_S: Final = 5.0
"""Longest wait for the first image, which has the lens [s]."""
LEAST_VERSION: Final = 3
QUEUE: Final = 2
"""Most images that wait to be read; older ones are dropped."""


class OakCamera(DepthDevice):
    """An OAK camera with a stereo pair; arguments as in `DepthDevice`.

    It is selected by its number, at most three digits, or else by its device id, IP address or USB port. The lens is
    the camera's own; with colour, depth images have the pixels of the colour images.
    """

    packages = ("depthai",)
    install = "install depthai, version 3 or later, into the same environment"
    _device: Any = None
    _pipeline: Any = None
    _queue: Any = None
    _first: Any = None

    def _errors(self, package: Any) -> tuple[type[BaseException], ...]:
        return (package.MessageQueue.QueueException, RuntimeError, OSError)

    def _start(self, package: Any) -> SourceState:
        dai = package
        if int(dai.__version__.partition(".")[0]) < LEAST_VERSION:
            raise InputError(f"is driven by depthai {dai.__version__}", file=self.name, fix=self.install)
        self._device = dai.Device(self._info(dai))
        self._device.setMaxReconnectionAttempts(0)  # `DepthDevice` looks for a lost camera again
        if not self._device.getAvailableStereoPairs():
            fix = "name an OAK-D; an OAK-1 is a colour camera"
            raise InputError("has no pair of cameras for depth", file=self.name, fix=fix)
        size, fps = self.options.size_px or SIZE_PX, float(self.options.fps or FPS)
        self._pipeline = dai.Pipeline(self._device)
        self._queue = self._output(dai, size, fps).createOutputQueue(maxSize=QUEUE, blocking=False)
        self._pipeline.start()
        first = self._first = self._queue.get(timedelta(seconds=FIRST_S))
        if first is None:
            raise InputError(f"gave no image within {FIRST_S:g} s", file=self.name, fix="plug it in again")
        image = first["depth"] if self.options.colour else first
        size_px, lens = (image.getWidth(), image.getHeight()), _lens(image)
        colour = ColourCamera(size_px, lens) if self.options.colour else None
        return SourceState(size_px, fps, unit_m=0.001, lens=lens, colour=colour)

    def _info(self, dai: Any) -> Any:
        """The device to open.

        Raises:
            InputError: there is none of this number.
        """
        if len(self.which) > 3 or not self.which.isdigit():
            return dai.DeviceInfo(self.which)
        devices = dai.Device.getAllAvailableDevices()
        if self._index() >= len(devices):
            raise none_there(self.name, len(devices))
        return devices[self._index()]

    def _output(self, dai: Any, size: tuple[int, int], fps: float) -> Any:
        """Make the nodes; return the output of depth images, or of groups ``depth`` and ``colour`` with colour.

        Raises:
            InputError: it has no colour camera.
        """
        pipeline = self._pipeline
        stereo = pipeline.create(dai.node.StereoDepth).build(autoCreateCameras=True, size=size, fps=fps)
        if not self.options.colour:
            return stereo.depth
        if dai.CameraBoardSocket.CAM_A not in self._device.getConnectedCameras():
            fix = "use it for its depth alone, or another camera"
            raise InputError("has no colour camera beside its pair", file=self.name, fix=fix)
        camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A)
        colour = camera.requestOutput(size, fps=fps, enableUndistortion=True)
        aligned = stereo.depth
        if self._device.getPlatform() == dai.Platform.RVC4:
            align = pipeline.create(dai.node.ImageAlign)
            stereo.depth.link(align.input)
            colour.link(align.inputAlignTo)
            aligned = align.outputAligned
        else:
            colour.link(stereo.inputAlignTo)
        sync = pipeline.create(dai.node.Sync)
        sync.setSyncThreshold(timedelta(seconds=0.5 / fps))
        aligned.link(sync.inputs["depth"])
        colour.link(sync.inputs["colour"])
        return sync.out

    def _next(self, wait_s: float) -> Stamped | None:
        first, self._first = self._first, None
        found = first if first is not None else self._queue.get(timedelta(seconds=wait_s))
        if found is None:
            return None
        image = found["depth"] if self.options.colour else found
        colour = np.array(found["colour"].getCvFrame(), dtype=np.uint8) if self.options.colour else None
        return Stamped(np.array(image.getFrame(), dtype=np.uint16), image.getTimestamp().total_seconds(), colour)

    def _stop(self) -> None:
        pipeline, device = self._pipeline, self._device
        self._pipeline = self._device = self._queue = self._first = None
        try:
            if pipeline is not None:
                pipeline.stop()
        finally:
            if device is not None:
                device.close()


def _lens(image: Any) -> tuple[float, ...]:
    """Return the lens (9,) of a rectified or undistorted image."""
    K = image.getTransformation().getIntrinsicMatrix()
    return (float(K[0][0]), float(K[1][1]), float(K[0][2]), float(K[1][2]), 0.0, 0.0, 0.0, 0.0, 0.0)
