"""Check that the images of a rig's cameras are not exchanged, such as by swapped folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mocapella.association.exchanged_cameras import exchange_text, exchanged_cameras
from mocapella.association.ray_agreement import shared_instants
from mocapella.errors import InputError
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame


def check_not_exchanged(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig, *, file: object) -> None:
    """Check that each camera's keypoints are of its own images.

    Args:
        frames: the frames by the rig's camera names; frames of one instant have the same ``sequence``.
        rig: the cameras.
        file: named in errors.

    Raises:
        InputError: the cameras disagree about people, and agree if images are exchanged; names these cameras.
    """
    text = exchange_text(exchanged_cameras(shared_instants(frames), {name: rig.cameras[name] for name in frames}))
    if text:
        raise InputError(
            f"{text}: with the rig the cameras disagree about people, and after the exchange they agree", file=file,
            fix="exchange the names of their folders or files, or their names in the rig",
        )  # fmt: skip
