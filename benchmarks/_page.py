"""A page of the view without a browser: it reads all that it is sent, and presses buttons."""

from __future__ import annotations

import threading
from types import TracebackType

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

PATIENCE_S = 30.0
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [0, 0, 1, 0], "position": [0.5, 1.5, -4], "fov": 0.6, "near": 0.01,
    "far": 1000, "image_height": 720, "image_width": 900, "look_at": [0, 1, 0], "up_direction": [0, 1, 0],
}  # fmt: skip


class Page:
    """An open page.

    Args:
        url: address of the view, with a token.

    Attributes:
        ended: whether the view has ended the connection.
    """

    def __init__(self, url: str) -> None:
        self.ended = False
        self._buttons: dict[str, str] = {}
        self._more = threading.Condition()
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        at = url.replace("http", "ws", 1)
        self._link = connect(at, subprotocols=[protocol], max_size=None, open_timeout=PATIENCE_S)
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self._link.send(msgspec.msgpack.encode(CAMERA))

    def button(self, label: str) -> str:
        """Return the identity of a button, once the page has it.

        Raises:
            TimeoutError: it has none, or was cut off.
        """
        with self._more:
            if not self._more.wait_for(lambda: label in self._buttons or self.ended, PATIENCE_S) or self.ended:
                raise TimeoutError(f"the page has no button {label}")
            return self._buttons[label]

    def press(self, button: str) -> None:
        """Press a button, whether it is enabled or not.

        Raises:
            ConnectionClosed: the view has ended the connection.
        """
        self._link.send(
            msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": button, "updates": {"value": True}})
        )

    def __enter__(self) -> Page:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._link.close()
        self._reader.join()

    def _read(self) -> None:
        leaves = False
        try:
            for window in self._link:
                assert isinstance(window, bytes)
                packed = window[16 : 16 + int.from_bytes(window[8:16], "little")]
                content = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
                found = {
                    message["props"]["label"]: message["uuid"]
                    for message in content["messages"]
                    if message["type"] == "GuiButtonMessage"
                }
                if found:
                    with self._more:
                        self._buttons |= found
                        self._more.notify_all()
            leaves = True
        except ConnectionClosed:
            pass
        with self._more:
            self.ended = not leaves
            self._more.notify_all()
