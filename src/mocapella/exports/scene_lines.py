"""Export scenes with any parts as lines of JSON: all fields, arrays as lists, NaN as null."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mocapella.errors import SettingsError
from mocapella.model.scene import Scene, UnknownPart


class SceneLinesReport(msgspec.Struct, frozen=True):
    """Counts of an export.

    Attributes:
        scenes: scenes in the take.
        written: written lines.
        parts: number of written parts of each type.
        unread: number of parts of types that no installed package reads, written as their size only.
    """

    scenes: int
    written: int
    parts: dict[str, int]
    unread: dict[str, int]


def write_scene_lines(scenes: Iterable[tuple[int, int, Scene]], path: Path, *, every: int = 1) -> SceneLinesReport:
    """Write a line of JSON for each scene. The file appears complete.

    Args:
        scenes: (run, log_ns, scene) in their order; ``log_ns`` is of the server's clock.
        path: the file; an existing one is replaced.
        every: write each n-th scene.

    Raises:
        SettingsError: the file cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    count = written = 0
    parts, unread = Counter[str](), Counter[str]()
    try:
        with part.open("wb") as file:
            for run, log_ns, scene in scenes:
                count += 1
                if (count - 1) % every:
                    continue
                file.write(scene_line(run, log_ns, scene) + b"\n")
                written += 1
                for name, some in scene.parts.items():
                    parts[name] += len(some)
                    unread[name] += sum(isinstance(one, UnknownPart) for one in some)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SettingsError(f"--out {path}: {error.strerror}; name a file in a folder that exists") from error
    return SceneLinesReport(count, written, dict(parts), dict(+unread))


def scene_line(run: int, log_ns: int, scene: Scene) -> bytes:
    """Return a scene for JSON; an `UnknownPart` as its name and size."""
    row = {
        "run": run,
        "log_ns": log_ns,
        **{name: getattr(scene, name) for name in ("step", "at_ns", "sensor", "node_id", "sequence")},
        "topology": scene.topology.name,
        "state": scene.state,
        "sensors": scene.sensors,
        "parts": {name: [_named_if_unknown(one) for one in some] for name, some in scene.parts.items()},
    }
    return msgspec.json.encode(row, enc_hook=_plain)  # writes numbers that are not finite as null


def _named_if_unknown(part: Any) -> Any:
    return {"not_installed": part.kind, "bytes": len(part.content)} if isinstance(part, UnknownPart) else part


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
