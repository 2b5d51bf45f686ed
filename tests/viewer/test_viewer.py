"""The address of the view, and that it costs nothing while nobody looks."""

import asyncio
import socket
import threading

import pytest
import viser
import zstandard
from support.browser import page_url
from support.programs import wait_until
from support.walkers import Room, status
from websockets.sync.client import connect

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
    """One whose messages cannot be queued, if it has an error."""

    def __init__(self, error=None):
        self.error, self.shown, self.live = error, 0, True

    def show(self, *_):
        self.shown += 1
        if self.error is not None:
            raise self.error


def test_an_error_in_one_browser_is_raised_once_the_others_are_drawn(monkeypatch):
    viewer = Viewer("127.0.0.1", 0, command=obey)
    monkeypatch.setattr(viewer, "_welcome", lambda now_s: None)
    try:
        for text in ("deque mutated during iteration", "something else"):
            browsers = [FailingBrowser(), FailingBrowser(RuntimeError(text)), FailingBrowser(), FailingBrowser()]
            viewer._browsers = dict(enumerate(browsers))
            with pytest.raises(RuntimeError, match=text):
                viewer.show(None, {}, None)
            assert [browser.shown for browser in browsers] == [1, 1, 1, 1]
    finally:
        viewer.close()


def test_only_the_thread_that_serves_the_page_wakes_its_waiters(monkeypatch):
    """And what another thread queues after the page's end is dropped."""
    threads, theirs = set(), asyncio.Event.set
    monkeypatch.setattr(asyncio.Event, "set", lambda event: (threads.add(threading.get_ident()), theirs(event)))
    viewer = Viewer("127.0.0.1", 0, command=obey)
    server = viewer._server._websock_server
    address, protocol = viewer.url.replace("http", "ws"), f"viser-v{viser.__version__}"
    try:
        with connect(address, subprotocols=[protocol], max_size=None, open_timeout=60) as page:
            wait_until("the page is known", lambda: bool(server._client_state_from_id))
            buffers = [server._broadcast_buffer, *(own.message_buffer for own in server._client_state_from_id.values())]
            for buffer in buffers:
                wait_until("all is sent", lambda event=buffer.message_event: bool(event._waiters))
                threads.clear()
                buffer.message_event.set()
                wait_until("it is woken", lambda: bool(threads))
                assert threads == {server._server_thread.ident}
            viewer._server.gui.add_html("the last")
            while b"the last" not in unpacked(page.recv(60)):
                pass
    finally:
        viewer.close()
    assert threads == {server._server_thread.ident}
    for buffer in buffers:
        buffer.message_event.set()
    assert threads == {server._server_thread.ident}


def unpacked(window):
    """Return the MessagePack of a window of viser's messages."""
    return zstandard.ZstdDecompressor().decompress(window[16 : 16 + int.from_bytes(window[8:16], "little")])
