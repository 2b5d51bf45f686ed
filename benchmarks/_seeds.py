"""Valid files of every kind, small, for `benchmarks._doors`."""

from __future__ import annotations

import base64
import io
import pickle
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from mocapella.model.point_tracks import SpaceTracks

TRACKS: Final = b"""frame,camera,point,x_px,y_px,confidence,time_s
0,a,nose,1.5,2.5,0.9,0.0
1,b,nose,2.5,3.5,1,0.1
"""
POINTS: Final = b"""time_s,point,x_m,y_m,z_m
0.0,tip,1,2,3
0.1,tip,1,2,3.5
"""
_FRAME: Final = (
    b'{"frame":0,"time_s":0.0,"root_twist":[0,0,0,0,0,0],"angles":{"knee":0.1},"joints":{"hip":[0,1,2]},'
    b'"overlap":{},"left_out":{}}'
)
_FRAMES: Final = b'"model":"legs","frames":[' + _FRAME + b"]}"
BODY: Final = b'{"format":"mocapella followed body","version":1,' + _FRAMES
PEOPLE: Final = b'{"format":"mocapella followed people","version":1,"people":{"anna":{' + _FRAMES + b"}}"
SPACE: Final = b"""format = "mocapella space alignment"
version = 1
space = "vr"
rows = [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
"""
KEYPOINTS: Final = b"""time_s,run,individual,keypoint,state,x_m,y_m,z_m,sd_m
0.0,0,anna,head,measured,1.0,2.0,3.0,0.01
0.0,0,anna,foot,unknown,,,,
0.1,1,anna,head,inferred,1.0,2.0,3.0,
"""
MARKERS: Final = b"""head (x);head (y);head (z)
0;1500;0
10;1500;0
"""
SCENE: Final = b"""[sensors.sensor-1]
position = [0.9, 1.0, 0.3]
yaw_deg = 40.0
errors = "kinect-v2-measured"

[scenes.plan]
summary = "one person walks"
sensors = ["sensor-1"]
cylinders = [{ centre = [3.6, 2.9], radius = 0.2, height = 2.7 }]
people = [{ scenario = "route", start = [3.0, 2.5], route = ["stand 2", "go 2 3", "go 3 2.5"], stature = 1.7 }]
"""
BVH: Final = b"""HIERARCHY
ROOT hip
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 1 0
}
}
MOTION
Frames: 1
Frame Time: 0.01
0 1 0 0 0 0
"""
TRC: Final = (
    b"PathFileType\t4\nDataRate\tUnits\n30\tm\nFrame#\tTime\tnose\t\t\n\t\tX1\tY1\tZ1\n1\t0.0\t1\t2\t3\n2\t0.1\t\t\t\n"
)
MP4: Final = b"".join(
    (8 + len(body)).to_bytes(4, "big") + kind + body
    for kind, body in ((b"ftyp", bytes(16)), (b"moov", bytes(8)), (b"mdat", bytes(32)))
)
"""The boxes of a film, without images."""
OPENPOSE: Final = b'{"people":[{"pose_keypoints_2d":[' + b",".join([b"1.5,2.5,0.9"] * 25) + b"]}]}"
_INSTANCES: Final = (
    b'"instances":[{"keypoints":['
    + b",".join([b"[1.5,2.5]"] * 17)
    + (b'],"keypoint_scores":[' + b",".join([b"0.9"] * 17) + b"]}]")
)
MMPOSE: Final = b'{"instance_info":[{"frame_id":1,' + _INSTANCES + b"}]}"
ALPHAPOSE: Final = (
    b'[{"image_id":"1.jpg","category_id":1,"idx":[3],"score":2.5,"keypoints":['
    + b",".join([b"1.5,2.5,0.9"] * 26)
    + b"]}]"
)
DEEPLABCUT: Final = b"""scorer,net,net,net,net,net,net
individuals,a,a,a,b,b,b
bodyparts,tail,tail,tail,tail,tail,tail
coords,x,y,likelihood,x,y,likelihood
0,1,2,0.9,3,4,0.8
1,1,2,0.9,,,
"""
SLEAP: Final = b"""track,frame_idx,instance.score,tail.x,tail.y,tail.score
a,0,0.9,1,2,0.5
,1,0.9,1,2,
"""
PEOPLE_TRACKS: Final = b"""frame,camera,person,point,x_px,y_px,confidence,time_s
0,a,anna,nose,1.5,2.5,0.9,0.0
1,a,bert,nose,2.5,3.5,1,0.1
"""
QUALISYS: Final = (
    b'<calibration><cameras><camera serial="a"><fov_video left="0" top="0" right="639" bottom="479"/>'
    b'<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1" y="0" z="2"/>'
    b'<intrinsic focalLengthU="64000" focalLengthV="64000" centerPointU="20480" centerPointV="15360" '
    b'radialDistortion1="0" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0" '
    b'tangentalDistortion2="0"/></camera></cameras></calibration>'
)
STORAGE: Final = b"""%YAML:1.0
---
names:
   - "1"
K_1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 320., 0., 600., 240., 0., 0., 1. ]
Rot_1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T_1: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., 2. ]
"""
STORAGE_XML: Final = (
    b'<?xml version="1.0"?><opencv_storage><Intrinsics type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>'
    b"<data>600. 0. 320. 0. 600. 240. 0. 0. 1.</data></Intrinsics><CameraMatrix><rows>3</rows><cols>4</cols><dt>d</dt>"
    b"<data>1. 0. 0. 0. 0. 1. 0. 0. 0. 0. 1. 2.</data></CameraMatrix></opencv_storage>"
)


def detection_files() -> list[bytes]:
    """Return files of DeepLabCut and SLEAP in HDF5."""
    import h5py

    sleap, deeplabcut = io.BytesIO(), io.BytesIO()
    with h5py.File(sleap, "w") as file:
        file["tracks"], file["point_scores"] = np.ones((1, 2, 2, 3)), np.ones((1, 2, 3))
        file["node_names"], file["track_names"] = [b"tail", b"snout"], [b"a"]
    columns = pickle.dumps([("net", "tail", part) for part in ("x", "y", "likelihood")], 0)
    with h5py.File(deeplabcut, "w") as file:
        file.create_group("df").attrs["pandas_type"] = np.bytes_(b"frame_table")
        rows = np.zeros(2, [("index", "<i8"), ("values_block_0", "<f8", (3,))])
        rows["index"] = [0, 1]
        file["df/table"] = rows
        file["df/table"].attrs["values_block_0_kind"] = np.bytes_(columns)
    return [sleap.getvalue(), deeplabcut.getvalue()]


CALISCOPE: Final = b"sync_index,point_id,x_coord,y_coord,z_coord\n0,0,1,2,3\n1,0,1,2,3.5\n"
_COLOUR: Final = (
    b'{"name":"red","seen":{"mean":[0.1,0.2],"covariance":[1.0,0.1,1.0],"luma":[1,2,3],"pixels":9},"area_px":50}'
)


def colour_profile() -> bytes:
    """Return a colour profile."""
    from mocapella.sensing.colour_profile import BINS

    counts = b",".join([b"[" + b",".join([b"1"] * BINS) + b"]"] * BINS)
    background = b'{"luma":90.0,"chromaticity":[0.1,0.2],"counts":[' + counts + b"]}"
    return (
        b'{"camera":"cam_1","size_px":[640,480],"version":1,"colours":['
        + _COLOUR
        + b'],"background":'
        + background
        + b"}"
    )


def shipped(name: str) -> bytes:
    """Return a model that ships with Mocapella."""
    return package_file("mocapella.fusion", name)


def package_file(package: str, name: str) -> bytes:
    """Return a file of a package's folder ``data``."""
    return files(package).joinpath("data", name).read_bytes()


def rig() -> bytes:
    """Return a camera rig of one camera."""
    from mocapella.model.camera import Camera, CameraRig, PlacedCamera
    from mocapella.model.camera_rig_file import encode_camera_rig

    camera = Camera("cam_1", (640, 480), np.array([500.0, 500, 320, 240, 0, 0, 0, 0, 0]))
    return encode_camera_rig(CameraRig({"cam_1": PlacedCamera(camera, np.eye(4), np.eye(6), 0.01)})).encode()


def space_tracks() -> SpaceTracks:
    """Return the frames and points that `CALISCOPE` has."""
    from mocapella.model.point_tracks import SpaceTracks

    n = np.zeros((2, 1))
    return SpaceTracks(("0",), np.arange(2), np.zeros(2), np.zeros((2, 1, 3)), n, n, n.astype(int), n.astype(np.uint8))


def image_references(folder: Path) -> list[bytes]:
    """Return a reference to an image in this folder."""
    from mocapella.model.images import image_frame
    from mocapella.sources.referenced_images import checksum, referred

    path = folder / "referred.png"
    path.write_bytes(images()[".png"])
    frame = image_frame("cam", np.zeros((12, 16, 3), np.uint8), time_ns=1)
    return [bytes(referred(frame, path, checksum(path), 0).data)]


def resolve(reference: bytes) -> object:
    """Read the image that a take refers to."""
    from mocapella.model.images import ImageFrame
    from mocapella.sources.referenced_images import ReferencedImages

    return ReferencedImages().resolve(ImageFrame("cam", 0, 0, 1, 0, (16, 12), "file", reference))


def study_rows() -> list[Any]:
    """Return three rows of a study log."""
    from mocapella.model.study_log import YEAR_1_TO_1970_MS, StudyRow

    now = YEAR_1_TO_1970_MS + 1_426_000_000_000
    return [
        StudyRow(1, 2, 3, now, 5, k, 7, 0.5, 1.5, "front", 0.0, 90.0, np.ones((25, 3), np.float32)) for k in range(3)
    ]


def study_log(folder: Path) -> bytes:
    """Return a study log of these rows as text."""
    from mocapella.recording.study_log import write_study_log

    path = folder / "seed.csv"
    write_study_log(path, study_rows())
    return path.read_bytes()


def c3d(folder: Path) -> bytes:
    """Return a C3D of two points in three frames."""
    from mocapella.exports.c3d_file import write_c3d
    from mocapella.model.trajectories import Trajectories

    positions, states = np.ones((3, 1, 2, 3)), np.full((3, 1, 2), 2, np.uint8)
    own = Trajectories(
        "points", np.arange(3) / 30.0, np.zeros(3, np.int64), ("anna",), ("head", "foot"), positions, states,
        np.full(states.shape, 0.01, np.float32), rate_hz=30.0,
    )  # fmt: skip
    write_c3d(own, folder / "seed.c3d")
    return (folder / "seed.c3d").read_bytes()


def azure_table() -> bytes:
    """Return a table of Azure Kinect Body Tracking: two bodies at two instants."""
    from mocapella.model.topology import topology

    joints = topology("azure_kinect").joints
    titles = ["timestamp", "body_idx", *(f"{joint} ({what})" for joint in joints for what in "cxyz")]
    rows = [
        [33_000 * instant, body, *(v for k in range(len(joints)) for v in (2, 10.5 * k, -20.25 * k, 2000))]
        for instant in (1, 2)
        for body in (1, 2)
    ]
    return "\n".join(";".join(map(str, row)) for row in (titles, *rows)).encode()


def kinect_table() -> bytes:
    """Return a table of a Kinect v2: one body at three instants."""
    rows = [[330_000 * k, *(v for joint in range(25) for v in (0.1 * joint, -0.25, 2.5, 2))] for k in range(3)]
    return "\n".join(",".join(map(str, row)) + "," for row in rows).encode()


def images() -> dict[str, bytes]:
    """Return an image in each format by suffix; ``.png16`` is a depth image."""
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # a line for each damaged image
    rng = np.random.default_rng(1)
    shot, depth = rng.integers(0, 255, (12, 16, 3), np.uint8), rng.integers(0, 9999, (12, 16), np.uint16)
    coded = {kind: cv2.imencode(kind, shot)[1].tobytes() for kind in (".png", ".jpg", ".bmp", ".tiff", ".webp")}
    return {**coded, ".png16": cv2.imencode(".png", depth)[1].tobytes()}


def mesh(folder: Path, kind: str) -> bytes:
    """Return a rigged mesh."""
    from mocapella.model.body_meshes import legs_mesh
    from mocapella.model.rigged_mesh_file import save_rigged_mesh

    path = folder / f"seed{kind}"
    save_rigged_mesh(path, legs_mesh("male", detail=0.8))
    return path.read_bytes()


def base64_mesh(folder: Path) -> str:
    """Return a rigged mesh as a setting has it."""
    return base64.b64encode(mesh(folder, ".glb")).decode()


def zipped(data: bytes) -> bytes:
    """Return a zip of one file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a", data)
    return out.getvalue()
