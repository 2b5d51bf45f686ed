"""Descriptor of the method ``silhouettes`` (`mocapella.tracker.silhouettes`).

Its tracker needs OpenCV, which is an extra: it is imported when a tracker is created.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from typing import Any, Final

from mocapella.errors import SettingsError
from mocapella.model.images import ImageFrame
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.session import SensorPose
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker
from mocapella.tracker.silhouette_settings import SilhouetteSettings


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    if find_spec("cv2") is None:
        raise SettingsError("the method silhouettes needs OpenCV: uv sync --extra cameras")
    from mocapella.tracker.silhouettes_setup import make_silhouettes

    for key, missing in (("rig", "--rig RIG.toml"), ("bodies", "--start JOINTS.json")):
        if key not in settings:
            raise SettingsError(
                f"the method silhouettes wants {key}: {missing} is missing (mocapella serve --method silhouettes "
                "--rig RIG.toml --start JOINTS.json)"
            )
    return make_silhouettes(settings)


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    from mocapella.tracker.silhouettes_warmup import warm_up_arrivals, warm_up_tracker

    return warm_up_tracker(), warm_up_arrivals()


METHOD: Final = Method(
    interface=1,
    name="silhouettes",
    summary="body models, fitted to the silhouettes of people in the images of two or more calibrated cameras",
    settings=SilhouetteSettings,
    frame_types=(ImageFrame, KeypointFrame),
    parts=("bodies",),
    make=_make,
    warm_up_run=_practice,
    camera_rig="required",
    files={
        "rig": "mocapella.tracker.method_files:camera_rig",
        "start": "mocapella.cli.silhouette_start:settings_of_starts",
    },
)
"""It also has the settings of `mocapella.tracker.silhouettes_setup.SilhouettesSetup`: ``rig``, ``bodies`` …"""
