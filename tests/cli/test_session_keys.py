"""``mocapella session``: a key from one machine to another, here from one folder of keys to another."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from support.programs import free_port, run_here, wait_until

from mocapella.live.server import Server, ServerSettings
from mocapella.wire.node import NodeLink
from mocapella.wire.role_key import PREFIX, read_code
from mocapella.wire.session_key import session_key


@pytest.fixture
def machines(tmp_path: Path) -> tuple[str, str]:
    return str(tmp_path / "server" / "sessions"), str(tmp_path / "node" / "sessions")


def test_a_node_of_another_machine_joins_with_an_invitation(
    machines: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = machines
    address = f"tls/127.0.0.1:{free_port()}"
    monkeypatch.setenv("MOCAPELLA_SESSIONS", here)
    invited = run_here(tmp_path, "session", "invite", "sensor.front", "--at", address.removeprefix("tls/"),
                       "--session", "lab", "--out", "front.key")  # fmt: skip
    assert invited.returncode == 0, invited.stderr
    assert "from the next start of its server on" in invited.stderr
    assert (tmp_path / "front.key").stat().st_mode & 0o777 == 0o600
    server = Server(ServerSettings(f"lab@{address}", takes=tmp_path / "takes"))
    try:
        monkeypatch.setenv("MOCAPELLA_SESSIONS", there)
        with NodeLink(address, "front") as stranger:
            assert not stranger.join(timeout=0.2)
            assert "of the session lab" in stranger.why_not_admitted()
        assert server.status().health.turned_away["attempts with a key of another session"] > 0
        assert any('the sensor "front"' in notice and "was refused" in notice for notice in server.status().notices)
        joined = run_here(tmp_path, "session", "join", "front.key")
        assert joined.returncode == 0, joined.stderr
        with NodeLink(address, "front") as link:
            wait_until("it joins", lambda: link.join(timeout=0.5))
    finally:
        server.close()


def test_a_code_is_the_result_and_can_be_piped(
    machines: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = machines
    monkeypatch.setenv("MOCAPELLA_SESSIONS", here)
    invited = run_here(tmp_path, "session", "invite", "reader", "--at", "192.0.2.7")
    assert invited.stdout.startswith(PREFIX)
    assert invited.stdout.count("\n") == 1
    assert read_code(invited.stdout).address == "tls/192.0.2.7:7447"
    monkeypatch.setenv("MOCAPELLA_SESSIONS", there)
    monkeypatch.setattr("sys.stdin", io.StringIO(invited.stdout))
    joined = run_here(tmp_path, "session", "join")
    assert joined.returncode == 0, joined.stderr
    assert "--connect tls/192.0.2.7:7447" in joined.stderr
    assert PREFIX not in joined.stderr
    assert [file.name for file in Path(there).iterdir()] == ["192.0.2.7_7447.reader.key"]


def test_what_is_no_role_address_or_code_is_refused_in_one_line(
    machines: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOCAPELLA_SESSIONS", machines[0])
    monkeypatch.setattr("sys.stdin", io.StringIO("hello\n"))
    for words, part in ((("invite", "king"), "unknown role 'king'; known: sensor, sensor.NAME"),
                        (("invite", "reader", "--at", "a:b"), "address"),
                        (("join", "nothing.key"), "name a file of `mocapella session invite`"),
                        (("join",), "is no key")):  # fmt: skip
        done = run_here(tmp_path, "session", *words)
        assert done.returncode == 1
        assert part in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_a_renewed_session_has_another_authority(
    machines: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOCAPELLA_SESSIONS", machines[0])
    before = session_key("default")
    assert run_here(tmp_path, "session", "renew").returncode == 0
    assert session_key("default").authority != before.authority
