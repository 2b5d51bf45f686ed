"""Intel RealSense cameras, by the package ``pyrealsense2``.

librealsense's API: ``pipeline.start(config)`` returns a profile; ``first_depth_sensor().get_depth_scale()`` of its
device is metres per unit; ``as_video_stream_profile().get_intrinsics()`` of its depth stream is the lens, with the
principal point in pixels from the centre of the first pixel. ``try_wait_for_frames(milliseconds)`` returns (success,
frames), and a frame's ``get_timestamp()`` is in milliseconds. ``get_extrinsics_to(stream)`` has the rotation by columns
and the translation in metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mocapella.sources.depth_cameras.device import DepthDevice, Stamped, motion_rows
from mocapella.sources.picture_source import ColourCamera, SourceState


class RealSenseCamera(DepthDevice):
    """An Intel RealSense depth camera; arguments as in `DepthDevice`.

    It is selected by its serial number; the first one is used if ``which`` is empty. Unit and lens are the camera's
    own; a distortion model other than Brown's is treated as no distortion, with a note.
    """

    packages = ("pyrealsense2",)
    install = "install pyrealsense2 into the same environment"
    _pipeline: Any = None

    def _start(self, package: Any) -> SourceState:
        rs, o = package, self.options
        config = rs.config()
        if self.which:
            config.enable_device(self.which)
        if o.size_px is not None:
            config.enable_stream(rs.stream.depth, *o.size_px, rs.format.z16, round(o.fps or 30))
        elif o.fps is not None:
            config.enable_stream(rs.stream.depth, rs.format.z16, round(o.fps))
        else:
            config.enable_stream(rs.stream.depth)
        if o.colour:
            config.enable_stream(rs.stream.color, rs.format.bgr8, round(o.fps or 30))
        pipeline = rs.pipeline()
        profile = pipeline.start(config)
        self._pipeline = pipeline
        unit_m = float(profile.get_device().first_depth_sensor().get_depth_scale())
        video = profile.get_stream(rs.stream.depth).as_video_stream_profile()
        seen = video.get_intrinsics()
        lens, problems = _lens(rs, seen)
        colour = None
        if o.colour:
            other = profile.get_stream(rs.stream.color).as_video_stream_profile()
            beside = other.get_intrinsics()
            colour_lens, more = _lens(rs, beside)
            problems = (*problems, *(f"colour: {text}" for text in more))
            motion = video.get_extrinsics_to(other)
            R = np.reshape(motion.rotation, (3, 3)).T
            colour = ColourCamera((beside.width, beside.height), colour_lens, motion_rows(R, motion.translation))
        return SourceState(
            (seen.width, seen.height), float(video.fps()), problems=problems, unit_m=unit_m, lens=lens, colour=colour
        )

    def _next(self, wait_s: float) -> Stamped | None:
        there, frames = self._pipeline.try_wait_for_frames(round(1e3 * wait_s))
        depth = frames.get_depth_frame() if there else None
        if not depth:
            return None
        image = np.array(depth.get_data(), dtype=np.uint16)
        if not self.options.colour:
            return Stamped(image, depth.get_timestamp() / 1e3)
        colour = frames.get_color_frame()
        if not colour:
            return None
        return Stamped(image, depth.get_timestamp() / 1e3, np.array(colour.get_data(), dtype=np.uint8))

    def _stop(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.stop()


def _lens(rs: Any, seen: Any) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Return a stream's lens (9,) and the problems with it."""
    coefficients = tuple(map(float, seen.coeffs))
    problems: tuple[str, ...] = ()
    if seen.model != rs.distortion.brown_conrady and any(coefficients):
        problems = (f"its lens is distorted by the model {seen.model}, which is treated as undistorted",)
        coefficients = (0.0,) * 5
    return (*map(float, (seen.fx, seen.fy, seen.ppx, seen.ppy)), *coefficients), problems
