"""Export scenes with all their parts as JSON lines: all fields, arrays as lists, NaN as null."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mocapella.errors import SettingsError
from mocapella.exports.run_labels import label_texts
from mocapella.model.scene import Scene, UnknownPart


class SceneLinesReport(msgspec.Struct, frozen=True):
    """Counts of an export of scenes.

    Attributes:
        scenes: number of scenes read, including scenes that ``every`` leaves out.
        written: number of written lines, one for each written scene.
        parts: number of written scene parts by the name of their type.
        unread: number of written parts of types that no installed package reads, by type; only their size is written.
    """

    scenes: int
    written: int
    parts: dict[str, int]
    unread: dict[str, int]


def write_scene_lines(
    scenes: Iterable[tuple[int, int, Scene]],
    path: Path,
    *,
    every: int = 1,
    labels: Mapping[int, Mapping[str, Any]] | None = None,
) -> SceneLinesReport:
    """Write the `scene_line` of each scene to a file of JSON lines. The file appears complete or not at all.

    Args:
        scenes: (run, log_ns, scene) in their order, the arguments of `scene_line`.
        path: the file; an existing one is replaced.
        every: write each n-th scene, from the first; at least 1.
        labels: labels of each run by its number; None for none.

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
                file.write(scene_line(run, log_ns, scene, (labels or {}).get(run)) + b"\n")
                written += 1
                for name, some in scene.parts.items():
                    parts[name] += len(some)
                    unread[name] += sum(isinstance(one, UnknownPart) for one in some)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SettingsError(f"--out {path}: {error.strerror}; name a file in a folder that exists") from error
    return SceneLinesReport(count, written, dict(parts), dict(+unread))


def scene_line(run: int, log_ns: int, scene: Scene, labels: Mapping[str, Any] | None = None) -> bytes:
    """Return a scene as one line of JSON in UTF-8, without the line break.

    The object has the keys run, labels (participant, placement and scenario, empty where not given), log_ns, step,
    at_ns, sensor, node_id, sequence, topology, state, sensors, and parts: lists by type name. Arrays are lists; NaN and
    infinities are null. An `UnknownPart` has only its type and its size in bytes.

    Args:
        run: number of the tracker's run that made the scene; a take may have several.
        log_ns: time at which the server stored the scene, on its monotonic clock.
        scene: the scene.
        labels: labels of the run, as of `label_texts`; None for none.
    """
    row = {
        "run": run,
        "labels": label_texts(labels or {}),
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
