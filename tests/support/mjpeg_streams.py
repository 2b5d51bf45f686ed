"""Motion JPEG over HTTP, as network cameras send it."""

from __future__ import annotations

import http.server
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from support.programs import free_port


def jpeg(image: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


class Ticks:
    """A clock of equal periods that several threads wait on. A context manager; leaving it ends all waiting."""

    def __init__(self, period_s: float, on_tick: Callable[[], None]) -> None:
        self._period_s, self._on_tick = period_s, on_tick
        self._number, self._ended = 0, False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="ticks")

    def after(self, number: int) -> int | None:
        """Wait for a tick later than ``number``; return its number, or None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._number > number)
            return None if self._ended else self._number

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._ended:
            self._on_tick()
            with self._changed:
                self._number += 1
                self._changed.notify_all()
            due_s = max(due_s + self._period_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))

    def __enter__(self) -> Ticks:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()


class MjpegStreams:
    """A server of streams by name, at ``address(name)``, that send at the ticks of one clock. A context manager.

    Args:
        pictures: JPEGs of a stream of that name, from the tick after a request on; the stream ends with them.
        period_s: between two pictures.
        on_tick: called before the streams take their pictures of a tick. What they show changes together if it changes
            only here.

    Attributes:
        served: how often each stream was asked for.
        sent: pictures of each that have been sent.
    """

    def __init__(
        self,
        pictures: Callable[[str], Iterator[bytes]],
        period_s: float = 0.02,
        on_tick: Callable[[], None] = lambda: None,
    ) -> None:
        self.served: dict[str, int] = {}
        self.sent: dict[str, int] = {}
        self._ticks = ticks = Ticks(period_s, on_tick)
        streams = self

        def at_ticks(name: str) -> Iterator[bytes]:
            number, source = ticks.after(0), pictures(name)
            while number is not None and (data := next(source, None)) is not None:
                yield data
                number = ticks.after(number)

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                name = self.path.strip("/").removesuffix(".mjpg")
                streams.served[name] = streams.served.get(name, 0) + 1
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                try:
                    for data in at_ticks(name):
                        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                        self.wfile.write(head.encode() + data + b"\r\n")
                        streams.sent[name] = streams.sent.get(name, 0) + 1
                except OSError:
                    pass  # the client is gone

            def log_message(self, format: str, *arguments: Any) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", free_port()), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever)

    def address(self, name: str) -> str:
        return f"http://127.0.0.1:{self._server.server_port}/{name}.mjpg"

    def __enter__(self) -> MjpegStreams:
        self._ticks.__enter__()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._ticks.__exit__()
        self._server.server_close()
