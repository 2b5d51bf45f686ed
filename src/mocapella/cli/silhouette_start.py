"""What `mocapella silhouettes` begins with: whose body it is, where it is at first, and what is behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mocapella.cli.common import say
from mocapella.errors import InputError, SettingsError

if TYPE_CHECKING:
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.model.camera import CameraRig
    from mocapella.model.twist_tree import TreePose
    from mocapella.sources.video import Frames
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.silhouette_start import Body

MESH_FILES: Final = (".glb", ".gltf")
BACKGROUNDS: Final = 30
"""So many images of an empty room say all that more would."""


@dataclass(frozen=True)
class StartWishes:
    """What the command line says of the start; see the command's options."""

    start: str | None
    points: Sequence[Path]
    model: str | None
    height_m: float | None
    order: str


def find_start(wishes: StartWishes, rig: CameraRig, frames: Frames) -> tuple[Body, TreePose]:
    """The body, and where it is in the first frame.

    Raises:
        SettingsError, InputError, CalibrationError: nothing says it, or nothing that can be.
    """
    from mocapella.recording.followed_bodies import is_followed_body, named_joints, read_json
    from mocapella.tracker.silhouette_start import joints_of_points

    if wishes.start is not None and wishes.points:
        raise SettingsError("--start and --points are both given; choose one of them")
    if wishes.points:
        from mocapella.recording.viewed_tracks import read_viewed_tracks

        tracks = read_viewed_tracks(_folders(wishes.points), order=wishes.order)
        return _of_joints(wishes, joints_of_points(tracks, rig, frames.first), wishes.points[0])
    if wishes.start is None:
        raise SettingsError(
            "nothing says where the body is at first; give --start joints.json, an earlier result, or --points with "
            "the first frame's keypoints"
        )
    path, number = _path_and_frame(wishes.start)
    data = read_json(path)
    if is_followed_body(data):
        return _of_earlier(wishes, path, frames.first if number is None else number, chosen=number is not None)
    if number is not None:
        raise SettingsError(f"--start {wishes.start}: {path} has joints of one instant; leave :{number} out")
    return _of_joints(wishes, named_joints(data, path), path)


def _of_joints(wishes: StartWishes, joints: Mapping[str, object], path: Path) -> tuple[Body, TreePose]:
    from mocapella.tracker.silhouette_start import body_of, check_joints, start_pose

    name = wishes.model or "male"
    if name.lower().endswith(MESH_FILES):
        body = _of_file(wishes)
    else:
        check_joints(name, joints, path)  # type: ignore[arg-type]
        body = body_of(name, wishes.height_m, joints)  # type: ignore[arg-type]
    return body, start_pose(body.mesh, joints)  # type: ignore[arg-type]


def _of_file(wishes: StartWishes) -> Body:
    from mocapella.model.body_proportions import AVERAGE
    from mocapella.model.rigged_mesh_file import load_rigged_mesh
    from mocapella.tracker.silhouette_start import Body

    assert wishes.model is not None
    if wishes.height_m is not None:
        raise SettingsError(f"--height {wishes.height_m:g}: the model of {wishes.model} has its own size; leave it out")
    return Body(wishes.model, None, AVERAGE, load_rigged_mesh(Path(wishes.model)))


def _of_earlier(wishes: StartWishes, path: Path, number: int, *, chosen: bool) -> tuple[Body, TreePose]:
    """Of the frame of that number; of the last one, where that was not ``chosen`` and is not there."""
    from mocapella.recording.followed_bodies import read_followed_body
    from mocapella.tracker.silhouette_start import body_again, body_of

    earlier = read_followed_body(path)
    frame = next((one for one in earlier.frames if one.frame == number), None)
    if frame is None:
        first, last = earlier.frames[0].frame, earlier.frames[-1].frame
        if chosen:
            raise InputError(
                "has no such frame", file=path, field="frame", value=number, fix=f"it has frames from {first} to {last}"
            )
        frame = earlier.frames[-1]
        say(f"{path} has no frame {number}: starting as in its last one, {last}")
    if wishes.model is not None and wishes.model != earlier.model:
        raise SettingsError(f"--model {wishes.model}: {path} is of the model {earlier.model}; leave --model out")
    if earlier.model.lower().endswith(MESH_FILES):
        body = _of_file(StartWishes(None, (), earlier.model, wishes.height_m, wishes.order))
    elif wishes.height_m is None:
        body = body_again(earlier.model, earlier.height_m, earlier.proportions)
    else:
        body = body_of(earlier.model, wishes.height_m, {})
    missing = [name for name in body.mesh.joint_names if name not in frame.angles]
    if missing:
        raise InputError(
            "is missing", file=path, field=f"frames[{frame.frame}].angles.{missing[0]}",
            fix="start from a file of the same model",
        )  # fmt: skip
    return body, frame.pose(body.mesh.joint_names)


def begin(run: SilhouetteRun, pose: TreePose, frames: Frames, words: str) -> None:
    """Start the tracker, and say in which cameras nobody is seen.

    Raises:
        InputError: no camera sees the body there.
    """
    from mocapella.tracker.silhouette_start import cameras_that_see

    seen = cameras_that_see(run.mesh, pose, run.rig)
    if not seen:
        x, y, z = pose.T_world_model[:3, :3] @ run.mesh.tree.root + pose.T_world_model[:3, 3]
        raise InputError(
            f"the body would start at ({x:.2f}, {y:.2f}, {z:.2f}) m, which is outside of all images", field="start",
            value=words, fix="give joints in the rig's world, in metres, of the frame with which the videos begin",
        )  # fmt: skip
    run.start(pose, frames.first, frames.step)
    for name in run.rig.cameras:
        if name not in seen:
            run.note(f"at the start the body is outside of {name}'s image")


def learn(run: SilhouetteRun, texts: Sequence[str], rig: CameraRig, shown: VideoSet, other_size: str | None) -> None:
    """Take in the images of the empty room.

    Raises:
        InputError: one cannot be read, or is of another size than that camera's video.
    """
    from mocapella.cli.calibrate import named_inputs
    from mocapella.sources.video import Frames, pictures
    from mocapella.sources.video_set import VideoSet

    inputs = {name: Path(path) for name, path in named_inputs(texts).items()}
    empty = VideoSet(inputs, rig, rate_hz=1.0, other_size=other_size)
    for name, video in empty.videos.items():
        if name not in shown.videos:
            raise InputError(
                "is of a camera that has no video", file=video.path, field="--background", value=name,
                fix=f"the videos are of {', '.join(shown.videos)}",
            )  # fmt: skip
        if video.size_px != shown.videos[name].size_px:
            raise InputError(
                "is of another size than the video", file=video.path, field="size", value=video.size_px,
                fix=f"{shown.videos[name].path} has {shown.videos[name].size_px}",
            )  # fmt: skip
        step = max(1, (video.count or 1) // BACKGROUNDS)
        for _, image in pictures(video.path, Frames(0, step * BACKGROUNDS, step)):
            run.tracker.learn_background({name: image})
            run.empty.learn({name: image})
    missing = [name for name in shown.rig.cameras if name not in empty.videos]
    if missing:
        run.note(f"no empty room is known of {', '.join(missing)}: what is behind the body is learnt on the way there")


def _path_and_frame(text: str) -> tuple[Path, int | None]:
    path, colon, number = text.rpartition(":")
    return (Path(path), int(number)) if colon and number.isdecimal() and not Path(text).exists() else (Path(text), None)


def _folders(paths: Sequence[Path]) -> list[Path]:
    """Of one folder that has no JSON but folders with some, those."""
    if len(paths) == 1 and paths[0].is_dir() and not any(paths[0].glob("*.json")):
        inner = sorted(one for one in paths[0].iterdir() if one.is_dir() and any(one.glob("*.json")))
        return inner or list(paths)
    return list(paths)
