"""``mocapella status``: the health of a running server, once."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from mocapella.cli.app import LIVE, app
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, show, write_json
from mocapella.errors import BusError
from mocapella.model.names import plural
from mocapella.model.part_types import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mocapella.model.session import SensorHealth, SessionStatus


@app.command(rich_help_panel=LIVE)
def status(connect: Connect = DEFAULT_ADDRESS, json: JsonOut = None) -> None:
    """Show the health of a running server: sensors, drops, latency, clocks, disk, recording, errors.

    Example:  mocapella status --json -
    """
    from mocapella.wire.reader import send_command
    from mocapella.wire.session import open_reader

    session = open_reader(connect)
    try:
        now = send_command(session, "status").status
    finally:
        session.close()  # type: ignore[no-untyped-call]
    if now is None:
        raise BusError(f"the server at {connect} gave no status; is it of another version?")
    if json != "-":
        for line in lines(now):
            show(line)
    write_json(json, asdict(now))


def lines(now: SessionStatus) -> Iterator[str]:
    """Yield the status as text, problems last."""
    counts = ", ".join(counted(count, name) for name, count in now.counts.items())
    yield f"{now.phase}{f': {now.reason}' if now.reason else ''}"
    yield f"{now.scenes_hz:g} results/s{f', {counts}' if counts else ''}; up for {now.uptime:.0f} s, {now.version}"
    for sensor in now.sensors:
        yield sensor_line(sensor)
    if not now.sensors:
        yield "no sensor yet"
    for one in now.people_conditions:
        yield one.text
    health, take = now.health, now.recording
    if health.latency_ms:
        yield "latency: " + ", ".join(f"{name} {value:.1f} ms" for name, value in health.latency_ms.items())
    state = "recording" if take.active else "last take"
    frames = plural(take.frames, "frame", "frames")
    yield (
        f"{state}: {take.path}, {frames}, {take.lost} lost{f'; {take.problem}' if take.problem else ''}"
        if take.path
        else "not recording"
    )
    if health.disk_free_bytes is not None:
        yield f"disk: {health.disk_free_bytes / 1e9:.1f} GB left"
    if health.descriptors is not None:
        yield f"file descriptors: {health.descriptors.used} of {health.descriptors.limit}"
    if health.log:
        yield f"log: {health.log}"
    for reason, count in health.errors.items():
        yield f"ERROR: {count} × {reason}"
    for problem in health.problems():
        yield f"PROBLEM: {problem}"


def sensor_line(sensor: SensorHealth) -> str:
    """Return the health of a sensor in one line."""
    parts = [f"{sensor.rate_hz:g} Hz", plural(sensor.frames, "frame", "frames"), f"{sensor.dropped} dropped"]
    if sensor.behind:
        parts[-1] += f" ({sensor.behind} because tracking was too slow)"
    parts.append(f"{sensor.rejected} rejected")
    if sensor.latency is not None:
        parts.append(f"latency {1e3 * sensor.latency:.1f} ms")
    if sensor.clock_offset is not None and sensor.clock_bound is not None:
        parts.append(f"clock {1e3 * sensor.clock_offset:+.2f} ± {1e3 * sensor.clock_bound:.2f} ms")
        if sensor.clock_poor:
            parts[-1] += " (poorly synchronised)"
    if sensor.clock_drift_ppm is not None and sensor.clock_drift_bound_ppm is not None:
        parts.append(f"drift {sensor.clock_drift_ppm:+.1f} ± {sensor.clock_drift_bound_ppm:.1f} ppm")
    if sensor.calibration:
        parts.append(sensor.calibration)
    return f"{sensor.name}: {sensor.problem or 'good'}; " + ", ".join(parts)
