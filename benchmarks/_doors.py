"""Every reader of files and messages from outside, each with valid inputs, for `benchmarks.fuzz`."""

from __future__ import annotations

import base64
import gzip
import random
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from benchmarks import _seeds as seeds
from benchmarks._mutations import MUTATIONS, flip_bits, insert, splice, truncate
from benchmarks._take_mutations import TakeMutations, read_everything, write_example
from benchmarks._text_mutations import drop_stretch, repeat_token, replace_token

VECTORS: Final = Path(__file__).resolve().parent.parent / "tests" / "vectors"
Damage = Callable[[bytes, random.Random, Sequence[bytes]], bytes]
BYTES: Final[tuple[Damage, ...]] = (flip_bits, truncate, insert, splice)
TEXT: Final[tuple[Damage, ...]] = (*BYTES, replace_token, replace_token, replace_token, repeat_token, drop_stretch)


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


@dataclass(frozen=True)
class Door:
    """A reader of content from outside.

    Attributes:
        name: of it.
        share: of all inputs, relative to the other doors: small for what is slow.
        inputs: yields a callable for each damaged input, which reads it, and the input's bytes for a report.
    """

    name: str
    share: float
    inputs: Callable[[random.Random], Iterator[tuple[Callable[[], Any], bytes]]]


def doors(folder: Path) -> list[Door]:
    """Return all doors; ``folder`` is empty, for files of the inputs."""
    return [*_messages(), *_texts(), *_keys(), *_files(folder), *_memories(), _takes(folder)]


def _of_bytes(
    name: str, valid: Sequence[bytes], read: Callable[[bytes], Any], damage: Sequence[Damage], share: float = 1.0
) -> Door:
    def inputs(rng: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            data = rng.choice(damage)(rng.choice(valid), rng, valid)
            yield (lambda data=data: read(data)), data

    read_valid(name, valid, read)
    return Door(name, share, inputs)


def read_valid(name: str, valid: Sequence[bytes], read: Callable[[bytes], Any]) -> None:
    """Check that a door opens to its seeds: refused ones would test nothing."""
    for seed in valid:
        try:
            read(seed)
        except Exception as error:
            raise AssertionError(f"{name}: the valid input is refused: {error!r}") from error


def _of_file(
    name: str, path: Path, valid: Sequence[bytes], read: Callable[[Path], Any], damage: Sequence[Damage], *,
    share: float = 0.1,
) -> Door:  # fmt: skip
    def of_bytes(data: bytes) -> None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        read(path)

    return _of_bytes(name, valid, of_bytes, damage, share)


def _messages() -> list[Door]:
    from mocapella.schema import decode_frame, decode_scene, decode_truth
    from mocapella.schema.delimited import DelimitedReader
    from mocapella.schema.marker_datagrams import decode_marker_datagram
    from mocapella.sources import osc
    from mocapella.wire import keys

    vectors = {path.stem: path.read_bytes() for path in sorted(VECTORS.glob("*.bin"))}
    others = ("scene_", "truth_", "stream_")
    frames = [data for name, data in vectors.items() if not name.startswith(others)]
    pose = osc.encode("/mocapella/pose", "wand", 0.1, 1.2, 0.3, 0.0, 0.0, 0.0, 1.0)
    tracker = osc.encode("/tracking/trackers/1/position", 0.1, 1.2, 0.3)

    def stream(data: bytes) -> None:
        for message in DelimitedReader().feed(data):
            decode_frame(message)

    return [
        _of_bytes("frames", frames, decode_frame, MUTATIONS, 4.0),
        _of_bytes("scenes", _starting(vectors, "scene_"), decode_scene, MUTATIONS),
        _of_bytes("truths", _starting(vectors, "truth_"), decode_truth, MUTATIONS),
        _of_bytes("bridge stream", _starting(vectors, "stream_"), stream, MUTATIONS),
        _of_bytes(
            "marker datagrams", [b"1.5,2.5;3,4", b"#7,1000;1.5,2.5;,"],
            lambda data: decode_marker_datagram(data, ("red", "blue"), (640, 480)), TEXT,
        ),
        _of_bytes(
            "OSC", [pose, tracker, osc.bundle(pose, tracker)], lambda data: osc.OscPoses("vr", "room").update(data, 1),
            BYTES,
        ),
        _of_bytes(
            "bus keys", [b"mocapella/v1/live/front/00000000000000ff"],
            lambda data: keys.node_of(data.decode("latin-1")), TEXT,
        ),
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
    )
    from mocapella.decoding import decode_json
    from mocapella.model.board import Board, encode_board, parse_board
    from mocapella.model.body_builds import mesh_of_build
    from mocapella.model.camera import Camera, CameraRig, PlacedCamera
    from mocapella.model.camera_rig_file import decode_camera_rig, encode_camera_rig
    from mocapella.model.hand import HandShape
    from mocapella.model.hand_file import decode_hand_shape, encode_hand_shape
    from mocapella.model.session import CommandReply, Setup
    from mocapella.recording.take import Run, TakeInfo, decode_run, encode_run
    from mocapella.sensing.colour_profile import decode_profile
    from mocapella.settings import parse
    from mocapella.wire.questions import read_answer, read_question

    camera = Camera("cam_1", (640, 480), np.array([500.0, 500, 320, 240, 0, 0, 0, 0, 0]))
    rig = CameraRig({"cam_1": PlacedCamera(camera, np.eye(4), np.eye(6), 0.01)})
    foreign = (
        b"[cam_1]\nsize = [640, 480]\nmatrix = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]\n"
        b"distortions = [0.0, 0.0, 0.0, 0.0]\nrotation = [0.1, 0.2, 0.3]\ntranslation = [1.0, 2.0, 3.0]\n"
    )
    T = np.eye(4).tolist()
    pair = LayoutPair("a", "b", "good", T, [1.0] * MOMENTS, np.eye(7).tolist(), [1.0] * PAIR_SCALARS)
    layout = SensorLayout(VERSION, True, {name: LayoutSensor(T, 1.0, 0.1) for name in "ab"}, [pair])
    hand = HandShape("left", np.full((5, 3), 0.03), np.full((5, 3), 0.02), "anna")
    run = Run(0, 1, TakeInfo(Setup(), 1_700_000_000_000_000_000, 5))
    return [
        _of_bytes("camera rigs", [encode_camera_rig(rig).encode(), foreign], decode_camera_rig, TEXT, 0.1),
        _of_bytes("sensor layouts", [encode_layout(layout)], decode_layout, TEXT, 0.3),
        _of_bytes("hands", [encode_hand_shape(hand)], decode_hand_shape, TEXT, 0.5),
        _of_bytes("boards", [encode_board(Board("charuco", 7, 5, 0.03)).encode()], parse_board, TEXT, 0.5),
        _of_bytes("runs of takes", [encode_run(run)], lambda data: decode_run(data, "take"), TEXT, 0.5),
        _of_bytes(
            "bodies' builds", [b'{"model":"legs","height_m":1.7,"proportions":{"thigh":0.43}}'],
            lambda data: mesh_of_build(data.decode("utf-8", "surrogateescape")), TEXT, 0.02,
        ),
        _of_bytes("colours", [seeds.colour_profile()], decode_profile, TEXT, 0.1),
        _of_bytes("questions", [b'{"ask":"board","board":"columns = 5","explain":true}'], read_question, TEXT),
        _of_bytes("answers", [b'{"ok":true,"positions_px":[[1,2],null],"controls":{"fps":30}}'], read_answer, TEXT),
        _of_bytes("commands", [b'{"participant":7,"method":"default"}'],
                  lambda data: parse(Setup, decode_json(data, dict[str, Any])), TEXT),
        _of_bytes("replies", [b'{"ok":true,"message":"done"}'], lambda data: decode_json(data, CommandReply), TEXT),
    ]  # fmt: skip


def _keys() -> list[Door]:
    from mocapella.decoding import decode_json
    from mocapella.wire.certificates import SERVER, Certified
    from mocapella.wire.doorbell import Ring
    from mocapella.wire.role_key import PREFIX, RoleKey, read_code
    from mocapella.wire.roles import READER, users_of
    from mocapella.wire.session_key import SessionKey, read_session_key

    own = Certified(b"certificate", b"private")
    role = msgspec.msgpack.encode(RoleKey("lab", READER, "tls/192.0.2.7:7447", b"authority", own))
    session = SessionKey("lab", own, dict.fromkeys((SERVER, *users_of(["front"])), own), ("front",))

    def code(data: bytes) -> RoleKey:
        return read_code(PREFIX + base64.urlsafe_b64encode(data).decode("ascii").rstrip("="))

    return [
        _of_bytes("pairing codes", [role], code, BYTES),
        _of_bytes("session keys", [msgspec.json.encode(session)],
                  lambda data: read_session_key(data.decode("latin-1"), "lab", Path("lab.json")), TEXT),
        _of_bytes("rings", [msgspec.json.encode(Ring("lab", "0" * 16, READER))], lambda data: decode_json(data, Ring),
                  TEXT),
    ]  # fmt: skip


def _files(folder: Path) -> list[Door]:
    from mocapella.evaluation.point_references import trc_points
    from mocapella.fusion import facing_model, joint_bias
    from mocapella.model.rigged_mesh_file import load_rigged_mesh
    from mocapella.model.space import load_space
    from mocapella.recording.bodies_file import joints_of_people, read_followed_people, read_json
    from mocapella.recording.image_tracks_file import read_image_tracks
    from mocapella.recording.measured_distances import read_measured_distances
    from mocapella.recording.point_recordings import read_point_recording
    from mocapella.recording.study_log import read_study_log
    from mocapella.sources.depth_files import read_depth_png, read_sidecar
    from mocapella.sources.simulate.bvh import read_bvh
    from mocapella.sources.video import read_image, read_timestamps

    log = seeds.study_log(folder)
    images = seeds.images()

    def keypoints(path: Path) -> object:
        return read_image_tracks([path.parent])

    def joints(path: Path) -> object:
        return joints_of_people(read_json(path), path)

    return [
        _of_file("study logs", folder / "log.csv", [log], read_study_log, TEXT),
        _of_file("study logs, packed", folder / "log.csv.gz", [gzip.compress(log)], read_study_log,
                 (*BYTES, packed, packed)),
        _of_file("image tracks", folder / "tracks.csv", [seeds.TRACKS], lambda path: read_image_tracks([path]), TEXT),
        _of_file("keypoints", folder / "openpose" / "a_000000_keypoints.json", [seeds.OPENPOSE], keypoints, TEXT),
        _of_file("point recordings", folder / "points.csv", [seeds.POINTS], read_point_recording, TEXT),
        _of_file("distances", folder / "far.csv", [b"distance_cm,disparity_px\n100,5\n"],
                 read_measured_distances, TEXT),
        _of_file("timestamps", folder / "times.csv", [b"camera,frame,time_s\na,0,0.1\na,1,0.2\n"],
                 lambda path: read_timestamps(path, ["a"]), TEXT),
        _of_file("followed bodies", folder / "body.json", [seeds.BODY, seeds.PEOPLE], read_followed_people, TEXT),
        _of_file("named joints", folder / "joints.json", [b'{"anna":{"hip":[0,1,2],"knee":[0,0.5,2]}}'], joints, TEXT),
        _of_file("space alignments", folder / "space.toml", [seeds.SPACE], load_space, TEXT),
        _of_file("depth sidecars", folder / "depth.toml", [b"unit_m = 0.001\nlens = [500.0, 320.0, 240.0]\n"],
                 read_sidecar, TEXT),
        _of_file("BVH", folder / "walk.bvh", [seeds.BVH], read_bvh, TEXT),
        _of_file("TRC", folder / "walk.trc", [seeds.TRC], trc_points, TEXT),
        _of_file("facing models", folder / "facing.json", [seeds.shipped("facing.json")],
                 facing_model.read_model, TEXT, share=0.02),
        _of_file("bias models", folder / "bias.json", [seeds.shipped("joint_bias.json")],
                 joint_bias.read_model, TEXT, share=0.01),
        _of_file("depth images", folder / "depth.png", [images[".png16"]], read_depth_png,
                 (*BYTES, *[repaired_png] * 4)),
        *(_of_file(f"images {kind}", folder / f"shot{kind}", [images[kind]], read_image,
                   (*BYTES, *[repaired_png] * 4) if kind == ".png" else BYTES)
          for kind in (".png", ".jpg", ".bmp", ".tiff", ".webp")),
        _of_file("meshes .glb", folder / "mesh.glb", [seeds.mesh(folder, ".glb")], load_rigged_mesh, BYTES, share=0.05),
        _of_file("meshes .gltf", folder / "mesh.gltf", [seeds.mesh(folder, ".gltf")], load_rigged_mesh,
                 TEXT, share=0.02),
    ]  # fmt: skip


def _memories() -> list[Door]:
    from mocapella.tracker import make_tracker

    trackers = {name: make_tracker(name) for name in ("stand-still", "default")}
    return [
        _of_bytes(f"memories of {name}", [one.snapshot()], one.restore, (*BYTES, *[changed_memory] * 4), 0.3)
        for name, one in trackers.items()
    ]


def _takes(folder: Path) -> Door:
    mutations = TakeMutations(write_example(folder / "seed.mcap"))
    path = folder / "damaged.mcap"

    def inputs(rng: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            mutations.write(path, rng)
            yield (lambda: read_everything(path)), path.read_bytes()

    return Door("contents of takes", 0.05, inputs)
