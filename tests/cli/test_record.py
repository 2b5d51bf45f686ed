"""A take of a running server, begun and ended from the command line, by whomever."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.programs import Program, free_port, result, run, wait_until

from mocapella.recording.take_reader import read_take


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[Program, str]]:
    """It may leave little free, and has no sensor: what is asked here is who ends a take."""
    port = free_port()
    words = ["--no-view", "--port", str(port), "--set", "reserve_gib=0.001", "--json", "server.json"]
    with Program(tmp_path, "server", "serve", *words) as program:
        wait_until("the server listens", program.said("waiting for sensors at"))
        yield program, f"tcp/127.0.0.1:{port}"


def test_a_take_whose_client_was_killed_is_ended_by_another(server: tuple[Program, str], tmp_path: Path) -> None:
    program, address = server
    with Program(tmp_path, "record", "record", "walk", "--connect", address) as client:
        wait_until("it records", client.said("recording "))
        client.process.kill()
        client.process.wait()
    refused = run(tmp_path, "record", "other", "--connect", address)
    assert refused.returncode == 1
    assert "already recording takes/walk.mcap" in refused.stderr
    assert "mocapella record --stop" in refused.stderr
    row = result(tmp_path, "record", "--stop", "--connect", address)
    assert (row["path"], row["problem"]) == ("takes/walk.mcap", "")
    assert read_take(tmp_path / "takes" / "walk.mcap").clean
    nothing = run(tmp_path, "record", "--stop", "--connect", address)
    assert nothing.returncode == 1
    assert "not recording" in nothing.stderr
    assert program.end() == 0
    assert "sensors: 0, frames in: 0" in program.output
    assert json.loads((tmp_path / "server.json").read_text())["recording"]["path"] == "takes/walk.mcap"


@pytest.mark.slow
def test_a_client_whose_take_somebody_else_ends_says_so_and_has_its_result(
    server: tuple[Program, str], tmp_path: Path
) -> None:
    _, address = server
    with Program(tmp_path, "record", "record", "walk.mcap", "--connect", address, "--json", "row.json") as client:
        wait_until("it records", client.said("recording "))
        assert run(tmp_path, "record", "--stop", "--connect", address).returncode == 0
        assert client.process.wait(60.0) == 0, client.output
    assert "ended by another program" in client.output
    assert json.loads((tmp_path / "row.json").read_text())["path"] == "takes/walk.mcap"


@pytest.mark.parametrize("words", [[], ["walk", "--stop"], ["--stop", "--seconds", "3"]], ids=" ".join)
def test_words_that_say_nothing_or_two_things_are_refused(words: list[str], tmp_path: Path) -> None:
    refused = run(tmp_path, "record", *words)
    assert refused.returncode == 1
    assert "mocapella record walk-1" in refused.stderr
