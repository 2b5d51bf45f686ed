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


class MjpegStreams:
    """A server of streams by name, at ``address(name)``. A context manager.

    Args:
        pictures: JPEGs of a stream of that name, from whenever somebody asks for it; it ends with them.
        period_s: between two pictures.

    Attributes:
        served: how often each stream was asked for.
        sent: pictures of each that have been sent.
    """

    def __init__(self, pictures: Callable[[str], Iterator[bytes]], period_s: float = 0.02) -> None:
        self.served: dict[str, int] = {}
        self.sent: dict[str, int] = {}
        streams = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                name = self.path.strip("/").removesuffix(".mjpg")
                streams.served[name] = streams.served.get(name, 0) + 1
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                try:
                    for data in pictures(name):
                        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                        self.wfile.write(head.encode() + data + b"\r\n")
                        streams.sent[name] = streams.sent.get(name, 0) + 1
                        time.sleep(period_s)
                except OSError:
                    pass  # who watched is gone

            def log_message(self, format: str, *arguments: Any) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", free_port()), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever)

    def address(self, name: str) -> str:
        return f"http://127.0.0.1:{self._server.server_port}/{name}.mjpg"

    def __enter__(self) -> MjpegStreams:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
