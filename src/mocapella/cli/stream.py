"""The command of ``mocapella stream``, which sends live results to another program."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated

import typer

from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, People, Seconds, individual_names, say, write_json


def stream(
    context: typer.Context,
    to: Annotated[
        str | None,
        typer.Option(
            "--to", metavar="HOST:PORT", help="UDP address of the receiver. By default the protocol's usual port on "
            "this machine.",
        ),
    ] = None,
    people: People = None,
    connect: Connect = DEFAULT_ADDRESS,
    seconds: Seconds = None,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """It sends each result once, as soon as it comes. UDP does not tell whether a program receives it.

    docs/streams.md describes the messages and has a receiver of ten lines.

    Example:  mocapella stream osc --to 127.0.0.1:9000 --people person_0
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.live.streaming import run_stream
    from mocapella.registry import load
    from mocapella.sources.osc_sender import OscSender
    from mocapella.streams.stream import STREAMS
    from mocapella.wire.reader import Newest
    from mocapella.wire.session import open_reader

    chosen = STREAMS.find(str(context.info_name))
    encoder = load(chosen.make)(individual_names(people))
    target = to or f"127.0.0.1:{chosen.port}"
    with OscSender(target) as sender:
        session = open_reader(connect)
        try:
            newest, began_s = Newest(session), time.monotonic()
            say(f"sending {', '.join(chosen.parts)} to {target} (Ctrl-C ends)")
            with stop_on_signals() as stop:
                summary = run_stream(
                    newest.scene, encoder, sender.send_datagram, stop, seconds=seconds,
                    silent_s=lambda: time.monotonic() - max(began_s, newest.heard_s),
                )  # fmt: skip
        finally:
            session.close()  # type: ignore[no-untyped-call]
    say(
        f"{summary.scenes} results in {summary.datagrams} datagrams to {target}; {newest.skipped} left out for newer "
        f"ones, {newest.refused} unreadable, most people: {summary.most_people}"
    )
    write_json(json, {**asdict(summary), "to": target, "left_out": newest.skipped, "unreadable": newest.refused})
