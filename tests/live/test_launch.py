"""Ports: a used one is told from one that cannot be had at all."""

from __future__ import annotations

import socket

import pytest
from support.programs import wait_until

from mocapella.errors import AddressInUseError, BusError
from mocapella.live.launch import Children, check_port_free, free_port


def test_a_port_in_use_is_named_with_the_option_that_chooses_another() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(AddressInUseError, match=f"port {port} .* --view-port"):
            check_port_free("127.0.0.1", port, "--view-port")
    check_port_free("127.0.0.1", free_port(), "--view-port")


def test_an_address_of_another_machine_is_not_said_to_be_in_use() -> None:
    with pytest.raises(BusError, match=r"cannot listen at port 7447 on 192\.0\.2\.1") as refused:
        check_port_free("192.0.2.1", 7447, "--port")
    assert not isinstance(refused.value, AddressInUseError)


def test_what_a_process_prints_ends_no_thread() -> None:
    """Neither bytes that are no text, nor an error of who is told."""
    heard: list[str] = []

    def hear(line: str) -> None:
        heard.append(line)
        if len(heard) == 1:
            raise ZeroDivisionError("planted")

    prints = r"import sys; sys.stdout.buffer.write(b'first\n\xff\x1b\nlast\n'); sys.stdout.flush()"
    with Children() as children:
        children.start(["-n1", "-r1", "-s", prints, "pass"], hear, module="timeit")
        wait_until("the last line", lambda: "last" in heard)
    assert heard[:3] == ["first", "\\xff\x1b", "last"]
