"""Every reader of files and messages from outside, each with valid inputs, for `benchmarks.fuzz`."""

from __future__ import annotations

import gzip
import random
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import zstandard

from benchmarks import _seeds as seeds
from benchmarks._bus_doors import bus_doors, key_doors
from benchmarks._door import BYTES, TEXT, Door, of_bytes, of_file, read_valid
from benchmarks._mutations import MUTATIONS, flip_bits
from benchmarks._take_mutations import TakeMutations, read_everything, write_example

VECTORS: Final = Path(__file__).resolve().parent.parent / "tests" / "vectors"


def repaired_png(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Change bytes within one chunk of a PNG, and make its checksum right."""
    at, chunks = 8, []
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        chunks.append((at + 4, at + 8 + length))
        at += 12 + length
    begin, end = rng.choice(chunks)
    chunk = bytearray(flip_bits(data[begin:end], rng, others))
    return data[:begin] + bytes(chunk) + zlib.crc32(chunk).to_bytes(4, "big") + data[end + 4 :]


def packed(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Damage the text in a compressed file."""
    return gzip.compress(rng.choice(TEXT)(gzip.decompress(data), rng, [gzip.decompress(one) for one in others]), 1)


def changed_memory(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Replace one value of a tracker's memory, at any depth, by another of it or a strange one."""
    root = [msgspec.msgpack.decode(data)]
    places: list[tuple[Any, Any]] = []
    level: list[Any] = [root]
    while level:
        found = [(one, key) for one in level for key in (one if isinstance(one, dict) else range(len(one)))]
        places += found
        level = [one[key] for one, key in found if isinstance(one[key], list | dict)]
    (holder, key), (other, other_key) = rng.choice(places), rng.choice(places)
    holder[key] = rng.choice((*STRANGE, None if other is root else other[other_key]))
    try:
        return msgspec.msgpack.encode(root[0])
    except RecursionError:  # a value within itself
        return data


STRANGE: Final = (
    None,
    -1,
    2**63,
    "",
    "O",
    "(1,)f4,{",
    "|O8",
    [],
    {},
    [[]],
    b"",
    [2**40, 2**40],
    ["array", ["<f8", [-1], b""]],
)


def doors(folder: Path) -> list[Door]:
    """Return all doors; ``folder`` is empty, for files of the inputs."""
    return [
        *_messages(), *bus_doors(), *_texts(), *key_doors(folder), *_files(folder), *_settings_files(folder),
        *_studies(folder), *_memories(), _takes(folder),
    ]  # fmt: skip


def _messages() -> list[Door]:
    from mocapella.model.observations import BodyFrame
    from mocapella.schema import decode_frame, decode_scene, decode_truth
    from mocapella.schema.body_frames import decode_body_frame
    from mocapella.schema.delimited import DelimitedReader, delimited
    from mocapella.schema.marker_datagrams import decode_marker_datagram
    from mocapella.schema.people_columns import people_blocks
    from mocapella.sources import osc
    from mocapella.sources.bridge_messages import read_message
    from mocapella.sources.v4l2_controls import V4l2Controls
    from mocapella.wire import keys

    vectors = {path.stem: path.read_bytes() for path in sorted(VECTORS.glob("*.bin"))}
    others = ("scene_", "truth_", "stream_")
    frames = [data for name, data in vectors.items() if not name.startswith(others)]
    skeletons = [data for data in frames if isinstance(decode_frame(data), BodyFrame)]
    pose = osc.encode("/mocapella/pose", "wand", 0.1, 1.2, 0.3, 0.0, 0.0, 0.0, 1.0)
    start = delimited(b'{"say":"start","sensor":"front","node_id":9,"first":3,"lost":1,"next":4,"now_ns":5}')
    tracker = osc.encode("/tracking/trackers/1/position", 0.1, 1.2, 0.3)

    def stream(data: bytes) -> None:
        for message in DelimitedReader().feed(data):
            read_message(message)

    def controls(data: bytes) -> None:
        """A driver that gives these bytes for each description, and the last of them for each value."""

        def ioctl(fd: int, request: int, buffer: bytearray) -> None:
            answer = data[:68] if len(buffer) == 68 else data[68:]
            buffer[:] = answer[: len(buffer)].ljust(len(buffer), b"\0")

        V4l2Controls(0, ioctl).controls()

    described = struct.pack("=II32siiiiIII", 9, 1, b"gain", 0, 100, 1, 0, 0, 0, 0) + struct.pack("=Ii", 9, 5)

    def people(data: bytes) -> object:
        ends = np.array([0, len(data)])
        return list(people_blocks(0, np.zeros(1, np.int64), data, ends[:1], ends[1:]))

    return [
        of_bytes("frames", frames, decode_frame, MUTATIONS, 4.0),
        of_bytes("skeletons", skeletons, decode_body_frame, MUTATIONS, 0.2),
        of_bytes("scenes", _starting(vectors, "scene_"), decode_scene, MUTATIONS),
        of_bytes("people of scenes", _starting(vectors, "scene_"), people, MUTATIONS),
        of_bytes("truths", _starting(vectors, "truth_"), decode_truth, MUTATIONS),
        of_bytes("bridge stream", [*_starting(vectors, "stream_"), start], stream, MUTATIONS),
        of_bytes(
            "marker datagrams", [b"1.5,2.5;3,4", b"#7,1000;1.5,2.5;,"],
            lambda data: decode_marker_datagram(data, ("red", "blue"), (640, 480)), TEXT,
        ),
        of_bytes(
            "OSC", [pose, tracker, osc.bundle(pose, tracker)], lambda data: osc.OscPoses("vr", "room").update(data, 1),
            BYTES,
        ),
        of_bytes(
            "bus keys", [b"mocapella/v1/live/front/00000000000000ff"],
            lambda data: keys.node_of(data.decode("latin-1")), TEXT,
        ),
        of_bytes("V4L2 controls", [described], controls, BYTES, 0.2),
    ]  # fmt: skip


def _starting(vectors: dict[str, bytes], start: str) -> list[bytes]:
    return [data for name, data in vectors.items() if name.startswith(start)]


def _texts() -> list[Door]:
    from mocapella.calibration.pair_memory import PAIR_SCALARS
    from mocapella.calibration.sensor_layout import (
        MOMENTS,
        VERSION,
        LayoutPair,
        LayoutSensor,
        SensorLayout,
        decode_layout,
        encode_layout,
        is_layout,
    )
    from mocapella.model.board import Board, encode_board, parse_board
    from mocapella.model.body_builds import mesh_of_build
    from mocapella.model.camera_rig_file import decode_camera_rig, is_camera_rig
    from mocapella.model.hand import HandShape
    from mocapella.model.hand_file import decode_hand_shape, encode_hand_shape
    from mocapella.model.session import Setup
    from mocapella.recording.ledger import LedgerRow, NodeLedger
    from mocapella.recording.take import Run, TakeInfo, decode_run, encode_run
    from mocapella.recording.take_so_far import TakeSoFar, decode_so_far
    from mocapella.sensing.colour_profile import decode_profile
    from mocapella.settings import settings_of_pairs

    foreign = (
        b"[cam_1]\nsize = [640, 480]\nmatrix = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]\n"
        b"distortions = [0.0, 0.0, 0.0, 0.0]\nrotation = [0.1, 0.2, 0.3]\ntranslation = [1.0, 2.0, 3.0]\n"
    )
    T = np.eye(4).tolist()
    pair = LayoutPair("a", "b", "good", T, [1.0] * MOMENTS, np.eye(7).tolist(), [1.0] * PAIR_SCALARS)
    layout = SensorLayout(VERSION, True, {name: LayoutSensor(T, 1.0, 0.1) for name in "ab"}, [pair])
    hand = HandShape("left", np.full((5, 3), 0.03), np.full((5, 3), 0.02), "anna")
    run = Run(0, 1, TakeInfo(Setup(), 1_700_000_000_000_000_000, 5))
    ledger = NodeLedger.restored(LedgerRow("front", 7, 3, 12, 12, 2, True), True, [(3, 5), (8, 11)])
    so_far = TakeSoFar([4096], "take", 1, 9, 5, 60, {("front", 7): ledger})
    return [
        of_bytes("camera rigs", [seeds.rig(), foreign, seeds.QUALISYS, seeds.STORAGE, seeds.STORAGE_XML],
                 lambda data: is_camera_rig(data) and decode_camera_rig(data), TEXT, 0.1),
        of_bytes("sensor layouts", [encode_layout(layout)], lambda data: is_layout(data) and decode_layout(data), TEXT,
                 0.3),
        of_bytes("hands", [encode_hand_shape(hand)], decode_hand_shape, TEXT, 0.5),
        of_bytes("boards", [encode_board(Board("charuco", 7, 5, 0.03)).encode()], parse_board, TEXT, 0.5),
        of_bytes("runs of takes", [encode_run(run)], lambda data: decode_run(data, "take"), TEXT, 0.5),
        of_bytes("accounts of takes", [so_far.encode()], decode_so_far, TEXT, 0.5),
        of_bytes(
            "bodies' builds", [b'{"model":"legs","height_m":1.7,"proportions":{"thigh":0.43}}'],
            lambda data: mesh_of_build(data.decode("utf-8", "surrogateescape")), TEXT, 0.02,
        ),
        of_bytes("colours", [seeds.colour_profile()], decode_profile, TEXT, 0.1),
        of_bytes("settings", [b"people.reach_m=0.5", b'box={"low":[1,2]}'],
                 lambda data: settings_of_pairs([data.decode("utf-8", "surrogateescape")]), TEXT),
    ]  # fmt: skip


def _files(folder: Path) -> list[Door]:
    from mocapella.comparison.joint_names import read_joint_map
    from mocapella.fusion import facing_model, joint_bias
    from mocapella.library.study_views import read_study_views
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.model.rigged_mesh_file import load_rigged_mesh
    from mocapella.model.space import load_space
    from mocapella.recording.bodies_file import joints_of_people, read_followed_people, read_json
    from mocapella.recording.body_csv import is_body_csv, read_body_csv
    from mocapella.recording.bvh_file import read_bvh_joints
    from mocapella.recording.c3d_file import read_c3d
    from mocapella.recording.detection_files import read_detections
    from mocapella.recording.image_tracks_file import read_image_tracks
    from mocapella.recording.keypoint_csv import read_csv_keypoints
    from mocapella.recording.measured_distances import read_measured_distances
    from mocapella.recording.point_recordings import read_point_recording
    from mocapella.recording.study_log import is_study_log, read_study_log
    from mocapella.recording.trc_file import read_trc
    from mocapella.sources.body_replay import BodyReplay
    from mocapella.sources.depth_files import read_depth_png, read_sidecar
    from mocapella.sources.video import is_cut_off, read_image, read_timestamps

    log = seeds.study_log(folder)
    images = seeds.images()

    def keypoints(path: Path) -> object:
        return read_image_tracks([path.parent])

    def bodies(path: Path) -> object:
        return is_body_csv(path), BodyReplay(read_body_csv(path))

    def joints(path: Path) -> object:
        return joints_of_people(read_json(path), path)

    return [
        of_file("study logs", folder / "log.csv", [log], lambda path: (is_study_log(path), read_study_views(path)),
                 TEXT),
        of_file("study logs, packed", folder / "log.csv.gz", [gzip.compress(log)], read_study_log,
                 (*BYTES, packed, packed)),
        of_file("Azure Kinect tables", folder / "azure.csv", [seeds.azure_table()], bodies, TEXT),
        of_file("Kinect v2 tables", folder / "kinect.csv", [seeds.kinect_table()], bodies, TEXT),
        of_file("image tracks", folder / "tracks.csv", [seeds.TRACKS], lambda path: read_image_tracks([path]), TEXT),
        of_file("keypoints", folder / "openpose" / "a_000000_keypoints.json", [seeds.OPENPOSE], keypoints, TEXT),
        of_file("detections of a video", folder / "video.json", [seeds.MMPOSE, seeds.ALPHAPOSE],
                 lambda path: read_detections([path]), TEXT),
        of_file("tables of detections", folder / "detections.csv",
                 [seeds.DEEPLABCUT, seeds.SLEAP, seeds.PEOPLE_TRACKS, seeds.TRACKS],
                 lambda path: read_detections([path]), TEXT),
        of_file("HDF5 of detections", folder / "detections.h5", seeds.detection_files(),
                 lambda path: read_detections([path]), BYTES),
        of_file("calibrations of cameras", folder / "storage" / "a.xml", [seeds.STORAGE_XML],
                 lambda path: load_camera_rig(path.parent), TEXT),
        of_file("point recordings", folder / "points.csv", [seeds.POINTS], read_point_recording, TEXT),
        of_file("distances", folder / "far.csv", [b"distance_cm,disparity_px\n100,5\n"],
                 read_measured_distances, TEXT),
        of_file("timestamps", folder / "times.csv", [b"camera,frame,time_s\na,0,0.1\na,1,0.2\n"],
                 lambda path: read_timestamps(path, ["a"]), TEXT),
        of_file("boxes of an MP4", folder / "film.mp4", [seeds.MP4], is_cut_off, BYTES),
        of_file("followed bodies", folder / "body.json", [seeds.BODY, seeds.PEOPLE], read_followed_people, TEXT),
        of_file("named joints", folder / "joints.json", [b'{"anna":{"hip":[0,1,2],"knee":[0,0.5,2]}}'], joints, TEXT),
        of_file("space alignments", folder / "space.toml", [seeds.SPACE], load_space, TEXT),
        of_file("depth sidecars", folder / "depth.toml", [b"unit_m = 0.001\nlens = [500.0, 320.0, 240.0]\n"],
                 read_sidecar, TEXT),
        of_file("BVH", folder / "walk.bvh", [seeds.BVH], read_bvh_joints, TEXT),
        of_file("keypoint tables", folder / "people.csv", [seeds.KEYPOINTS, seeds.MARKERS, seeds.azure_table()],
                 read_csv_keypoints, TEXT),
        of_file("joint maps", folder / "map.toml", [b'Head = "TOP"\nKneeLeft = { LKNE = 0.5, LKNM = 0.5 }\n'],
                 read_joint_map, TEXT),
        of_file("C3D", folder / "walk.c3d", [seeds.c3d(folder)], read_c3d, BYTES),
        of_file("TRC", folder / "walk.trc", [seeds.TRC], read_trc, TEXT),
        of_file("facing models", folder / "facing.json", [seeds.shipped("facing.json")],
                 facing_model.read_model, TEXT, share=0.02),
        of_file("bias models", folder / "bias.json", [seeds.shipped("joint_bias.json")],
                 joint_bias.read_model, TEXT, share=0.01),
        of_file("depth images", folder / "depth.png", [images[".png16"]], read_depth_png,
                 (*BYTES, *[repaired_png] * 4)),
        *(of_file(f"images {kind}", folder / f"shot{kind}", [images[kind]], read_image,
                   (*BYTES, *[repaired_png] * 4) if kind == ".png" else BYTES)
          for kind in (".png", ".jpg", ".bmp", ".tiff", ".webp")),
        of_file("meshes .glb", folder / "mesh.glb", [seeds.mesh(folder, ".glb")], load_rigged_mesh, BYTES, share=0.05),
        of_file("meshes .gltf", folder / "mesh.gltf", [seeds.mesh(folder, ".gltf")], load_rigged_mesh,
                 TEXT, share=0.02),
    ]  # fmt: skip


def _settings_files(folder: Path) -> list[Door]:
    """Readers of the files that the command line and the tracking methods take, each by its path."""
    from mocapella.calibration.sensor_layout import SensorLayout, encode_layout
    from mocapella.cli.command_settings import read_keys
    from mocapella.cli.hand import HandKeys
    from mocapella.cli.serve import _is_rig, load_layout_option
    from mocapella.decoding import decode_json
    from mocapella.evaluation.hand_clips import read_numbers
    from mocapella.evaluation.point_references import caliscope_points
    from mocapella.model.board import Board, encode_board, load_board
    from mocapella.model.hand import HandShape
    from mocapella.model.hand_file import encode_hand_shape
    from mocapella.sensing.colour_profile import load_profile
    from mocapella.settings import parse
    from mocapella.sources.simulate.keypoint_errors import read_detectors
    from mocapella.sources.simulate.measured import errors_from_json
    from mocapella.sources.simulate.scenes import read_scene
    from mocapella.studies.planner.planned_room import example_room, read_room
    from mocapella.tracker.method_files import camera_rig, hand_shape
    from mocapella.tracker.silhouettes_setup import BodySetup, _starting

    space, shape = seeds.space_tracks(), HandShape("left", np.full((5, 3), 0.03), np.full((5, 3), 0.02), "anna")
    layout = encode_layout(SensorLayout(1, True, {}, []))
    start = {"start": {"root_twist": [0, 0, 3, 0, 0, 0]}, "model": "a", "mesh": seeds.base64_mesh(folder)}
    errors = seeds.package_file("mocapella.sources.simulate", "kinect_v2_measured.json")
    detectors = seeds.package_file("mocapella.sources.simulate", "keypoint_errors.json")

    def bodies(data: bytes) -> object:
        return _starting(parse(BodySetup, decode_json(data, dict[str, Any])))

    return [
        of_file("settings files", folder / "keys.toml", [b"hand_length_mm = 180.0\n"],
                lambda path: read_keys(HandKeys, path, None), TEXT),
        of_file("layout files", folder / "layout.json", [layout],
                lambda path: (_is_rig(path), load_layout_option(path)), TEXT),
        of_file("rig files", folder / "rig.toml", [seeds.rig()], lambda path: camera_rig([path]), TEXT),
        of_file("hand files", folder / "hand.json", [encode_hand_shape(shape)], lambda path: hand_shape([path]), TEXT),
        of_file("board files", folder / "board.toml", [encode_board(Board("charuco", 7, 5, 0.03)).encode()], load_board,
                TEXT),
        of_file("colour files", folder / "colours.json", [seeds.colour_profile()], load_profile, TEXT, share=0.05),
        of_file("reference points", folder / "xyz.csv", [seeds.CALISCOPE], lambda path: caliscope_points(path, space),
                TEXT),
        of_file("numbers of a camera", folder / "c0.dat", [b"R:\n1 0 0\n0 1 0\n0 0 1\nT:\n0.5 -2 16\n"], read_numbers,
                TEXT, share=0.05),
        of_file("rooms to plan", folder / "room.toml", [example_room().encode()], read_room, TEXT),
        of_file("scene files", folder / "scene.toml", [seeds.SCENE], read_scene, TEXT),
        of_bytes("sensor errors", [errors], lambda data: errors_from_json(data, "errors.json"), TEXT, 0.02),
        of_bytes("errors of detectors", [detectors], lambda data: read_detectors(data, file="errors.json"), TEXT, 0.02),
        of_bytes("bodies with meshes", [msgspec.json.encode(start)], bodies, TEXT, 0.02),
        of_bytes("references to images", seeds.image_references(folder), seeds.resolve, TEXT, 0.1),
    ]  # fmt: skip


def _studies(folder: Path) -> list[Door]:
    from mocapella.decoding import unpacked_streams
    from mocapella.studies.parquet_log import parquet_log_blocks, write_parquet_log
    from mocapella.studies.progress import begin
    from mocapella.studies.protocol import load_protocol, plan, protocol_bytes
    from mocapella.studies.state_file import load_session, new_session

    write_parquet_log(folder / "seed.parquet", seeds.study_rows())
    parquet = (folder / "seed.parquet").read_bytes()
    founding = load_protocol("kinectmultitrack")
    session = new_session(founding, begin("P07", plan(founding, "P07"), 0))
    packed_data = [b"a" + gzip.compress(bytes(99)), zstandard.compress(bytes(99)), seeds.zipped(bytes(99))]
    return [
        of_bytes("unpacked streams", packed_data, lambda data: list(unpacked_streams(data, 1 << 20)), BYTES),
        of_file("study logs in Parquet", folder / "log.parquet", [parquet],
                lambda path: list(parquet_log_blocks(path, lambda error: None)), BYTES, share=0.05),
        of_file("study protocols", folder / "study.toml", [protocol_bytes("kinectmultitrack")], load_protocol, TEXT,
                share=0.05),
        of_file("study sessions", folder / "session.json", [msgspec.json.encode(session)], load_session, TEXT,
                share=0.05),
    ]  # fmt: skip


def _memories() -> list[Door]:
    from mocapella.tracker import METHODS, make_tracker
    from mocapella.tracker.protocol import Tracker

    trackers: dict[str, Tracker] = {
        name: make_tracker(name) for name in ("stand-still", "default", "arms", "one-webcam")
    }
    trackers |= {name: METHODS[name].warm_up_run()[0] for name in ("hands", "silhouettes", "webcams")}
    return [
        of_bytes(f"memories of {name}", [one.snapshot()], one.restore, (*BYTES, *[changed_memory] * 4), 0.3)
        for name, one in trackers.items()
    ]


def _takes(folder: Path) -> Door:
    from mocapella.recording.chunk_rows import ChunkRows
    from mocapella.recording.mcap_scan import scan

    mutations = TakeMutations(write_example(folder / "seed.mcap"))

    def read(path: Path) -> None:
        with path.open("rb") as file:  # in the way of long takes, too
            for _ in scan(file, path.stat().st_size, path.name, ChunkRows()):
                pass
        read_everything(path)

    read_valid("contents of takes", [b""], lambda _: read(folder / "seed.mcap"))
    path = folder / "damaged.mcap"

    def inputs(rng: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            mutations.write(path, rng)
            yield (lambda: read(path)), path.read_bytes()

    return Door("contents of takes", 0.05, inputs)
