"""A day of six sensors at 30 Hz, as fast as it goes: what grows in the server, and whether each take has its frames.

The server is the real one, with its threads, its tracker and its recorder, in this process; only the bus is replaced by
a stand-in that hands over frames and answers for the nodes. People come and leave all day: a third of the frames has
them, each time with new tracking ids. Several short takes begin and end, then one long one. The reader of the stand-in
decodes the newest scene and status twenty times a second, as the view does. ``--inputs N`` asks for N frames. Takes are
written to the folder of temporary files, one at a time. Each look at the process is printed.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import psutil

from benchmarks._live_load import standing_people
from benchmarks.harness import Row, at_most, measured
from mocapella.live.server import Server, ServerSettings
from mocapella.model.session import CommandReply, RecordingHealth, SessionStatus, Setup
from mocapella.recording.take_reader import read_take
from mocapella.schema import decode_scene, encode_frame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.supervision import Boundary
from mocapella.tracker import warm_up
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.keys import NodeKey

METHOD: Final = "default"
SENSORS: Final = 6
PEOPLE: Final = 1
VISIT, PAUSE = 2_000, 4_000
"""Rounds, one frame of each sensor, in which people are there, and after which they come again."""
FRAMES: Final = 24 * 3600 * 30 * SENSORS
QUICK: Final = 60_000
SHORT_TAKES: Final = 5
LONG_SHARE: Final = 0.4
"""Share of the frames in the long take."""
SAMPLES: Final = 50
"""Looks at the process, evenly over the run; the first fifth is not part of a slope."""
MOST_MIB_PER_MILLION: Final = 8.0
LONG_ENOUGH: Final = 1_000_000
"""Frames from which on the growth of the memory is more than that of its first use."""
PATIENCE_S: Final = 120.0
_UNDER_WAY: Final = 2 * SENSORS
_READ_EVERY_S: Final = 0.05


class Frames:
    """The frames of one sensor as messages, made beforehand, so that sending them takes little of the time."""

    def __init__(self, node: NodeKey) -> None:
        people = standing_people(node.sensor, PEOPLE, seed=node.node_id)
        self._people, self._nobody = (
            [encode_frame(msgspec.structs.replace(one, node_id=node.node_id)) for one in some]
            for some in (people, standing_people(node.sensor, 0, seed=node.node_id, count=1))
        )

    def message(self, sequence: int, now_ns: int) -> bytes:
        """Return the message of a frame that is taken and sent now [ns]."""
        visit, since = divmod(sequence, VISIT + PAUSE)
        some = self._people if since < VISIT else self._nobody
        # A message keeps the memory of each value that its fields ever had, so each frame is a new one.
        message = pb.BodyFrame.FromString(some[sequence % len(some)])
        message.sequence, message.time_ns, message.sent_ns = sequence, now_ns, now_ns
        if since < VISIT:
            message.tracking_ids = np.arange(1 + visit * PEOPLE, 1 + (visit + 1) * PEOPLE, dtype="<u8").tobytes()
        return message.SerializeToString()


class Bus:
    """Takes the place of `mocapella.wire.server.ServerLink`, and of the nodes behind it.

    Attributes:
        sent: number of frames of each node.
        scenes: number of published scenes.
    """

    def __init__(self) -> None:
        self.errors = Boundary()
        self.on_nonsense: Callable[[str], None] = lambda text: None
        self.on_refused = self.on_nonsense
        self.refused = self.scenes = 0
        self.sent = {NodeKey(f"s{i}", i + 1): 0 for i in range(SENSORS)}
        self.newest: tuple[bytes, bytes] = (b"", b"")
        self._free = threading.Semaphore(_UNDER_WAY)
        self._frames = {node: Frames(node) for node in self.sent}

    def serve(self, **callbacks: Any) -> None:
        """Keep the server's callbacks, and let all nodes join."""
        self._callbacks = callbacks
        for node in self.sent:
            callbacks["on_alive"](node, True)
            callbacks["on_join"](node, {}, lambda data: None)

    def send_round(self) -> None:
        """Hand over a frame of each sensor, as soon as the tracker has room."""
        for node in self.sent:
            if not self._free.acquire(timeout=PATIENCE_S):
                raise AssertionError("the tracker stands still")
            now_ns = time.monotonic_ns()
            self._callbacks["on_frame"](node, self._frames[node].message(self.sent[node], now_ns), now_ns)
            self.sent[node] += 1

    def wait(self) -> None:
        """Wait until all frames are tracked."""
        for _ in range(_UNDER_WAY):
            if not self._free.acquire(timeout=PATIENCE_S):
                raise AssertionError("the tracker stands still")
        self._free.release(_UNDER_WAY)

    def command(self, verb: str) -> CommandReply:
        """Send a command, and wait for its answer."""
        answered, said = threading.Event(), list[bytes]()

        def answer(data: bytes) -> None:
            said.append(data)
            answered.set()

        answer.client = answer.sender = ""  # type: ignore[attr-defined]
        self._callbacks["on_command"](verb, {}, answer)
        if not answered.wait(PATIENCE_S):
            raise AssertionError(f"{verb} is not answered")
        return msgspec.json.decode(said[0], type=CommandReply)

    def publish_scene(self, data: bytes) -> None:
        self.scenes += 1
        self.newest = data, self.newest[1]
        self._free.release()

    def publish_status(self, data: bytes) -> None:
        self.newest = self.newest[0], data

    def request_frames(
        self,
        node: NodeKey,
        request: FrameRequest,
        on_frame: Callable[..., None],
        on_answer: Callable[[FrameAnswer], None],
        on_end: Callable[[], None],
    ) -> None:
        """Answer as a node that has sent everything, and keeps nothing."""
        on_answer(FrameAnswer(self.sent[node], self.sent[node], self.sent[node]))
        on_end()

    def probe_clock(self, node: NodeKey, timeout: float = 1.0) -> list[Any]:
        return []

    def close(self) -> None:
        pass


class Reader:
    """Decodes the newest scene and status on a thread of its own, until `close`."""

    def __init__(self, bus: Bus) -> None:
        self._bus, self._ended, self.read = bus, threading.Event(), 0
        self._thread = threading.Thread(target=self._run, name="reader")
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(_READ_EVERY_S):
            scene, status = self._bus.newest
            if scene and status:
                decode_scene(scene)
                msgspec.json.decode(status, type=SessionStatus)
                self.read += 1

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


def run(quick: bool = False, inputs: int | None = None) -> list[Row]:
    frames = inputs or (QUICK if quick else FRAMES)
    warm_up(METHOD)
    with tempfile.TemporaryDirectory(prefix="mocapella-soak-") as folder:
        bus, began = Bus(), time.perf_counter()
        server = Server(
            ServerSettings("", takes=Path(folder), setup=Setup(METHOD, sensors_expected=SENSORS), reserve_bytes=0),
            link=bus,  # type: ignore[arg-type]
        )
        reader = Reader(bus)
        try:
            looks, wrong, size = _load(server, bus, Path(folder), frames)
        finally:
            reader.close()
            server.close()
    return rows_of(looks, wrong, bus, reader.read, size=size, seconds=time.perf_counter() - began)


def _load(server: Server, bus: Bus, folder: Path, frames: int) -> tuple[list[tuple[int, ...]], int, int]:
    """Hand over all frames.

    Returns:
        The looks at the process, how many frames were wrong in the takes, and the size of the long take [bytes].
    """
    rounds = frames // SENSORS
    long = round(LONG_SHARE * rounds)
    short = (rounds - long) // (2 * SHORT_TAKES + 1)
    for _ in range(600):  # until the sensors are calibrated, and everything is loaded
        bus.send_round()
    bus.wait()
    process, looks, wrong, began_s = psutil.Process(), list[tuple[int, ...]](), 0, time.perf_counter()

    def send(count: int) -> None:
        every = max(1, rounds // SAMPLES)
        for number in range(count):
            bus.send_round()
            if number % every == 0:
                look = (sum(bus.sent.values()), process.memory_info().rss, process.num_fds(), threading.active_count())
                looks.append(look)
                said = f"{look[0]:,} frames in {time.perf_counter() - began_s:.0f} s"
                print(f"{said}, {look[1] >> 20} MiB, {look[2]} descriptors", file=sys.stderr)
        bus.wait()

    for number in range(SHORT_TAKES + 1):
        send(short)  # without a take
        path = folder / f"take-{number}.mcap"
        server.record_to(path)
        before = sum(bus.sent.values())
        send(short if number < SHORT_TAKES else long)
        wrong += check_take(bus.command("record-stop"), path, sum(bus.sent.values()) - before)
        size = path.stat().st_size
        path.unlink()
    send(SENSORS)
    return looks, wrong, size


def check_take(reply: CommandReply, path: Path, sent: int) -> int:
    """Return how many of the frames sent are not in the take, are there twice, or are reported lost.

    Another process reads the take, because its index of all frames would count as memory of the server.
    """
    recording: RecordingHealth = reply.status.recording if reply.status is not None else RecordingHealth()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other:
        frames, clean = other.submit(_read, path).result()
    return abs(frames - sent) + abs(recording.frames - sent) + recording.lost + (not (reply.ok and clean))


def _read(path: Path) -> tuple[int, bool]:
    take = read_take(path)
    return take.frame_count, take.clean


def rows_of(looks: list[tuple[int, ...]], wrong: int, bus: Bus, read: int, *, size: int, seconds: float) -> list[Row]:
    """Return the rows of a run.

    Args:
        looks: (frames so far, resident bytes, file descriptors, threads), in order.
        wrong: number of frames that takes lack, or have too much.
        bus: of the run.
        read: number of scenes that the reader has read.
        size: of the long take [bytes].
        seconds: duration of the run.
    """
    frames = sum(bus.sent.values())
    kept = np.array(looks[len(looks) // 5 :], np.float64)
    slope = float(np.polyfit(kept[:, 0] / 1e6, kept[:, 1] / 2**20, 1)[0])
    goal = at_most(MOST_MIB_PER_MILLION) if frames >= LONG_ENOUGH else None
    return [
        measured(f"soak: frames of {SENSORS} sensors", frames, "frames"),
        measured("soak: rate", frames / seconds, "frames/s"),
        measured("soak: frames without a scene", frames - bus.scenes, "frames", goal=at_most(0)),
        measured(f"soak: frames wrong in {SHORT_TAKES + 1} takes", wrong, "frames", goal=at_most(0)),
        measured("soak: memory, per million frames", slope, "MiB", goal=goal),
        measured("soak: file descriptors gained", kept[-1, 2] - kept[0, 2], "", goal=at_most(0)),
        measured("soak: threads gained", kept[-1, 3] - kept[0, 3], "", goal=at_most(0)),
        measured("soak: size of the long take", size / 1e9, "GB"),
        measured("soak: scenes read by a reader", read, "scenes"),
    ]
