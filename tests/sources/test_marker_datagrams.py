"""Ports that take datagrams, with real sockets on this machine: whose they are, what is newest, and what is counted.

`poll` is called here when it is to look, so that what waits is what was sent, however slow the machine.
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from mocapella.errors import AddressInUseError, BusError, SettingsError
from mocapella.model.markers import MarkerFrame
from mocapella.schema.marker_datagrams import MarkerDatagram
from mocapella.sources import datagram_port
from mocapella.sources.datagram_settings import DatagramSettings, PortReport
from mocapella.sources.marker_datagrams import MarkerDatagrams

PATIENCE_S = 20.0
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux: sockets of a sender's own")


class Hand:
    """A clock that is turned by hand."""

    def __init__(self) -> None:
        self.ns = 10**12

    def __call__(self) -> int:
        return self.ns

    def turn(self, seconds: float) -> None:
        self.ns += round(seconds * 1e9)


class Cameras:
    """Two ports, senders, and what was said."""

    def __init__(self, **changed: object) -> None:
        self.said: list[str] = []
        self.clock = Hand()
        settings = {"cameras": (("left", 0), ("right", 0)), "markers": ("red", "blue"), **changed}
        self.source = MarkerDatagrams(DatagramSettings(**settings), self.said.append, self.clock)  # type: ignore[arg-type]
        self.senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]

    def send(self, *data: bytes, to: str = "left", by: int = 0) -> None:
        for one in data:
            self.senders[by].sendto(one, self.source.addresses[to])

    def poll(self) -> list[MarkerFrame]:
        """After the ports have rested."""
        self.clock.turn(1.0 / 250)
        return self.source.poll()

    def report(self, camera: str = "left") -> PortReport:
        return self.source.report[camera]


@contextmanager
def cameras(**changed: object) -> Iterator[Cameras]:
    made = Cameras(**changed)
    try:
        with made.source:
            yield made
    finally:
        for sender in made.senders:
            sender.close()


def red(frame: MarkerFrame) -> float:
    return float(frame.positions_px[0, 0])


def test_a_datagram_becomes_a_frame_of_its_camera() -> None:
    with cameras(sd_px=0.25, size_px=(320, 240)) as made:
        made.send(b"12.5,34;-1,-1\n", to="right")
        (frame,) = made.poll()
    assert (frame.sensor, frame.names, frame.size_px) == ("right", ("red", "blue"), (320, 240))
    np.testing.assert_array_equal(frame.positions_px, [(12.5, 34.0), (np.nan, np.nan)])
    np.testing.assert_array_equal(frame.sd_px, np.float32([0.25, np.nan]))
    assert made.report("right") == PortReport(frames=1, senders=1)
    assert made.report("left") == PortReport()


def test_of_several_that_wait_the_newest_is_taken() -> None:
    with cameras() as made:
        made.send(*(b"%d,0;," % k for k in range(5)))
        assert [red(frame) for frame in made.poll()] == [4.0]
        assert (made.report().frames, made.report().superseded) == (1, 4)
        made.send(b"7,0;,", b"garbage")
        assert [red(frame) for frame in made.poll()] == [7.0]
        assert made.report().refused == {"not a pair of numbers": 1}


def test_capture_is_arrival_and_rises() -> None:
    with cameras(delay=0.5) as made:
        times = []
        for k in range(20):
            made.send(b"%d,0;," % k)
            times += [frame.time_ns for frame in made.poll()]
        assert len(times) == 20
        assert (np.diff(times) > 0).all()


@contextmanager
def a_port(**changed: object) -> Iterator[datagram_port.DatagramPort]:
    """One port, to which nobody sends."""
    settings = DatagramSettings(**{"cameras": (("left", 0),), "markers": ("red",), **changed})  # type: ignore[arg-type]
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", 0))
    port = datagram_port.DatagramPort("left", listener, settings, lambda _text: None)
    try:
        yield port
    finally:
        port.close()


def told(time_us: int | None) -> MarkerDatagram:
    return MarkerDatagram(np.array([[1.0, 2.0]]), None if time_us is None else 0, time_us)


@pytest.mark.parametrize("delay", [0.0, 0.05, 1.0])
def test_capture_is_before_arrival_by_the_delay_and_told_times_keep_their_intervals(delay: float) -> None:
    arrived_ns = 10**12 + np.cumsum([0, 20_000_000, 31_000_000, 12_500_000])
    with a_port(delay=delay) as port:
        times = [port._frame(told(None), int(at)).time_ns for at in arrived_ns]
    np.testing.assert_array_equal(times, arrived_ns - round(1e9 * delay))
    with a_port(delay=delay) as port:
        times = [port._frame(told(7_000 + 20_000 * k), int(at)).time_ns for k, at in enumerate(arrived_ns)]
    intervals_ns = np.diff(times, prepend=10**12 - round(1e9 * delay))
    assert intervals_ns.tolist() == [0, 20_000_000, 20_000_000, 20_000_000], "though some came later after their time"


def test_times_rise_by_a_nanosecond_where_none_passed_or_the_clock_went_back() -> None:
    with a_port() as port:
        times = [port._frame(told(None), at).time_ns for at in (10**12, 10**12, 10**12 - 5, 10**12 + 1, 10**12 + 9)]
    assert times == [10**12, 10**12 + 1, 10**12 + 2, 10**12 + 3, 10**12 + 9]


@linux_only
def test_the_time_is_that_of_arrival_not_of_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    def waited_ns(seconds: float) -> int:
        """How long after a datagram was sent it is told to have come, if it waits for so long."""
        made.send(b"1,0;,")
        before_ns = datagram_port.time.monotonic_ns()
        datagram_port.time.sleep(seconds)
        (frame,) = made.poll()
        return frame.time_ns - before_ns

    with cameras() as made:
        # Linux stamps what comes only a moment after it was asked to: on a busy machine the first may have no stamp.
        assert any(waited_ns(0.05) < 25_000_000 for _ in range(100))
        assert waited_ns(0.3) < 150_000_000


def test_a_port_belongs_to_its_first_sender_until_that_is_silent() -> None:
    with cameras(source_timeout=2.0) as made:
        made.send(b"GET / HTTP/1.1\r\n\r\n", by=1)  # who cannot be read does not get it
        assert made.poll() == []
        made.send(b"1,0;,", by=0)
        assert len(made.poll()) == 1
        made.send(b"2,0;,", by=1)
        assert made.poll() == []
        assert made.report().other_senders == 1
        assert made.report().sender == "{}:{}".format("127.0.0.1", made.senders[0].getsockname()[1])
        made.clock.turn(2.1)
        made.poll()
        assert made.report().sender == ""
        made.send(b"3,0;,", by=1)
        assert [red(frame) for frame in made.poll()] == [3.0]
        made.send(b"4,0;,", by=0)
        assert made.poll() == []
        assert (made.report().senders, made.report().other_senders) == (2, 2)
    assert [line for line in made.said if "hears" in line or "nothing from" in line or "others" in line] == made.said[
        1:
    ]
    assert len(made.said) == 6


def test_a_program_that_opens_a_socket_for_each_datagram_is_one_sender_by_its_host() -> None:
    for by_host, heard in ((True, [1.0, 2.0, 3.0]), (False, [1.0])):
        with cameras(by_host=by_host) as made:
            found = []
            for k in range(3):
                made.send(b"%d,0;," % (k + 1), by=k)
                found += [red(frame) for frame in made.poll()]
            assert found == heard
            assert made.report().other_senders == 3 - len(heard)
            assert any("needs --set by_host=true" in line for line in made.said) == (not by_host)


@linux_only
def test_what_others_send_to_the_port_leaves_room_for_its_sender() -> None:
    with cameras() as made:
        made.send(b"1,0;,")
        made.poll()
        made.send(*[b"9,9;9,9"] * 3000, by=1)  # far more than a socket's buffer holds
        made.send(b"2,0;,")
        made.send(b"5,0;,", to="right", by=2)
        assert [(frame.sensor, red(frame)) for frame in made.poll()] == [("left", 2.0), ("right", 5.0)]
        assert 0 < made.report().other_senders <= datagram_port._MOST_READ


def test_a_flood_is_read_in_bounded_turns_and_the_other_port_is_served() -> None:
    """Sent as fast as this machine can; between two turns of the clock a port gives one frame at most."""
    with cameras(max_rate_hz=100.0) as made:
        read = 0
        for k in range(30):
            made.send(*[b"1,1;2,2"] * 200)
            made.send(b"%d,0;," % k, to="right")
            made.clock.turn(0.004)
            frames = made.source.poll()
            before, read = read, made.report().frames + made.report().superseded
            assert read - before <= datagram_port._MOST_READ
            if k % 3 == 0:  # 12 ms: both ports have rested
                assert [frame.sensor for frame in frames] == ["left", "right"]
                assert red(frames[1]) == k
            else:
                assert frames == []
        assert made.report().frames == 10
        if sys.platform == "linux":
            assert made.report().overflowed > 1000


def test_garbage_at_a_high_rate_costs_few_readings_and_is_counted() -> None:
    with cameras() as made:
        made.send(b"1,0;,")
        made.poll()
        made.send(*[b"\xff" * 100] * 30)
        assert made.poll() == []
        tried = datagram_port._MOST_DECODED
        assert (made.report().refused, made.report().superseded) == ({"not text": tried}, 30 - tried)
        made.send(b"2,0;,")
        assert [red(frame) for frame in made.poll()] == [2.0]
    assert sum("refused a datagram" in line for line in made.said) == 1


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"x" * 60_000, "too long"),
        (b"/red\0\0\0\0,ff\0" + struct.pack(">ff", 1, 2), "not text"),
        (b"1,2", "number of markers"),
        (b"1,2;1e308,3", "outside the picture"),
        (b"1,2;nan,3", "one coordinate"),
        (b"1,2;-inf,3", "not finite"),
        (b"", "empty"),
    ],
)
def test_what_cannot_be_read_is_counted_by_reason_and_said_once(data: bytes, problem: str) -> None:
    with cameras() as made:
        for _ in range(3):
            made.send(data)
            assert made.poll() == []
        assert made.report().refused == {problem: 3}
        assert len(made.said) == 1
        assert made.report().last_problem in made.said[0]


def test_numbers_tell_what_is_late_repeated_missing_and_begun_anew() -> None:
    with cameras() as made:
        taken = []
        for sequence in (10, 11, 11, 9, 14, 5000, 3):
            made.send(b"#%d;%d,0;," % (sequence, sequence % 600))
            taken += [red(frame) for frame in made.poll()]
        assert taken == [10.0, 11.0, 14.0, 200.0, 3.0]
        report = made.report()
        assert (report.repeated, report.out_of_order, report.missing) == (1, 1, 2)
        made.send(b"#4;4,0;,", b"#5;5,0;,", b"#6;6,0;,")  # passed over, not missing
        assert [red(frame) for frame in made.poll()] == [6.0]
        assert (made.report().missing, made.report().superseded) == (2, 2)


def test_a_program_that_counts_anew_is_heard_after_the_timeout() -> None:
    with cameras(source_timeout=1.0) as made:
        made.send(b"#500;1,0;,")
        made.poll()
        heard = []
        for k in range(20):
            made.send(b"#%d;%d,0;," % (k, k))
            made.clock.turn(0.1)
            heard += made.poll()
        assert 5 <= len(heard) < 15
        assert red(heard[-1]) == 19.0


def test_told_times_are_without_the_ways_jitter() -> None:
    rng = np.random.default_rng(4)
    clock = datagram_port.SenderClock()
    sent = np.arange(2000) * 16_666_667
    arrived = 777_000_000_000 + sent + 2_000_000 + rng.exponential(5_000_000, 2000).astype(int)
    told = [clock.at(int(a), int(b)) for a, b in zip(sent, arrived, strict=True)]
    at = np.array([one for one, _ in told])
    assert not any(jumped for _, jumped in told)
    assert (at <= arrived).all()
    assert np.abs(np.diff(at[300:]) - 16_666_667).max() < 100_000  # the way's own: 5 ms
    assert np.abs(at[300:] - sent[300:] - 777_002_000_000).max() < 200_000


@pytest.mark.parametrize("jump_ns", [3_600_000_000_000, -3_600_000_000_000, 500_000_000, -500_000_000])
def test_a_senders_clock_may_be_set(jump_ns: int) -> None:
    clock, sent, said = datagram_port.SenderClock(), 10**13, []
    for k in range(20):
        arrived = 10**9 + k * 10_000_000
        at, jumped = clock.at(sent + k * 10_000_000 + (jump_ns if k >= 10 else 0), arrived)
        assert at == arrived
        said.append(jumped)
    assert said == [k == 10 for k in range(20)]


def test_times_reach_the_frames() -> None:
    with cameras() as made:
        times = []
        for k in range(10):
            made.send(b"#%d,%d;1,0;," % (k, 5_000_000 + 20_000 * k if k < 5 else 10**9))
            times += [frame.time_ns for frame in made.poll()]
        assert len(times) == 10
        assert made.report().clock_jumps == 1
        assert (np.diff(times) > 0).all()


def test_the_start_command_is_repeated_while_a_camera_is_silent() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(PATIENCE_S)
        with cameras(start_to=listener.getsockname(), start_text="GO", start_every=1.0) as made:
            for _ in range(3):
                made.poll()
                assert listener.recv(100) == b"GO"
                made.poll()  # not yet time
                made.clock.turn(1.0)
            assert made.source.starts_sent == 3
            made.send(b"1,0;,", to="left")
            made.send(b"1,0;,", to="right")
            made.poll()
            sent = made.source.starts_sent
            made.clock.turn(1.5)
            made.poll()
            assert made.source.starts_sent == sent


def test_a_start_command_that_cannot_be_sent_is_said_once() -> None:
    with cameras(start_to=("255.255.255.255", 1), start_text="x" * 1400) as made:
        assert made.source._starter is not None
        made.source._starter._socket.close()
        for _ in range(3):
            made.clock.turn(1.0)
            made.poll()
        assert made.source.starts_sent == 0
        assert len([line for line in made.said if "could not be sent to 255.255.255.255:1" in line]) == 1


def test_a_start_address_that_is_none_is_named() -> None:
    with pytest.raises(BusError, match="cannot send the start command to no such host:5000"):
        MarkerDatagrams(DatagramSettings((("left", 0),), ("red",), start_to=("no such host", 5000))).start()


@linux_only
def test_a_port_in_use_is_named_and_nobody_shares_one_of_ours() -> None:
    with cameras() as made:
        made.send(b"1,0;,")
        made.poll()  # its sender has a socket of its own now
        host, port = made.source.addresses["left"]
        with pytest.raises(AddressInUseError, match=f"{host}:{port} is in use by another program"):
            MarkerDatagrams(DatagramSettings((("left", 0), ("right", port)), ("red",))).start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
            thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with pytest.raises(OSError, match="in use"):
                thief.bind((host, port))


def test_stopping_frees_the_ports() -> None:
    with cameras() as made:
        made.send(b"1,0;,")
        made.poll()
        address = made.source.addresses["left"]
    made.source.stop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(address)


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"cameras": ()}, "cameras"),
        ({"cameras": (("left", 1), ("left", 2))}, "cameras"),
        ({"cameras": (("left", 1), ("right", 1))}, "cameras"),
        ({"cameras": (("left", 65536),)}, "port of left"),
        ({"cameras": (("no/name", 1),)}, "sensor name"),
        ({"markers": ()}, "markers"),
        ({"markers": ("red", "red")}, "markers"),
        ({"markers": ("",)}, "markers"),
        ({"size_px": (0, 480)}, "size_px"),
        ({"sd_px": -1.0}, "sd_px"),
        ({"delay": 2.0}, "delay"),
        ({"max_rate_hz": 0.0}, "max_rate_hz"),
        ({"source_timeout": 0.0}, "source_timeout"),
        ({"start_every": 0.0}, "start_every"),
        ({"start_text": "é"}, "start_text"),
        ({"start_to": ("127.0.0.1", 0)}, "port of start_to"),
    ],
)
def test_settings_out_of_range_are_refused(changed: dict[str, object], what: str) -> None:
    with pytest.raises(SettingsError, match=what):
        DatagramSettings(**{"cameras": (("left", 1),), "markers": ("red",), **changed})  # type: ignore[arg-type]
