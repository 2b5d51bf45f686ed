"""Output of `mocapella track silhouettes`: the result file, written frame by frame, the table, and the plot."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mocapella.cli.common import say
from mocapella.cli.silhouette_keys import REJECTIONS
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.recording.bodies_file import FollowedBody
    from mocapella.recording.bodies_writer import BodiesWriter
    from mocapella.sources.frame_set import FrameSource
    from mocapella.tracker.silhouette_start import Body


class AnglesAt(NamedTuple):
    """Joint angles of a body at one time.

    Attributes:
        time_s: capture time since the start of the run [s].
        angles: joint angles by joint name [rad].
    """

    time_s: float
    angles: Mapping[str, float]


class SilhouetteResult:
    """Context manager that writes the results for ``--json`` and ``--plot``; after an error it names the partial file.

    Each frame is written when it is added, to a part file beside the result or a temporary file.

    Args:
        json, plot: values of the options; if both are None, nothing is written.
        bodies: the tracked bodies by person's name.
        shown: source of the images, described in the result.
        rig: path of the rig's file, named in the result.
        fit: settings of the fit, as of `fit_settings`; the result states them.

    Raises:
        RecordingError: the file cannot be created.
    """

    def __init__(
        self, json: str | None, plot: Path | None, bodies: Mapping[str, Body], shown: FrameSource, rig: Path,
        fit: Mapping[str, Any],
    ) -> None:  # fmt: skip
        from mocapella.recording.bodies_file import FollowedBody
        from mocapella.recording.bodies_writer import BodiesWriter, left_behind

        self._json, self._plot = json, plot
        self._angles: dict[str, list[AnglesAt]] = {}
        self._kept: BodiesWriter | None = None
        if json is None and plot is None:
            return
        path = None if json in (None, "-") else Path(str(json)).resolve()
        if path is not None and path.exists() and not path.is_file():  # such as /dev/null
            path = None
        for part in left_behind(path) if path is not None else ():
            say(f"{part} is there, of a run that still goes on or was killed: it is read as any result is, and stays")
        heads = {
            name: FollowedBody(body.model, [], body.height_m, body.proportions.known) for name, body in bodies.items()
        }
        how = {
            "rig": str(rig), "cameras": shown.described(), "rate_hz": shown.rate_hz,
            "steadiness": "steadiness" not in fit, "rejection": fit.get("rejection", REJECTIONS[0]),
        }  # fmt: skip
        self._kept = BodiesWriter(path, heads, how)

    def keep(self, step: Step) -> None:
        """Add the next frame.

        Raises:
            RecordingError: it cannot be written; an earlier file stays unchanged.
        """
        if self._kept is not None:
            self._kept.add({name: one.row for name, one in step.people.items()})

    def finish(self, run: SilhouetteRun, shown: FrameSource) -> None:
        """Write the result after the last frame; the plot is written by `draw`.

        Args:
            run: gives the counts of the run and the statistics of each body.
            shown: source of the images, which gives its counts, such as dropped images.

        Raises:
            SettingsError, RecordingError: it cannot be written.
        """
        kept = self._kept
        if kept is None:
            return
        if self._plot is not None:
            self._angles = _angles(kept)
        kept.finish({**run.summary(), **shown.summary()}, {name: run.summary_of(name) for name in run.meshes})
        if self._json == "-":
            kept.copy_to(sys.stdout)
        elif self._json is not None and kept.path is None:
            try:
                with Path(self._json).open("w", encoding="utf-8") as out:
                    kept.copy_to(out)
            except OSError as error:
                raise SettingsError(f"--json {self._json}: {error.strerror}; name another file") from error

    def draw(self, earlier: Mapping[str, FollowedBody] | None, beside: str) -> None:
        """Write the plot if requested, with an earlier run for comparison; call it after `finish`.

        Args:
            earlier: bodies of the earlier run by person's name; None for none.
            beside: label of the earlier run.

        Raises:
            SettingsError: it cannot be written there.
        """
        if self._plot is not None:
            draw_angles(self._angles, earlier, self._plot, beside)

    def __enter__(self) -> SilhouetteResult:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._kept is not None:
            self._kept.close()
            if self._kept.part is not None:
                say(f"the {self._kept.frames} frames until then are in {self._kept.part}")


def _angles(kept: BodiesWriter) -> dict[str, list[AnglesAt]]:
    """Return each person's joint angles over time, by name."""
    import msgspec

    class Row(msgspec.Struct):
        time_s: float
        angles: dict[str, float]

    found: dict[str, list[AnglesAt]] = {name: [] for name in kept.bodies}
    for rows in kept.rows(Row):
        for name, row in rows.items():
            found[name].append(AnglesAt(row.time_s, row.angles))
    return found


def show(run: SilhouetteRun, out: Console, summary: Mapping[str, Any] = MappingProxyType({})) -> None:
    """Print a table of the run, with the counts of the images' source."""
    named = [name for name in run.statistics if name]
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in (*(["person"] if named else []), "camera", "frames", "overlap", "least", "shown", "left out"):
        table.add_column(words, justify="left" if words in ("person", "camera") else "right")
    for person, body in run.statistics.items():
        for k, name in enumerate(run.rig.cameras):
            overlaps = body.overlaps.get(name)
            median, least = (f"{overlaps.median:.1%}", f"{overlaps.least:.1%}") if overlaps else ("–", "–")
            shares = body.shown.get(name)
            shown = f"{shares.median:.1%}" if shares else "–"
            whose = [Text(person if k == 0 else "")] if named else []
            counted = str(len(overlaps)) if overlaps else "0"
            table.add_row(*whose, name, counted, median, least, shown, str(body.left_out[name]))
    out.print(table)
    if run.frames:
        lost = {name: body.lost for name, body in run.statistics.items()}
        gone = ", ".join(f"{count} of them without {name or 'anybody'}" for name, count in lost.items() if count)
        took = f"{run.took_ms.median:.0f} ms a frame"
        dropped = ", ".join(f"{name} {count}" for name, count in summary.get("dropped", {}).items())
        told = f"; pictures dropped: {dropped}" if dropped else ""
        out.print(f"{run.frames} frames{f', {gone}' if gone else ''}; {took}{told}", markup=False)


def draw_angles(
    people: Mapping[str, Sequence[AnglesAt]], earlier: Mapping[str, FollowedBody] | None, path: Path, beside: str
) -> None:
    """Plot each joint's angle [°] over time [s]: one colour for each person, an earlier run dashed.

    For a single person, this run is blue, and the earlier one orange. Without joints or frames, a note is printed and
    nothing is written.

    Args:
        people: angles over time by person's name.
        earlier: bodies of an earlier run by person's name; None for none.
        path: file of the plot, .png or .svg.
        beside: label of the earlier run.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    import numpy as np

    from mocapella.evaluation.plots import new_figure, save_figure

    runs: list[tuple[str, str, str, Sequence[AnglesAt]]] = []
    for k, (name, points) in enumerate(people.items()):
        before = (earlier or {}).get(name)
        if before is not None:
            theirs = [AnglesAt(row.time_s, row.angles) for row in before.frames]
            colour, line = (f"C{k}", "--") if name else ("tab:orange", "-")
            runs.append((colour, line, f"{name}, {beside}" if name else beside, theirs))
        runs.append((f"C{k}" if name else "tab:blue", "-", name or "this run", points))
    missing = [name for name in earlier or {} if name not in people]
    if missing:
        say(f"beside {beside}: not drawn, for it is of {', '.join(missing) or 'a body without a name'}")
    names = list(dict.fromkeys(key for *_, points in runs for _, angles in points[:1] for key in angles))
    if not names:
        say(f"--plot {path}: no plot, because the model has no joints, or there is no frame")
        return
    columns = 4
    rows = -(-len(names) // columns)
    figure = new_figure(path, 3.2 * columns, 1.9 * rows)
    handles: dict[str, Any] = {}
    for axes, name in zip(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel(), names, strict=False):
        for colour, line, label, points in runs:
            there = [(at, np.degrees(angles[name])) for at, angles in points if name in angles]
            if there:
                (handles[label],) = axes.plot(
                    *zip(*there, strict=True), color=colour, linestyle=line, label=label, linewidth=1
                )
        axes.set_title(f"{name} [°]", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.supxlabel("time [s]", fontsize=8)
    if len(handles) > 1:
        figure.legend(list(handles.values()), list(handles), loc="outside upper right", fontsize=8, ncols=len(handles))
    save_figure(figure, path)
    say(f"plot in {path}")
