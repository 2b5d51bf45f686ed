"""The take of `mocapella track silhouettes --record`: it refers to the videos by path and checksum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mocapella.cli.common import record_file, say
from mocapella.errors import SettingsError
from mocapella.live.file_take import FileTake
from mocapella.live.silhouette_run import KEYPOINT_NODE, SilhouetteRun
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.gltf import mesh_bytes
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.session import Setup
from mocapella.model.twist_tree import TreePose
from mocapella.sensing.images import as_png
from mocapella.sources.referenced_images import checksum, referred
from mocapella.tracker import make_tracker
from mocapella.tracker.silhouettes_setup import body_setup

if TYPE_CHECKING:
    from mocapella.cli.silhouette_live import LiveWishes
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.video import Frames
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.initial_body import LaterJoints
    from mocapella.tracker.silhouette_start import Body


class RecordedRun:
    """A recorded run, whose tracker is created from the settings stored in the take.

    Args:
        path: file of the new take.
        settings: settings of the method ``silhouettes``, with rig and bodies.
        shown: the videos; the take refers to them by path and checksum.

    Attributes:
        run: tracks the frames; each is written to the take.

    Raises:
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written; nothing is created.
    """

    def __init__(self, path: Path, settings: dict[str, Any], shown: VideoSet) -> None:

        cameras = len(shown.rig.cameras)
        tracker: Any = make_tracker("silhouettes", sensors_expected=cameras, settings=settings)
        self._sums = {name: checksum(video.path) for name, video in shown.videos.items()}
        self._paths = {name: video.path for name, video in shown.videos.items()}
        self._take = FileTake(path, Setup("silhouettes", cameras), settings)
        self._keypoints = 0
        self.run = SilhouetteRun(tracker, say, self._write)

    def _write(self, arrival: Arrival, number: int | None, scene: Scene) -> None:

        frame: Any = arrival.frame
        if frame.node_id == KEYPOINT_NODE:
            stored: Any = frame
            self._keypoints += 1
        elif number is None:
            stored = as_png(frame)
        else:
            name = frame.sensor
            stored = referred(frame, self._paths[name], self._sums[name], number) if frame.format else frame
        self._take.write(stored, arrival, scene)

    def close(self) -> None:
        """End the take, and report its contents."""
        report = self._take.close()
        frames = sum(report.frames.values()) - self._keypoints
        size = f"{report.size_bytes / 1e6:.1f} MB"
        say(f"recorded {frames} images in {report.path} ({size}); the images of videos stay in their files")


def recorded(
    record: str, found: Mapping[str, tuple[Body, TreePose]], later: Mapping[str, Sequence[LaterJoints]],
    shown: FrameSource, wishes: LiveWishes, *, wanted: Frames, fit: Mapping[str, Any],
) -> RecordedRun:  # fmt: skip
    """Create a run over videos that is recorded as a take.

    Args:
        record: value of ``--record``.
        found: bodies and their initial poses, by name.
        later: joints at later instants, by the body's name; a name may be missing.
        shown: the videos.
        wishes: options of the command; live cameras are refused.
        wanted: the frames to track.
        fit: settings of the fit, as of `fit_settings`.

    Raises:
        SettingsError: the sources are live cameras.
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written; nothing is created.
    """

    if wishes.live:
        raise SettingsError(
            "--record is of videos; live cameras are recorded by mocapella serve --method silhouettes --record TAKE"
        )
    settings: dict[str, Any] = {
        "rig": encode_camera_rig(shown.rig),
        "bodies": [
            body_setup(name, body, pose, mesh_bytes(Path(body.model)) if body.sha256 else b"", later.get(name, ()))
            for name, (body, pose) in found.items()
        ],
        "sync": {"period_s": wanted.step / shown.rate_hz},
        **fit,
    }
    run = RecordedRun(record_file(record), settings, cast("VideoSet", shown))
    for note in shown.notes:
        run.run.note(note)
    return run
