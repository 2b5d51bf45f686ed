"""Find and open recordings: study logs, files of one sensor's bodies, and takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mocapella.errors import InputError, PluginError, SettingsError, one_of
from mocapella.live.recorded import ReplayableRecording
from mocapella.live.recorded_rows import RecordedBodies, RecordedLog
from mocapella.live.recorded_take import RecordedTake
from mocapella.live.track_again import UNCHANGED, Changes
from mocapella.recording.body_csv import is_body_csv
from mocapella.recording.disk import SUFFIX, TAKES
from mocapella.recording.mcap_file import MAGIC

"""Default folder of a server's takes."""
_ENDINGS = (SUFFIX, ".csv", ".csv.gz")
_MOST_NAMED = 10


def find_recording(file: Path) -> Path:
    """Return the file of that name, or the take, which may be given without ``.mcap`` and be in the folder ``takes``.

    Raises:
        InputError: there is none; lists the takes.
    """
    names = [file] if file.name.endswith(_ENDINGS) else [file, file.with_name(file.name + SUFFIX)]
    names += [TAKES / name for name in names] if file.parent == Path() else []
    found = next((name for name in names if name.is_file()), None)
    if found is not None:
        return found
    folders = [file] if file.is_dir() else dict.fromkeys(name.parent for name in names)
    takes = sorted((path for folder in folders for path in folder.glob(f"*{SUFFIX}")), key=str)
    there = _some(file, takes) if takes else "name a study log or a take"
    raise InputError("it is a folder" if file.is_dir() else "no such file", file=file, fix=there)


def _some(file: Path, takes: Sequence[Path]) -> str:
    """Return the first takes as text, and the name that resembles the file's, as a user may write it."""
    names = [take.stem if take.parent == TAKES else str(take.with_suffix("")) for take in takes]
    close = one_of(str(file).removesuffix(SUFFIX), names).rpartition(" (did you mean ")
    listed = ", ".join(map(str, takes[:_MOST_NAMED]))
    return f"there are {listed}" + (f" (did you mean {close[2]}" if close[1] else "")


def is_take(file: Path) -> bool:
    """Return whether the file is a take, from its name or its first bytes."""
    if file.suffix == SUFFIX:
        return True
    try:
        with file.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:  # its reader reports the reason
        return False


def open_recording(file: Path, changes: Changes = UNCHANGED) -> ReplayableRecording:
    """Open a study log, a file of one sensor's bodies or a take, as `find_recording` finds it.

    The method and settings of ``changes`` are how the recording is tracked, and its placement selects that of the
    sensors in a study log. Those that a take does not get are its recorded ones; others are the defaults.

    Raises:
        InputError: the file cannot be used, or has no frames; names file, row, field and value if possible.
        SettingsError: an unknown placement, or one that the file does not have.
    """
    file = find_recording(file)
    if is_take(file):
        take = RecordedTake(file, changes)
        if not take.sensors:
            raise InputError("is a take without frames", file=file, fix="name one that was recorded while sensors sent")
        return take
    if is_body_csv(file):
        if changes.placement:
            raise SettingsError(f"{file} has one sensor; leave --placement out, which is for study logs")
        return RecordedBodies(file, changes)
    try:
        return RecordedLog(file, changes)
    except InputError as error:
        if error.row != 1:
            raise
        fix = f"{error.fix or 'a study log has 87 columns'}; docs/sensors.md has the other tables that are read"
        raise InputError(error.problem, file=file, row=1, field=error.field, value=error.value, fix=fix) from None


def open_to_track(file: Path, changes: Changes = UNCHANGED) -> ReplayableRecording:
    """Open a recording as `open_recording` does, with the same arguments, and check that it can be tracked.

    Raises:
        PluginError: a package that is needed for the tracking is missing; names it.
        InputError, SettingsError: as in `open_recording`.
    """
    recording = open_recording(file, changes)
    if recording.missing:
        raise PluginError(f"{file} cannot be tracked: {'; '.join(recording.missing)}")
    return recording
