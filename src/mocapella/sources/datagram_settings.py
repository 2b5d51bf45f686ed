"""Settings and report of the markers that other programs send in UDP datagrams."""

from __future__ import annotations

from dataclasses import dataclass, field

from mocapella.model.observations import check_sensor_name
from mocapella.schema.marker_datagrams import MAX_DATAGRAM_BYTES, MAX_MARKERS
from mocapella.settings import check


@dataclass(frozen=True)
class DatagramSettings:
    """Which cameras send to which ports, and how their datagrams are read.

    Attributes:
        cameras: name and UDP port of each camera; port 0 takes any free one.
        markers: names of the markers, in the order of the coordinate pairs in a datagram.
        size_px: (width, height) of the images.
        host: address of this machine to listen at; 0.0.0.0 listens at all its addresses.
        sd_px: standard deviation of a marker's coordinate; 0 if unknown [px].
        delay: time from the middle of an image's exposure to its datagram's arrival [s].
        zero_is_lost: whether ``0,0`` means a marker that is not detected.
        max_rate_hz: highest rate at which a port is read, and so of its frames [Hz].
        by_host: identify a sender by its host only, not its port, for programs that open a socket for each datagram.
        source_timeout: time without a datagram from its sender after which a port accepts another sender [s].
        start_to: address and port of the start command, for programs that wait for one; None sends none.
        start_text: the start command, ASCII.
        start_every: interval at which the start command is repeated while a camera is silent [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    cameras: tuple[tuple[str, int], ...]
    markers: tuple[str, ...]
    size_px: tuple[int, int] = (640, 480)
    host: str = "127.0.0.1"
    sd_px: float = 0.0
    delay: float = 0.0
    zero_is_lost: bool = False
    max_rate_hz: float = 250.0
    by_host: bool = False
    source_timeout: float = 2.0
    start_to: tuple[str, int] | None = None
    start_text: str = "start"
    start_every: float = 1.0

    def __post_init__(self) -> None:
        names, ports = [name for name, _ in self.cameras], [port for _, port in self.cameras if port]
        check(1 <= len(names) == len(set(names)) <= 32, "cameras", names, "1 to 32, each with a name of its own")
        check(len(ports) == len(set(ports)), "cameras", ports, "each at a port of its own")
        for name, port in self.cameras:
            check_sensor_name(name)
            check(0 <= port <= 65535, f"port of {name}", port, "from 0 to 65535")
        n = len(self.markers)
        check(1 <= n <= MAX_MARKERS, "markers", n, f"1 to {MAX_MARKERS} names")
        named = len(set(self.markers)) == n and all(0 < len(name) <= 80 for name in self.markers)
        check(named, "markers", self.markers, "names of 1 to 80 characters, each once")
        check(all(0 < side <= 16_384 for side in self.size_px), "size_px", self.size_px, "1 to 16384 pixels each")
        check(0 <= self.sd_px <= 100, "sd_px", self.sd_px, "from 0 to 100 px")
        check(0 <= self.delay <= 1, "delay", self.delay, "from 0 to 1 s")
        check(1 <= self.max_rate_hz <= 1000, "max_rate_hz", self.max_rate_hz, "from 1 to 1000 Hz")
        check(0 < self.source_timeout <= 3600, "source_timeout", self.source_timeout, "above 0 and at most 3600 s")
        check(0.05 <= self.start_every <= 3600, "start_every", self.start_every, "from 0.05 to 3600 s")
        fits = self.start_text.isascii() and 0 < len(self.start_text) <= MAX_DATAGRAM_BYTES
        check(fits, "start_text", self.start_text, f"1 to {MAX_DATAGRAM_BYTES} ASCII characters")
        if self.start_to is not None:
            check(0 < self.start_to[1] <= 65535, "port of start_to", self.start_to[1], "from 1 to 65535")


@dataclass(frozen=True)
class PortReport:
    """Counts of one camera's datagrams. Every datagram that was read is in one of the first six.

    Attributes:
        frames: number of datagrams that became frames.
        refused: number of datagrams that could not be decoded, by reason.
        superseded: number of datagrams skipped because a newer one was waiting.
        other_senders: number of datagrams from a sender that the port does not belong to.
        out_of_order: number of datagrams with a lower sequence number than the one before.
        repeated: number of datagrams with the sequence number of the one before.
        missing: number of missing sequence numbers, if the program sends them.
        overflowed: number of datagrams dropped by this machine before they could be read, if it reports them.
        clock_jumps: number of jumps of the sender's clock, if the program sends times.
        senders: number of senders that the port has belonged to so far.
        sender: address of the sender that the port belongs to; empty if none.
        last_problem: reason of the last refusal.
    """

    frames: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    superseded: int = 0
    other_senders: int = 0
    out_of_order: int = 0
    repeated: int = 0
    missing: int = 0
    overflowed: int = 0
    clock_jumps: int = 0
    senders: int = 0
    sender: str = ""
    last_problem: str = ""
