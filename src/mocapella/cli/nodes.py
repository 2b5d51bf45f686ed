"""Functions for the commands of ``mocapella node``, also for plug-ins: common settings, and serving frames on time.

The *epoch* of a source is the Unix time of its time 0; nodes with the same epoch are synchronous.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mocapella.cli.command_settings import KeySpec
from mocapella.cli.common import record_file, say, write_json
from mocapella.model.names import plural

if TYPE_CHECKING:
    from mocapella.live.camera_node import CameraNodeSummary
    from mocapella.live.due_frame import DueFrame
    from mocapella.live.node_disk import NodeDisk
    from mocapella.wire.node import OnQuestion

REPORT: Final = KeySpec("Interval between status lines; 0: problems only.", "s", least=0)
LOOP: Final = KeySpec("Restart a recording when it ends.")
LINGER: Final = KeySpec("Stay this long after the last frame, so that a take gets frames it missed.", "s", least=0)
DROP_AFTER_MS: Final = KeySpec("Drop results older than this after their image was captured.", "ms", least=1)
DELAY_MS: Final = KeySpec("Time from an image's exposure to its arrival, of network cameras.", "ms", least=0)
READY: Final = "ready"
"""Line that a node prints when it is ready and waits for its epoch on standard input."""
NODE_TAKE: Final = "NAME"


@dataclass(frozen=True)
class NodeKeys:
    """Settings of every node, for ``--set``: the files that it writes to its own disk."""

    spool: Annotated[
        Path, KeySpec("Folder of frames that the server has not stored: merge them with `take merge`.", "folder")
    ] = Path("spool")
    record: Annotated[str | None, KeySpec("Record this sensor's frames on this machine, too.", NODE_TAKE)] = None
    reserve_gib: Annotated[float, KeySpec("Free disk space that spool and take leave.", "GiB", least=0)] = 1.0

    farewell: Annotated[
        float, KeySpec("Longest wait at the end for the server to store further frames of a take.", "s", least=0)
    ] = 10.0

    def disk(self) -> NodeDisk:
        """Return the settings as a `NodeDisk`; create the folder of a take if one is to be recorded.

        Raises:
            RecordingError: the take's name is invalid, or its folder cannot be created.
        """
        from mocapella.live.node_disk import NodeDisk
        from mocapella.recording.disk import GIB

        take = None if self.record is None else record_file(self.record)
        return NodeDisk(self.spool, take, round(self.reserve_gib * GIB), self.farewell)


Epoch = Annotated[
    float | None,
    typer.Option(
        "--epoch", metavar="TIME", help="Unix time of the source's time 0 [s]; nodes with one epoch are synchronous."
    ),
]
EpochFromInput = Annotated[
    bool, typer.Option("--epoch-from-input", hidden=True, help="Say `ready`, and read the epoch from standard input.")
]
NAME_HELP: Final = "Name of the sensor."
SENSOR_HELP: Final = (
    "Sensor of the scene or recording: its name, in a scene also its number from 1; any name for a file of one sensor."
)
SensorName = Annotated[str | None, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)]
Listen = Annotated[
    str, typer.Option("--listen", metavar="HOST:PORT", help="Address to listen on; 127.0.0.1 is this machine only.")
]


def read_epoch() -> float:
    """Print `READY` on standard output, and read the epoch, a Unix time [s], from standard input.

    If standard input ends first, exit with status 1.
    """
    typer.echo(READY)
    line = sys.stdin.readline()
    if not line:  # the parent process has ended
        raise typer.Exit(1)
    return float(line)


def _unreceived(frames: int) -> str:
    return f"nobody received its {plural(frames, 'frame', 'frames')}" if frames else "the sensor has sent no frame"


def tell_camera_end(summary: CameraNodeSummary, words: str, json: str | None) -> None:
    """Report the counts and problems of a camera's node at its end.

    Args:
        summary: the counts.
        words: main counts of the node's work as one line.
        json: file for the summary, or ``-`` for standard output; None writes none.
    """
    say(f"{summary.sensor}: {summary.published} frames published; {words}")
    for problem in summary.report["problems"]:
        say(f"{summary.sensor}: {problem}")
    write_json(json, asdict(summary))


def serve_frames(
    frames: Callable[[], Iterable[DueFrame]],
    sensor: str,
    connect: str,
    epoch: float | None,
    json: str | None,
    *,
    wait: bool,
    linger_s: float = 0.0,
    history_frames: int | None = None,
    disk: NodeDisk | None = None,
    on_question: OnQuestion | None = None,
) -> None:
    """Serve a sensor's frames, each at its due time, until they end or Ctrl-C; report the result at the end.

    Args:
        frames: function that returns the frames in the order of their due times; called when the run begins.
        sensor: name of the sensor.
        connect: address of the server, such as ``tls/127.0.0.1:7447``.
        epoch: Unix time of the frames' time 0 [s]; None for the beginning of the run.
        json: file for the summary, or ``-`` for standard output; None writes none.
        wait: whether the run begins only once a server is running.
        linger_s: time to keep running after the last frame, so that a take can fetch missed frames [s].
        history_frames: number of frames that are kept in memory for a server that missed them; None for the default.
        disk: files that the node writes to its own disk; None for a spool only.
        on_question: answers queries to the node, as in `mocapella.wire.node.NodeLink.answer`; None answers none.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: no server was found during the whole run.
        UnstoredFramesError: frames of an open take are not stored.
        RecordingError: the node's own take cannot be begun, or its recording stopped.
    """
    from mocapella.live.node import run_node
    from mocapella.live.node_disk import open_link
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.frame_types import HISTORY_FRAMES

    kept = HISTORY_FRAMES if history_frames is None else history_frames
    with stop_on_signals() as stop, open_link(connect, sensor, disk, history_frames=kept, say=say) as link:
        if on_question is not None:
            link.answer(on_question)
        summary = run_node(link, frames, epoch=epoch, stop=stop, wait=wait, say=say, linger_s=linger_s)
        if summary.served:
            say(f"{sensor}: {summary.published} frames published, {summary.late} of them late")
        else:
            say(f"{sensor}: no server was at {link.address}; {_unreceived(summary.published)}")
        write_json(json, asdict(summary))
