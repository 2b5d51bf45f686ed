"""A take's MCAP file, whose channels are added on first use, each with its schema.

The protobuf channels have the descriptors of the messages, so that Foxglove and other MCAP tools can read a take.
"""

from __future__ import annotations

from mocapella import __version__
from mocapella.model.frame_types import MessageFormat
from mocapella.recording import take
from mocapella.recording.mcap_file import McapFile
from mocapella.recording.take import Run
from mocapella.schema import format_of
from mocapella.schema.envelope import protobuf_format


class TakeFile(McapFile):
    """An `McapFile` that adds the channel of each topic of a take by itself, when its first message comes.

    Args:
        fd: descriptor of an empty file, opened for writing; the caller closes it.
    """

    def __init__(self, fd: int) -> None:
        super().__init__(fd, f"mocapella {__version__}")
        self._channel_of: dict[str, int] = {}
        self._schema_of: dict[str, int] = {}

    def add(self, topic: str, data: bytes, log_ns: int, sequence: int = 0, publish_ns: int | None = None) -> None:
        """Add a message to the next flush.

        Args:
            topic: topic of the message's channel, such as `mocapella.recording.take.SCENES`.
            data: the encoded message.
            log_ns: time of the entry, on the server's clock.
            sequence: sequence number of a frame, number of a run, else 0.
            publish_ns: MCAP's time of publication, on the server's clock; None for ``log_ns``.

        Raises:
            WireError, KeyError: as in `channel_format`, at the first message of a topic.
        """
        channel = self._channel_of.get(topic)
        if channel is None:
            channel = self._channel_of[topic] = self._open(topic, data)
        published = log_ns if publish_ns is None else publish_ns
        self.add_message(channel, data, log_ns=log_ns, publish_ns=published, sequence=sequence)

    def add_run(self, run: Run) -> None:
        """Add a run's description to the next flush, twice: as a metadata record, and as a message in a chunk."""
        self.add_metadata(take.RUN_METADATA, take.run_metadata(run))
        self.add(take.RUNS, take.encode_run(run), run.info.started_ns, run.number)

    def _open(self, topic: str, data: bytes) -> int:
        kind = channel_format(topic, data)
        schema = self._schema_of.get(kind.schema_name)
        if schema is None:
            schema = self.add_schema(kind.schema_name, kind.schema_encoding, kind.schema)
            self._schema_of[kind.schema_name] = schema
        return self.add_channel(topic, kind.encoding, schema)


def channel_format(topic: str, data: bytes) -> MessageFormat:
    """Return the MCAP format of a topic's messages.

    Args:
        topic: the channel's topic.
        data: the first message; it determines the type of frames.

    Raises:
        WireError: the topic is that of frames, and the message is no frame.
        KeyError: takes have no such topic.
    """
    if topic.startswith(take.FRAMES):
        return format_of(data)
    if topic.startswith(take.TRUTH):
        return protobuf_format("Truth")
    if topic == take.SCENES:
        return protobuf_format("Scene")
    names = {
        take.RUNS: "Run",
        take.COMMANDS: "Command",
        take.STATUS: "SessionStatus",
        take.CLOCK: "ClockProbes",
        take.NODES: "NodeLedger",
        take.EARLIER: "TakeSoFar",
    }
    return MessageFormat("json", f"mocapella.{names[topic]}", "jsonschema", b'{"type":"object"}')
