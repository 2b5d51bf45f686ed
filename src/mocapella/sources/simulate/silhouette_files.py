"""Write rendered scenes as files: a video for each camera, the rig, and the ground truth.

    write_sequence("out", silhouette_scene("runner", seed=3))

- ``camera1.avi`` …: videos (motion JPEG, or lossless ``FFV1``), and ``empty/camera1.png`` of the empty room;
- ``rig.toml``: the cameras, in the format of `mocapella.model.camera_rig_file`;
- ``truth.json``: for each frame its time, the pose of the body's root, the joint angles, and the landmarks.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.whole_file import write_whole
from mocapella.sources.simulate.corruption import Corruption

if TYPE_CHECKING:
    from mocapella.sources.simulate.silhouette_scene import SilhouetteScene

CODECS: Final = {"mjpeg": "MJPG", "lossless": "FFV1"}
FORMAT: Final = "mocapella silhouette truth"
VERSION: Final = 1


def write_sequence(folder: Path | str, scene: SilhouetteScene, *, codec: str = "mjpeg", masks: bool = False) -> Path:
    """Write a scene's images, rig and ground truth, in the files that the module lists.

    Args:
        folder: folder of the files; created if missing. Files of the same names are replaced.
        scene: the scene.
        codec: one of `CODECS`.
        masks: whether to write lossless videos of the true masks as well: ``camera1.mask.avi`` ….

    Returns:
        The folder.

    Raises:
        SettingsError: unknown codec.
        InputError: the folder cannot be written.
    """
    import cv2

    if codec not in CODECS:
        raise SettingsError(f"unknown codec {codec!r}; known: {one_of(codec, CODECS)}")
    folder = Path(folder)
    try:
        (folder / "empty").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot be written: {reason}", file=folder, fix="name a folder that can be made") from error
    names = list(scene.rig.cameras)
    fps = float(1.0 / np.median(np.diff(scene.times_s))) if len(scene) > 1 else 60.0
    films = [
        _film(folder / f"{name}.avi", CODECS[codec], fps, scene.rig.cameras[name].camera.size_px) for name in names
    ]
    of_masks = [
        _film(folder / f"{name}.mask.avi", CODECS["lossless"], fps, scene.rig.cameras[name].camera.size_px)
        for name in names
        if masks
    ]
    try:
        for k in range(len(scene)):
            for film, image in zip(films, scene.images(k), strict=True):
                film.write(image)
            if masks:
                for film, mask in zip(of_masks, scene.masks(k), strict=True):
                    film.write(np.repeat((255 * mask).astype(np.uint8)[..., None], 3, axis=2))
    finally:
        for film in (*films, *of_masks):
            film.release()
    for name, image in zip(names, scene.background(), strict=True):
        coded, data = cv2.imencode(".png", image)
        assert coded
        write_whole(folder / "empty" / f"{name}.png", data.tobytes())
    save_camera_rig(folder / "rig.toml", scene.rig)
    write_whole(folder / "truth.json", json.dumps(truth_of(scene)).encode())
    return folder


def truth_of(scene: SilhouetteScene) -> dict[str, Any]:
    """Return the content of ``truth.json``: the true poses, landmarks and times of all frames, as JSON types."""
    people = []
    for person, mesh in enumerate(scene.meshes):
        poses = scene.poses(person)
        places = [scene.landmarks(k, person).round(6).tolist() for k in range(len(scene))]
        people.append(
            {
                "body": mesh.name,
                "joints": list(mesh.joint_names),
                "landmarks": list(mesh.landmarks),
                "T_world_model": poses.T_world_model.tolist(),
                "angles_rad": poses.angles.tolist(),
                "landmarks_m": places,
            }
        )
    worse = scene.corruption or Corruption()
    return {
        "format": FORMAT,
        "version": VERSION,
        "scene": scene.name,
        "seed": scene.seed,
        "times_s": scene.times_s.tolist(),
        "wrong_frames": [k for k in range(len(scene)) if worse.is_wrong(k)],
        "people": people,
    }


def _film(path: Path, code: str, fps: float, size_px: tuple[int, int]) -> Any:
    import cv2

    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), fps, size_px)
    if not film.isOpened():
        fix = "name another folder, or another codec if this OpenCV does not have this one"
        raise InputError(f"cannot be written as {code}", file=path, fix=fix)
    return film
