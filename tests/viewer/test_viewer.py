"""The address of the view, and that it costs nothing while nobody looks."""

import socket

import pytest
from support.browser import page_url
from support.walkers import Room, status

from mocapella.errors import AddressInUseError, SettingsError
from mocapella.model.session import CommandReply
from mocapella.viewer import Viewer, view_frame


def obey(verb, arguments):
    return CommandReply(True)


def test_a_port_in_use_is_named_and_no_other_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(AddressInUseError, match=f"port {port} on 127.0.0.1 is in use"):
            Viewer("127.0.0.1", port, command=obey)


def test_a_host_that_is_not_ours_is_refused():
    with pytest.raises(SettingsError, match=r"cannot listen at 203\.0\.113\.7:8080"):
        Viewer("203.0.113.7", 8080, command=obey)


def test_it_listens_on_the_given_interface_only_frees_the_port_and_shares_nothing():
    viewer = Viewer("127.0.0.1", 0, command=obey)
    port = viewer._server.get_port()
    try:
        assert viewer.url == page_url(port)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=2)
        assert viewer._server.request_share_url() is None
    finally:
        viewer.close()
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_while_no_browser_looks_nothing_is_drawn(monkeypatch):
    drawn = []
    monkeypatch.setattr(view_frame, "gallery_drawing", lambda *_: drawn.append(1))
    monkeypatch.setattr(view_frame, "image_lines", lambda *_: drawn.append(1))
    room = Room()
    frames = room.frames(0.0)
    viewer = Viewer("127.0.0.1", 0, command=obey)
    try:
        viewer.show(room.scene(0.0, frames), frames, status())
        viewer.show(None, {}, None)
    finally:
        viewer.close()
    assert drawn == []


def test_nothing_is_printed_because_standard_output_is_for_results(capsys):
    viewer = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    viewer.close()
    assert capsys.readouterr().out == ""


class FailingBrowser:
    """One whose messages cannot be queued."""

    def __init__(self, error):
        self.error, self.shown, self.live = error, 0, True

    def show(self, *_):
        self.shown += 1
        raise self.error


def test_a_race_in_the_library_costs_one_browser_one_drawing_and_any_other_error_is_raised(monkeypatch):
    viewer = Viewer("127.0.0.1", 0, command=obey)
    monkeypatch.setattr(viewer, "_welcome", lambda now_s: None)
    racing = [FailingBrowser(RuntimeError("deque mutated during iteration")) for _ in range(2)]
    try:
        viewer._browsers = dict(enumerate(racing))
        viewer.show(None, {}, None)
        assert [browser.shown for browser in racing] == [1, 1]
        viewer._browsers = {0: FailingBrowser(RuntimeError("something else"))}
        with pytest.raises(RuntimeError, match="something else"):
            viewer.show(None, {}, None)
    finally:
        viewer.close()
