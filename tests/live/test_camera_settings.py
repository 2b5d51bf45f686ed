"""A node, its camera's controls over real sockets, and the next node, which has them again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.programs import Program, free_port, wait_until

from mocapella.errors import BusError
from mocapella.sensing.colour_profile import load_profile
from mocapella.wire.questions import AskControls, AskPicture, AskSaveControls, AskSet, ask_node
from mocapella.wire.session import open_reader, open_server


@pytest.mark.slow
def test_settings_made_over_the_bus_are_saved_and_set_at_the_next_start(tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    words = ("node", "markers", "rendered:demo/left", "--profile", "left.json", "--epoch", "0", "--connect", address)
    server = open_server(address)  # it accepts no node, but carries questions; with --epoch the node does not wait
    reader = open_reader(address)

    def answers() -> bool:
        try:
            return ask_node(reader, "left", AskPicture(scale=0.1), timeout=2.0).ok
        except BusError:
            return False

    try:
        with Program(tmp_path, "first", *words) as node:
            wait_until("it looks", node.said("pictures of"), timeout=120.0)
            wait_until("it answers", answers, timeout=60.0)
            assert not ask_node(reader, "left", AskSet({"exposure": 1e6})).ok
            assert ask_node(reader, "left", AskSet({"exposure": 90.0, "white_balance_red": 1.1})).ok
            answer = ask_node(reader, "left", AskSaveControls())
            assert answer.message == "camera settings saved to left.json"
            assert node.end() == 0, node.output
        file = tmp_path / "left.json"
        assert load_profile(file).controls.exposure == 90.0
        profile = json.loads(file.read_text())
        profile["controls"]["white_balance"] = 4600  # of another camera: this one has none
        file.write_text(json.dumps(profile))
        with Program(tmp_path, "second", *words) as node:
            wait_until(
                "it looks", node.said("white balance cannot be set to 4600: there is no such control"), timeout=60.0
            )
            wait_until("it answers", answers, timeout=60.0)
            controls = ask_node(reader, "left", AskControls()).controls
            assert controls is not None
            assert (controls["exposure"], controls["white_balance_red"]) == (90.0, 1.1)
            assert node.end() == 0, node.output
    finally:
        reader.close()
        server.close()
