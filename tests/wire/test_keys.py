"""The names on the bus."""

from __future__ import annotations

from ipaddress import IPv4Address, IPv6Address

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import BusError, SettingsError, WireError
from mocapella.wire import keys
from mocapella.wire.address import is_loopback, parse_address

NAMES = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)


@given(name=NAMES, node_id=st.integers(0, 2**64 - 1))
def test_a_node_is_read_back_from_its_key(name: str, node_id: int) -> None:
    node = keys.NodeKey(name, node_id)
    assert keys.node_of(keys.of_node("live", node)) == node


@pytest.mark.parametrize("key", ["", "a", "a/zz", "mocapella/v1/live/front/zz", f"mocapella/v1/live/<script>/{1:016x}"])
def test_a_key_that_names_no_node_is_refused(key: str) -> None:
    with pytest.raises(WireError):
        keys.node_of(key)


@pytest.mark.parametrize(
    "text", ["", "1", "f" * 17, "F" * 16, "-" + "1" * 15, "1_" * 8, "0x" + "1" * 14, " " + "1" * 15]
)
def test_a_node_id_has_one_form_only_so_that_one_node_has_one_key(text: str) -> None:
    with pytest.raises(WireError, match="16 lower-case hex digits"):
        keys.parse_node_id(text)
    with pytest.raises(WireError, match="16 hex digits"):
        keys.node_of(f"mocapella/v1/live/front/{text}")


@pytest.mark.parametrize("name", ["", "../x", "a/b", "<script>", "-a", "a" * 65, "a b", "*"])
def test_a_sensor_name_that_could_be_more_than_a_name_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match="sensor name"):
        keys.of_node("live", keys.NodeKey(name, 1))


@pytest.mark.parametrize("address", ["", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "tcp/h:99999", "x/h:1"])
def test_an_address_that_cannot_be_used_is_refused(address: str) -> None:
    with pytest.raises(BusError, match=r"tls/127\.0\.0\.1:7447"):
        parse_address(address)


def test_loopback_is_told_from_other_interfaces() -> None:
    assert is_loopback("tcp/127.0.0.1:7447")
    assert is_loopback("tcp/[::1]:7447")
    assert not is_loopback("tcp/0.0.0.0:7447")
    assert not is_loopback("tcp/192.0.2.1:7447")


@given(st.ip_addresses(), st.integers(1, 65535))
def test_a_number_is_loopback_as_the_standards_say(address: IPv4Address | IPv6Address, port: int) -> None:
    host = f"[{address}]" if address.version == 6 else str(address)
    assert is_loopback(f"tcp/{host}:{port}") == address.is_loopback


@pytest.mark.parametrize("host", ["127.evil.example", "127.0.0.1.example.org", "localhost.example.org", "127.", ""])
def test_a_name_that_looks_like_loopback_is_none(host: str) -> None:
    assert not is_loopback(f"tcp/{host}:7447")


@given(st.sampled_from(["tcp", "tls"]), st.ip_addresses(), st.integers(1, 65535), st.sampled_from(["", "lab-2"]))
def test_an_address_reads_back_and_is_tls_whatever_it_says(
    protocol: str, ip: IPv4Address | IPv6Address, port: int, session: str
) -> None:
    host = f"[{ip}]" if ip.version == 6 else str(ip)
    address = parse_address(f"{session}@{protocol}/{host}:{port}" if session else f"{protocol}/{host}:{port}")
    assert address.locator == f"tls/{host}:{port}"
    assert (address.session, address.bare_host, address.port) == (session, str(ip), port)
    assert address.local == ip.is_loopback
    assert parse_address(str(address)) == address
