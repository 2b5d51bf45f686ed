"""OSC that is sent: it is what the decoder reads, and a wrong address is refused in one line."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.schema.osc_messages import osc_message
from mocapella.sources.osc import messages
from mocapella.sources.osc_sender import OscSender

FLOATS = st.lists(st.floats(width=32, allow_nan=False), max_size=6)


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=9), FLOATS)
def test_what_is_encoded_is_decoded(name: str, values: list[float]) -> None:
    data = osc_message("/" + name, *values)
    assert len(data) % 4 == 0
    (read,) = messages(data)
    assert (read.address, list(read.arguments)) == ("/" + name, values)


def test_it_arrives() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        with OscSender(f"127.0.0.1:{receiver.getsockname()[1]}") as sender:
            sender.send("/pointer", 0.25, 0.5)
        (read,) = messages(receiver.recv(99))
    assert read.address == "/pointer"
    np.testing.assert_array_equal(read.arguments, (0.25, 0.5))


@pytest.mark.parametrize("target", ["", "9000", ":9000", "127.0.0.1:", "127.0.0.1:0", "h:65536", "h:1e3", "h:-1"])
def test_a_wrong_address_is_refused_with_one_that_would_work(target: str) -> None:
    with pytest.raises(SettingsError, match=r"expected HOST:PORT, such as 127\.0\.0\.1:9000") as caught:
        OscSender(target)
    assert repr(target) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_address_that_no_network_has_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"'a\.\.b:9000': no such host"):
        OscSender("a..b:9000")


def test_a_receiver_that_the_network_refuses_is_named() -> None:
    with OscSender("255.255.255.255:9000") as sender, pytest.raises(SettingsError, match=r"OSC to 255\.255\.255\.255"):
        sender.send("/pointer", 0.0)
