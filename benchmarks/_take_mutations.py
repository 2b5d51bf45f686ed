"""Takes whose contents are damaged and whose checksums are right, so that a reader gets as far as the contents."""

from __future__ import annotations

import base64
import os
import random
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Final

from benchmarks._mutations import MUTATIONS
from benchmarks._text_mutations import drop_stretch, repeat_token, replace_token
from mocapella.model.session import Setup
from mocapella.recording import take
from mocapella.recording.mcap_file import McapFile
from mocapella.recording.mcap_scan import MessageRead, MetadataRead, scan
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene, encode_truth
from mocapella.testing.frames import example_frames
from mocapella.tracker import make_tracker

FROM_TEXT: Final = (take.RUNS, take.COMMANDS, take.STATUS, take.CLOCK)
"""Topics of JSON messages."""


def write_example(path: Path) -> bytes:
    """Write a take with every kind of content that a take has; return its bytes."""
    from benchmarks.codec import scene, truth

    writer = TakeWriter.create(path, info=TakeInfo(Setup(), 1_700_000_000_000_000_000, 0), reserve_bytes=0)
    frames = example_frames()
    for k, frame in enumerate(frames):
        writer.write_frame(encode_frame(frame), sensor=frame.sensor, node_id=k + 1, sequence=0, log_ns=k)
    writer.write_scene(encode_scene(scene()), 10)
    writer.write_truth(encode_truth(truth()), sensor="front", log_ns=11)
    writer.write_clock({"front": [1, 2, 3]}, 12)
    memory = base64.b64encode(make_tracker("stand-still").snapshot()).decode()
    writer.write_command({"verb": "restore", "tracker": memory, "names": {"1": "anna"}}, 13, 0)
    writer.close()
    return path.read_bytes()


class TakeMutations:
    """Makes damaged takes of one valid take."""

    def __init__(self, data: bytes) -> None:
        self._events = [e for e in scan(BytesIO(data), len(data), "seed") if isinstance(e, MessageRead | MetadataRead)]
        self._events.append(MessageRead(take.STATUS, 0, 14, 14, 0, b'{"phase":"tracking","scenes":7,"sensors":[]}'))
        self._binary = [e.data for e in self._events if isinstance(e, MessageRead) and e.topic not in FROM_TEXT]

    def write(self, path: Path, rng: random.Random) -> None:
        """Write a damaged take to a file that may exist."""
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        try:
            file, channels = McapFile(fd, "mocapella"), dict[str, int]()
            for event in self._damaged(rng):
                if isinstance(event, MetadataRead):
                    file.flush(durable=False)
                    file.add_metadata(event.name, event.values)
                else:
                    if event.topic not in channels:
                        channels[event.topic] = file.add_channel(event.topic, "", 0)
                    file.add_message(
                        channels[event.topic], event.data, log_ns=event.log_ns, publish_ns=event.publish_ns,
                        sequence=event.sequence,
                    )  # fmt: skip
            file.finish()
        finally:
            os.close(fd)

    def _damaged(self, rng: random.Random) -> Iterator[MessageRead | MetadataRead]:
        chosen = set(rng.sample(range(len(self._events)), rng.randint(1, 3)))
        for k, event in enumerate(self._events):
            if k not in chosen:
                yield event
            elif isinstance(event, MetadataRead):
                text = _text_damage(rng)(event.values.get("run", "").encode(), rng, ())
                sound = text.decode("utf-8", "replace")
                yield MetadataRead(event.name, {"run": sound, "crc32": f"{zlib.crc32(sound.encode()):08x}"})
            else:
                damage = _text_damage(rng) if event.topic in FROM_TEXT else rng.choice(MUTATIONS)
                data = damage(event.data, rng, self._binary)
                yield MessageRead(event.topic, event.sequence, event.log_ns, event.publish_ns, 0, data)


def _text_damage(rng: random.Random) -> Callable[..., bytes]:
    return rng.choice((replace_token, replace_token, repeat_token, drop_stretch, *MUTATIONS[:3]))


def read_everything(path: Path) -> None:
    """Read all contents of a take, each kind to its first fault.

    Raises:
        MocapellaError: nothing in it can be read.
    """
    from mocapella.errors import MocapellaError
    from mocapella.recording.take_reader import read_take

    found = read_take(path)
    kinds: tuple[Callable[[], object], ...] = (
        lambda: found.info, found.complete, lambda: found.unread_frame_types, lambda: found.part_counts,
        lambda: list(found.frames()), lambda: list(found.scenes()), lambda: list(found.statuses()),
        lambda: list(found.clock_probes()), lambda: list(found.replay()), lambda: list(found.truths("front")),
        lambda: [list(found.frames_in_sequence(sensor)) for sensor in found.sensors],
        lambda: [list(found.raw_run(run.number)) for run in found.runs],
    )  # fmt: skip
    for read in kinds:
        try:
            read()
        except MocapellaError:
            continue
