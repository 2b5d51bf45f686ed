"""Initialisation of `mocapella track silhouettes`: the bodies, their initial poses, and the empty room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mocapella.cli.common import say
from mocapella.cli.silhouette_people import NOBODY, PeopleWishes
from mocapella.errors import InputError, MocapellaError, SettingsError, one_of
from mocapella.settings import check

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.model.camera import CameraRig
    from mocapella.model.point_tracks import ImageTracks
    from mocapella.model.twist_tree import TreePose
    from mocapella.recording.bodies_file import FollowedBody
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.video import Frames
    from mocapella.tracker.initial_body import InitialBody, LaterJoints
    from mocapella.tracker.silhouette_start import Body

    Joints = Mapping[str, NDArray[np.float64]]

MESH_FILES: Final = (".glb", ".gltf")
LEAST_M, MOST_M = 0.5, 2.5
"""Limits of a person's height [m]."""


@dataclass(frozen=True)
class StartWishes:
    """Options of the initialisation, each ``VALUE`` or ``PERSON=VALUE``.

    Attributes:
        starts: files with named joints or an earlier result; ``FILE:NUMBER`` chooses a frame of a result.
        points: files or folders with 2D keypoints, in place of ``starts``.
        models: body models; the default is the file's, or ``male``.
        heights: body heights [m].
        order: OpenPose's pose model, for ``points``.
        people: keypoints of all people, in place of ``starts`` and ``points``.
    """

    starts: Sequence[str] = ()
    points: Sequence[str] = ()
    models: Sequence[str] = ()
    heights: Sequence[str] = ()
    order: str = "auto"
    people: PeopleWishes = NOBODY

    @cached_property
    def tracks(self) -> dict[str, tuple[Path, ImageTracks]]:
        """First path and keypoints by person's name; the files are read once.

        Raises:
            SettingsError, InputError: a person's name is invalid, or the keypoints cannot be read.
        """
        from mocapella.recording.image_tracks_file import read_image_tracks

        paths: dict[str, list[Path]] = {}
        for text in self.points:
            name, value = _person_and_value(text)
            paths.setdefault(name, []).append(Path(value))
        return {name: (one[0], read_image_tracks(_folders(one), order=self.order)) for name, one in paths.items()}


@dataclass(frozen=True)
class _Wish:
    """Model and height wished for one person; None if not given."""

    model: str | None
    height_m: float | None


@dataclass(frozen=True)
class _Earlier:
    """A person's pose in an earlier result.

    Attributes:
        path: file of the result.
        body: the person's body in it.
        number: number of the frame.
        chosen: whether that frame was named on the command line.
    """

    path: Path
    body: FollowedBody
    number: int
    chosen: bool


@dataclass(frozen=True)
class _Found:
    """A person's joints in a file, and the model that the file names for them."""

    path: Path
    joints: Joints
    wish: _Wish


def find_start(wishes: StartWishes, rig: CameraRig, frames: Frames) -> dict[str, tuple[Body, TreePose]]:
    """Return the bodies and their initial poses by person's name; a single body without a name has the name `ALONE`.

    Args:
        wishes: options of the initialisation.
        rig: the cameras, for the triangulation of keypoints.
        frames: the frames of the videos to track; of a file with several frames, the one with the first one's number.

    Raises:
        SettingsError, InputError, CalibrationError: the options define no initial pose, or an impossible one.
    """
    from mocapella.recording.bodies_file import ALONE
    from mocapella.tracker.silhouette_start import check_apart

    if (bool(wishes.starts), bool(wishes.points), wishes.people.given).count(True) > 1:
        if wishes.starts and wishes.points:
            raise SettingsError("--start and points are both given; choose one of them")
        raise SettingsError("keypoints or detector are given beside --start or points; choose one of them")
    sources: dict[str, _Found | _Earlier]
    if wishes.people.given:
        path = Path(", ".join(wishes.people.paths) or "films")
        sources = {name: _Found(path, one.start, _Wish(None, None)) for name, one in wishes.people.joints.items()}
    elif wishes.points:
        sources = _of_points(wishes, rig, frames)
    elif wishes.starts:
        sources = _of_files(wishes, frames)
    else:
        raise SettingsError(
            "nothing says where the body is at first; give --start joints.json, an earlier result, --set "
            "keypoints=FOLDER with keypoints of all people, or --set detector=NAME to detect them"
        )
    if ALONE in sources and len(sources) > 1:
        option = "--set points" if wishes.points else "--start"
        raise SettingsError(f"{option} is given both with and without a name: write {option} anna=FILE for each")
    models, heights = _by_person("model", wishes.models, sources), _by_person("height", wishes.heights, sources)
    found = {}
    for name, source in sources.items():
        wish = _Wish(models.get(name), None if name not in heights else _metres(heights[name]))
        try:
            found[name] = _of_joints(wish, source) if isinstance(source, _Found) else _of_earlier(wish, source)
        except MocapellaError as error:
            if name == ALONE:
                raise
            raise type(error)(f"{name}: {error}") from error
    check_apart({name: (body.mesh, pose) for name, (body, pose) in found.items()})
    return found


def find_later(wishes: StartWishes, rig: CameraRig, frames: Frames, rate_hz: float) -> dict[str, list[LaterJoints]]:
    """Return the joints of the keypoints' later frames, by person's name; none without keypoints.

    Args:
        wishes: options of the initialisation.
        rig: the cameras, for the triangulation of keypoints.
        frames: the frames of the videos to track.
        rate_hz: frame rate of the videos, before the selection [Hz].

    Raises:
        InputError: the keypoints cannot be read.
    """
    from mocapella.tracker.silhouette_start import later_joints

    if wishes.people.given:
        return {name: one.later for name, one in wishes.people.joints.items()}
    return {name: later_joints(tracks, rig, frames.first, rate_hz) for name, (_, tracks) in wishes.tracks.items()}


def _of_points(wishes: StartWishes, rig: CameraRig, frames: Frames) -> dict[str, _Found | _Earlier]:
    from mocapella.tracker.silhouette_start import joints_of_points

    found: dict[str, _Found | _Earlier] = {}
    for name, (path, tracks) in wishes.tracks.items():
        for note in tracks.notes:
            say(f"{path}: {note}")
        found[name] = _Found(path, joints_of_points(tracks, rig, frames.first), _Wish(None, None))
    return found


def _of_files(wishes: StartWishes, frames: Frames) -> dict[str, _Found | _Earlier]:
    from mocapella.recording.bodies_file import (
        ALONE,
        is_followed_body,
        is_followed_people,
        joints_of_people,
        read_followed_people,
        read_json,
    )

    found: dict[str, _Found | _Earlier] = {}
    for text in wishes.starts:
        whose, value = _person_and_value(text)
        path, number = _path_and_frame(value)
        data, people = read_json(path), dict[str, _Found | _Earlier]()
        if is_followed_people(data) or is_followed_body(data):
            at = frames.first if number is None else number
            for name, body in read_followed_people(path).items():
                people[name] = _Earlier(path, body, at, number is not None)
        elif number is not None:
            raise SettingsError(f"--start {value}: {path} has joints of one instant; leave :{number} out")
        else:
            joints, about = _without_models(data, path)
            people |= {
                name: _Found(path, at, about.get(name, _Wish(None, None)))
                for name, at in joints_of_people(joints, path).items()
            }
        if whose != ALONE and ALONE not in people:
            if whose not in people:
                raise SettingsError(f"--start {text}: {path} has no person called {whose!r}; {one_of(whose, people)}")
            people = {whose: people[whose]}
        elif whose != ALONE:
            people = {whose: people[ALONE]}
        for name, one in people.items():
            if name in found:
                called = f"are both of {name}; name each person once" if name else (
                    "have no person's name; write --start anna=FILE for each"
                )  # fmt: skip
                raise SettingsError(f"--start: {found[name].path} and {path} {called}")
            found[name] = one
    return found


def _without_models(data: Any, path: Path) -> tuple[Any, dict[str, _Wish]]:
    """Return named joints without ``model`` and ``height_m``, and these two by person.

    Raises:
        InputError: a model or height is invalid.
    """
    from mocapella.recording.bodies_file import ALONE

    if not isinstance(data, dict):
        return data, {}
    several = bool(data) and all(isinstance(one, dict) for one in data.values())
    rest: dict[str, Any] = {}
    about: dict[str, _Wish] = {}
    for name, one in (data if several else {ALONE: data}).items():
        rest[name] = dict(one)
        model, height_m = rest[name].pop("model", None), rest[name].pop("height_m", None)
        if model is not None and not isinstance(model, str):
            raise InputError("is no model", file=path, field="model", value=model, fix="write male, female or legs")
        number = isinstance(height_m, int | float) and not isinstance(height_m, bool)
        if height_m is not None and not (number and LEAST_M <= height_m <= MOST_M):
            raise InputError(
                "is no height", file=path, field="height_m", value=height_m, fix=f"write {LEAST_M} to {MOST_M} metres"
            )
        about[name] = _Wish(model, height_m)
    return (rest if several else rest[ALONE]), about


def settings_of_starts(paths: Sequence[Path]) -> dict[str, Any]:
    """Read the initial poses of bodies as settings of the method ``silhouettes``.

    Args:
        paths: ``FILE`` or ``PERSON=FILE``: named joints, or an earlier result. A person's joints may have ``model`` and
            ``height_m`` beside them.

    Returns:
        The setting ``bodies``: a list of each body's model, initial pose and name, and of its mesh if it has a file.

    Raises:
        InputError, SettingsError, CalibrationError: a file cannot be used, or a pose is impossible.
    """
    from mocapella.model.camera import CameraRig
    from mocapella.model.gltf import mesh_bytes
    from mocapella.sources.video import Frames
    from mocapella.tracker.silhouettes_setup import body_setup

    found = find_start(StartWishes([str(path) for path in paths]), CameraRig({}), Frames())
    files = {name: Path(body.model) for name, (body, _) in found.items() if body.sha256}
    return {
        "bodies": [
            body_setup(name, body, pose, mesh_bytes(files[name]) if name in files else b"")
            for name, (body, pose) in found.items()
        ]
    }


def settings_of_peoples_starts(paths: Sequence[Path]) -> dict[str, Any]:
    """Read the initial poses of bodies as settings of the method ``default``, whose people may have bodies.

    Args:
        paths: ``FILE`` or ``PERSON=FILE``, as in `settings_of_starts`.

    Returns:
        The setting ``bodies``: under ``silhouettes``, the settings of `settings_of_starts`.

    Raises:
        InputError, SettingsError, CalibrationError: as in `settings_of_starts`.
    """
    return {"bodies": {"silhouettes": settings_of_starts(paths)}}


def _by_person(option: str, texts: Sequence[str], people: Mapping[str, object]) -> dict[str, str]:
    """Return an option's value by person: the one given for the name, else the one given for all.

    Raises:
        SettingsError: no person has that name, or the option is given twice.
    """
    from mocapella.recording.bodies_file import ALONE

    said: dict[str, str] = {}
    for text in texts:
        name, value = _person_and_value(text)
        if name in said:
            raise SettingsError(f"{option} is given twice{f' for {name}' if name else ''}: {said[name]} and {value}")
        if name != ALONE and name not in people:
            known = "the start names nobody: write --start NAME=FILE" if ALONE in people else one_of(name, people)
            raise SettingsError(f"{option} {text}: no person is called {name!r}; {known}")
        said[name] = value
    return {name: said.get(name, said.get(ALONE, "")) for name in people if name in said or ALONE in said}


def _metres(text: str) -> float:
    """Parse a body height [m].

    Raises:
        SettingsError: it is no number, or out of range.
    """
    try:
        height = float(text)
    except ValueError:
        raise SettingsError(f"height is {text!r}; it must be metres, such as 1.75 or anna=1.75") from None
    check(LEAST_M <= height <= MOST_M, "height", height, f"{LEAST_M} to {MOST_M} m")
    return height


def _person_and_value(text: str) -> tuple[str, str]:
    """Split ``PERSON=VALUE``; a text without ``=``, or that is an existing path, is a value of the person `ALONE`.

    Raises:
        SettingsError: the person's name is invalid.
    """
    from mocapella.recording.bodies_file import ALONE, check_person_name

    name, equals, value = text.partition("=")
    if not equals or Path(text).exists():
        return ALONE, text
    return check_person_name(name), value


def _of_joints(wish: _Wish, found: _Found) -> tuple[Body, TreePose]:
    from mocapella.tracker.silhouette_start import body_of, check_joints, start_pose

    name = wish.model or found.wish.model or "male"
    height_m = found.wish.height_m if wish.height_m is None else wish.height_m
    if name.lower().endswith(MESH_FILES):
        body = _of_file(name, height_m)
    else:
        check_joints(name, found.joints, found.path)
        body = body_of(name, height_m, found.joints)
    return body, start_pose(body.mesh, found.joints)


def _of_file(model: str, height_m: float | None) -> Body:
    from hashlib import sha256

    from mocapella.model.body_proportions import AVERAGE
    from mocapella.model.gltf import mesh_bytes
    from mocapella.model.rigged_mesh_file import load_rigged_mesh
    from mocapella.tracker.silhouette_start import Body

    if height_m is not None:
        raise SettingsError(f"height {height_m:g}: the model of {model} has its own size; leave it out")
    mesh = load_rigged_mesh(Path(model))
    return Body(model, None, AVERAGE, mesh, sha256(mesh_bytes(Path(model))).hexdigest())


def _of_earlier(wish: _Wish, at: _Earlier) -> tuple[Body, TreePose]:
    """Return body and pose of an earlier result's frame; if it is missing and was not chosen, of the last frame."""
    from mocapella.tracker.silhouette_start import body_again, body_of

    path, earlier, number = at.path, at.body, at.number
    frame = next((one for one in earlier.frames if one.frame == number), None)
    if frame is None:
        first, last = earlier.frames[0].frame, earlier.frames[-1].frame
        if at.chosen:
            raise InputError(
                "has no such frame", file=path, field="frame", value=number, fix=f"it has frames from {first} to {last}"
            )
        frame = earlier.frames[-1]
        say(f"{path} has no frame {number}: starting as in its last one, {last}")
    if wish.model is not None and wish.model != earlier.model:
        raise SettingsError(f"model {wish.model}: {path} is of the model {earlier.model}; leave model out")
    if earlier.model.lower().endswith(MESH_FILES):
        body = _of_file(earlier.model, wish.height_m)
    elif wish.height_m is None:
        body = body_again(earlier.model, earlier.height_m, earlier.proportions)
    else:
        body = body_of(earlier.model, wish.height_m, {})
    missing = [name for name in body.mesh.joint_names if name not in frame.angles]
    if missing:
        raise InputError(
            "is missing", file=path, field=f"frames[{frame.frame}].angles.{missing[0]}",
            fix="start from a file of the same model",
        )  # fmt: skip
    return body, frame.pose(body.mesh.joint_names)


def check_seen(bodies: Mapping[str, InitialBody], rig: CameraRig, words: str) -> None:
    """Check that at least one camera sees each body at its initial pose.

    Args:
        bodies: mesh and initial pose of each body, by the person's name.
        rig: the cameras.
        words: the options that gave the poses, quoted in the error.

    Raises:
        InputError: no camera sees a body there.
    """
    from mocapella.tracker.silhouette_start import cameras_that_see, root_of

    for name, body in bodies.items():
        if not cameras_that_see(body.mesh, body.pose, rig):
            x, y, z = root_of(body.mesh, body.pose)
            raise InputError(
                f"{name or 'the body'} would start at ({x:.2f}, {y:.2f}, {z:.2f}) m, which is outside of all images",
                field="start", value=words,
                fix="give joints in the rig's world, in metres, of the first frame of the videos",
            )  # fmt: skip


def learn(run: SilhouetteRun, texts: Sequence[str], rig: CameraRig, shown: FrameSource, other_size: str | None) -> None:
    """Learn the background from images of the empty room, before the first frame.

    Args:
        run: the run, whose tracker learns.
        texts: ``[NAME=]PATH`` of an image or a video for each camera; cameras may be missing.
        rig: the cameras as calibrated.
        shown: source of the run's images.
        other_size: ``crop`` or ``scale``, for images of another size than the calibration's; None refuses these.

    Raises:
        InputError: an image cannot be read, has another size than the camera's, or is of a camera without a video.
    """
    from mocapella.library.calibration import named_inputs
    from mocapella.sources.video import Frames, pictures
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.silhouette_room import IMAGES

    inputs = {name: Path(path) for name, path in named_inputs(texts).items()}
    empty = VideoSet(inputs, rig, rate_hz=1.0, other_size=other_size)
    for name, video in empty.videos.items():
        if name not in shown.rig.cameras:
            raise InputError(
                "is of a camera that has no video", file=video.path, field="--background", value=name,
                fix=f"the videos are of {', '.join(shown.rig.cameras)}",
            )  # fmt: skip
        size = shown.rig.cameras[name].camera.size_px
        if video.size_px != size:
            raise InputError(
                "is of another size than the video", file=video.path, field="size", value=video.size_px,
                fix=f"that of {name} has {size}",
            )  # fmt: skip
        step = max(1, (video.count or 1) // IMAGES)
        for _, image in pictures(video.path, Frames(0, step * IMAGES, step)):
            run.learn_empty({name: image})


def _path_and_frame(text: str) -> tuple[Path, int | None]:
    path, colon, number = text.rpartition(":")
    return (Path(path), int(number)) if colon and number.isdecimal() and not Path(text).exists() else (Path(text), None)


def _folders(paths: Sequence[Path]) -> list[Path]:
    """Replace a single folder without JSON files by its folders that have some."""
    if len(paths) == 1 and paths[0].is_dir() and not any(paths[0].glob("*.json")):
        inner = sorted(one for one in paths[0].iterdir() if one.is_dir() and any(one.glob("*.json")))
        return inner or list(paths)
    return list(paths)
