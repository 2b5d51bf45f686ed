"""Recordings of depth images from paths on the command line: files, folders, takes and rendered scenes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.live.recordings import find_recording, is_take
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.frame_types import frame_type_of
from mocapella.model.sensor_frame import SensorFrame
from mocapella.recording.disk import SUFFIX
from mocapella.recording.take_reader import Take, read_take
from mocapella.sensing.line_skeleton_sheet import write_pictures
from mocapella.sources.depth_cameras import CAMERAS
from mocapella.sources.depth_files import DepthFiles, DepthRecording, RecordedDepth
from mocapella.sources.depth_options import KINECT_RAW, DepthOptions, parse_lens, parse_unit
from mocapella.sources.open_depth import RENDERED
from mocapella.sources.picture_source import SourceState


class _DepthImage(Protocol):
    """Fields of a frame whose type (`mocapella.model.frame_types.FrameType`) has ``depth_images`` set."""

    @property
    def time_ns(self) -> int: ...
    @property
    def depth(self) -> NDArray[np.uint16]: ...
    @property
    def size_px(self) -> tuple[int, int]: ...
    @property
    def unit_m(self) -> float: ...
    @property
    def lens(self) -> NDArray[np.float64]: ...


def depth_options(
    intrinsics: str | None,
    unit: str | None,
    rig: str | None = None,
    fps: float | None = None,
    size_px: tuple[int, int] | None = None,
) -> DepthOptions:
    """Return the depth camera's options on the command line.

    Args:
        intrinsics: value of ``--intrinsics``, read by `parse_lens`; None if not given.
        unit: value of ``--unit``, read by `parse_unit`; None if not given.
        rig: FILE or FILE:CAMERA, for the intrinsics; the camera may be left out if there is only one.
        fps: frame rate to request [Hz]; None if not given.
        size_px: (width, height) to request; None if not given.

    Raises:
        SettingsError: an option cannot be read, or the intrinsics are given twice.
        InputError: the rig's file cannot be read, or has no such camera.
    """
    if rig is not None and intrinsics is not None:
        raise SettingsError("--rig and --intrinsics both say the lens; leave one of them out")
    lens = parse_lens(intrinsics) if rig is None else _lens_of_rig(rig)
    unit_m, raw = parse_unit(unit)
    return DepthOptions(unit_m, raw, lens, fps, size_px)


def _lens_of_rig(text: str) -> tuple[float, ...]:
    path, name = (text, "") if Path(text).exists() or ":" not in text else text.rsplit(":", 1)
    cameras = load_camera_rig(path).cameras
    if not name and len(cameras) == 1:
        (name,) = cameras
    if name not in cameras:
        fix = f"write --rig {path}:NAME with one of {one_of(name, cameras)}"
        raise InputError("does not say which camera" if not name else f"has no camera {name!r}", file=path, fix=fix)
    return tuple(map(float, cameras[name].camera.lens))


class TakeDepth:
    """The depth images of one sensor of a take; a `mocapella.sources.depth_files.DepthRecording`.

    Args:
        path: the take.
        sensor: name; None if only one sensor sends depth images.
        options: of the command line; they take precedence over the take's values.

    Attributes:
        name: ``TAKE:SENSOR``, for messages.
        sensor: name of the sensor.
        count: number of its frames.
        state: image size, depth unit and lens, and the problems of the take.

    Raises:
        InputError: the take has no depth images, or none of that sensor; or the options name the unit ``kinect-raw``.
        SettingsError: several sensors send depth images, and none is named.
    """

    def __init__(self, path: Path, sensor: str | None, options: DepthOptions | None = None) -> None:
        options = options or DepthOptions()
        if options.kinect_raw:
            fix = "leave --unit out: a take has depths, and says their unit itself"
            raise InputError("has no disparities", file=path, field="unit", value=KINECT_RAW, fix=fix)
        self._take = read_take(path)
        first = {name: frame for name in self._take.sensors if (frame := _first(self._take, name)) is not None}
        if not first:
            fix = "record one with mocapella node arm --set publish_depth=true"
            raise InputError("has no depth images", file=path, fix=fix)
        if sensor is None and len(first) > 1:
            raise SettingsError(f"{path} has several depth cameras; write {path}:NAME with one of {', '.join(first)}")
        self.sensor = next(iter(first)) if sensor is None else sensor
        if self.sensor not in first:
            fix = f"it has those of {one_of(self.sensor, first)}"
            raise InputError(f"has no depth images of {self.sensor!r}", file=path, fix=fix)
        self.name = f"{path}:{self.sensor}"
        self._like = first[self.sensor]
        self.count = sum(node.stored for node in self._take.complete() if node.sensor == self.sensor)
        self.state = SourceState(
            self._like.size_px,
            options.fps,
            problems=self._take.problems,
            unit_m=self._like.unit_m if options.unit_m is None else options.unit_m,
            lens=tuple(self._like.lens.tolist()) if options.lens is None else options.lens,
        )

    def images(self) -> Iterator[RecordedDepth]:
        """Yield the images by sequence number, as `DepthRecording.images`; for a frame of another type, depth None.

        Raises:
            InputError: the image size, unit or lens changes within the take.
        """
        for stored in self._take.frames_in_sequence(self.sensor):
            frame, name = stored.frame, f"{self.name}/{stored.frame.sequence}"
            if not _is_depth_image(frame):
                yield RecordedDepth(name, frame.time_ns, None, "is no depth image")
                continue
            like = self._like
            if (frame.size_px, frame.unit_m) != (like.size_px, like.unit_m) or not np.array_equal(
                frame.lens, like.lens
            ):
                fix = "two cameras had this name; a detector works for one"
                raise InputError("has another size, unit or lens than the first", file=name, fix=fix)
            yield RecordedDepth(name, frame.time_ns, frame.depth)


def _first(take: Take, sensor: str) -> Any:
    """Return a sensor's first frame if it is a depth image, else None."""
    stored = next(take.frames(sensor), None)
    return stored.frame if stored is not None and _is_depth_image(stored.frame) else None


def _is_depth_image(frame: SensorFrame) -> TypeGuard[_DepthImage]:
    kind = frame_type_of(frame)
    return kind is not None and kind.depth_images


def depth_of_take(text: str, options: DepthOptions | None = None) -> TakeDepth | None:
    """Return the depth images of TAKE or TAKE:SENSOR, with or without .mcap; None if the text names no take.

    Raises:
        InputError: there is no file of a name with .mcap; the take has no depth images, or none of that sensor; or the
            options name the unit ``kinect-raw``.
        SettingsError: several sensors send depth images, and none is named.
    """
    name, colon, sensor = text.rpartition(":")
    if not (colon and (name.endswith(SUFFIX) or Path(name + SUFFIX).is_file())):
        name, sensor = text, ""
    path = Path(name)
    if not path.exists():
        try:
            path = find_recording(path)
        except InputError:
            if path.suffix == SUFFIX:
                raise
            return None
    if path.is_dir() or not is_take(path):
        return None
    return TakeDepth(path, sensor or None, options)


def depth_recordings(paths: Sequence[str], options: DepthOptions) -> list[DepthRecording]:
    """Return the recordings of paths: each folder, take or rendered scene is one; consecutive files together are one.

    Raises:
        SettingsError: a path names a live camera or an unknown scene.
        InputError: a path cannot be read.
    """
    found: list[DepthRecording] = []
    files: list[Path] = []

    def close() -> None:
        if files:
            found.append(DepthFiles(files.copy(), options))
            files.clear()

    for text in paths:
        if text.partition(":")[0] in CAMERAS:
            raise SettingsError(f"{text} is a camera; mocapella node arm {text} serves it")
        if text.startswith(f"{RENDERED}:"):
            from mocapella.sources.simulate.rendered_depth import RenderedRecording, rendered_scene

            close()
            found.append(RenderedRecording(rendered_scene(text.partition(":")[2], text), text, options))
            continue
        take = depth_of_take(text, options)
        if take is None and not Path(text).is_dir():
            files.append(Path(text))
            continue
        close()
        found.append(DepthFiles([Path(text)], options) if take is None else take)
    close()
    return found


def write_stages(folder: Path, number: int, file: str, stages: Mapping[str, NDArray[np.uint8]]) -> None:
    """Write images of the stages of one depth image's processing into a new folder in ``folder``.

    Args:
        number: index of the depth image in its recording, from 0.
        file: name of the depth image.
        stages: images by name, in their order.

    Raises:
        SettingsError: the folder cannot be created, or an image cannot be written.
    """
    stem = Path(file).stem if file.endswith(".png") else Path(file).name
    try:
        write_pictures(stages, folder / f"{number:05d}-{stem}")
    except SettingsError as error:
        raise SettingsError(f"--stages {error}") from error
