"""Test vectors of datagrams of markers: ``python tests/vectors/datagrams/generate.py`` writes them; see README.md."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from mocapella.schema.marker_datagrams import DatagramError, decode_marker_datagram

FOLDER = Path(__file__).resolve().parent
MARKERS = ("red", "yellow", "green", "blue", "magenta", "cyan")
SIZE_PX = (640, 480)
SEEN = b"12,34;100.5,200.25;639,479;0.5,0;320,240;-0.5,479.5"
DATAGRAMS: dict[str, bytes] = {
    "all_seen": SEEN,
    "ended_by_semicolon_and_newline": SEEN + b";\r\n",
    "ended_by_zero_bytes": SEEN + b"\0\0\0",
    "numbered": b"#17;" + SEEN + b"\n",
    "numbered_and_timed": b"#18,1234567890;" + SEEN + b"\n",
    "of_a_later_version": b"#19,1234567891,new;" + SEEN + b"\n",
    "some_lost": b"12,34;;,;-1,-1;nan,NaN;0,0",
    "all_lost": b";;;;;",
    "last_lost_and_ended": b"12,34;12,34;12,34;12,34;12,34;;",
    "exponents_and_spaces": b"1.2e1, 34; +100.5,2002.5E-1 ;639.,479;.5,0;320,240;0,0",
    "refused_empty": b"",
    "refused_too_long": SEEN + b";" * 1500,
    "refused_binary": bytes(range(256)),
    "refused_osc": b"/hand/red\0\0\0,ff\0\x41\x40\0\0\x42\x08\0\0",
    "refused_http": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "refused_json": b'{"red": [12, 34], "yellow": [100.5, 200.25]}',
    "refused_five_pairs": b"12,34;100.5,200.25;639,479;0.5,0;320,240",
    "refused_eight_pairs": SEEN + b";1,1;2,2",
    "refused_one_coordinate": b"12;;;;;",
    "refused_half_lost": b"12,;;;;;",
    "refused_decimal_comma": b"12,5,34,5;;;;;",
    "refused_hexadecimal": b"0x12,34;;;;;",
    "refused_infinite": b"inf,34;;;;;",
    "refused_beyond_floats": b"1e999,34;;;;;",
    "refused_enormous": b"1e308,34;;;;;",
    "refused_right_of_the_picture": b"639.6,34;;;;;",
    "refused_above_the_picture": b"12,-1;;;;;",
    "refused_negative_sequence": b"#-1;" + SEEN,
    "refused_time_in_words": b"#1,noon;" + SEEN,
}


def expected(data: bytes) -> dict[str, Any]:
    """What is read of it, or why it is not."""
    try:
        read = decode_marker_datagram(data, MARKERS, SIZE_PX)
    except DatagramError as error:
        return {"refused": str(error.problem)}
    positions = [None if math.isnan(x) else [x, y] for x, y in read.positions_px.tolist()]
    return {
        "markers": dict(zip(MARKERS, positions, strict=True)),
        "sequence": read.sequence,
        "time_us": read.time_us,
    }


def main() -> None:
    rows = {name: {"hex": data.hex(), **expected(data)} for name, data in DATAGRAMS.items()}
    for name, data in DATAGRAMS.items():
        (FOLDER / f"{name}.datagram").write_bytes(data)
    said = {"size_px": SIZE_PX, "order": MARKERS, "datagrams": rows}
    (FOLDER / "expected.json").write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
