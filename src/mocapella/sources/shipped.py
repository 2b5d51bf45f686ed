"""The sources that ship with Mocapella."""

from __future__ import annotations

from typing import Final

from mocapella.sources.source import Source

SIMULATE: Final = Source(
    interface=1,
    name="simulate",
    summary="A body sensor of a simulated room.",
    frame_types=("skeletons",),
    command="mocapella.cli.node:simulate",
)
REPLAY: Final = Source(
    interface=1,
    name="replay",
    summary="A sensor of a recording, in real time.",
    frame_types=(),
    command="mocapella.cli.node:replay",
)
BRIDGE: Final = Source(
    interface=1,
    name="bridge",
    summary="Sensors of programs without zenoh (C, C#, …): length-delimited frames over TCP.",
    frame_types=(),
    command="mocapella.cli.node:bridge",
    looks="mocapella.sources.device_checks:kinect_v2",
)
DATAGRAMS: Final = Source(
    interface=1,
    name="datagrams",
    summary="Cameras that send markers as text in UDP datagrams, as small programs on a Raspberry Pi do.",
    frame_types=("markers",),
    command="mocapella.cli.node:datagrams",
)
OSC: Final = Source(
    interface=1,
    name="osc",
    summary="Poses of another tracker by OSC: VMC's, VRChat's, or /mocapella/pose.",
    frame_types=("poses",),
    command="mocapella.cli.node:osc",
)
OPENVR: Final = Source(
    interface=1,
    name="openvr",
    summary="Poses of a headset's trackers and controllers.",
    frame_types=("poses",),
    command="mocapella.cli.node:openvr",
)
CAMERA: Final = Source(
    interface=1,
    name="camera",
    summary="A camera: its images themselves, for silhouettes.",
    frame_types=("images",),
    command="mocapella.cli.camera:camera",
    looks="mocapella.sources.device_checks:cameras",
)
MARKERS: Final = Source(
    interface=1,
    name="markers",
    summary="A camera: the coloured markers in its images.",
    frame_types=("markers",),
    command="mocapella.cli.markers:markers",
    looks="mocapella.sources.device_checks:cameras",
)
KEYPOINTS: Final = Source(
    interface=1,
    name="keypoints",
    summary="A webcam or a film: the keypoints of the people in its images.",
    frame_types=("keypoints",),
    command="mocapella.cli.node_keypoints:keypoints",
    looks="mocapella.sources.device_checks:cameras",
)
ARM: Final = Source(
    interface=1,
    name="arm",
    summary="A depth camera: the arms in its images.",
    frame_types=("arms", "depth"),
    command="mocapella.cli.node_arm:node_arm",
    looks="mocapella.sources.device_checks:depth_cameras",
)
RGBD: Final = Source(
    interface=1,
    name="rgbd",
    summary="A depth camera with colour: people's joints, by keypoints and depth.",
    frame_types=("skeletons",),
    command="mocapella.cli.node_rgbd:rgbd",
)
AZURE_KINECT: Final = Source(
    interface=1,
    name="azure-kinect",
    summary="An Azure Kinect or Orbbec Femto: the bodies that the vendor's library finds.",
    frame_types=("skeletons",),
    command="mocapella.cli.node_azure_kinect:azure_kinect",
    looks="mocapella.sources.device_checks:azure_kinect",
)
