"""Labels of a take's runs (participant, placement, scenario) as export formats carry them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocapella.conventions import NOT_AVAILABLE
from mocapella.model.trajectories import LABELS, Trajectories


def label_texts(labels: Mapping[str, Any]) -> dict[str, str]:
    """Return a run's `LABELS` as texts; empty where they are not given, as is a participant of −9999."""
    values = {name: labels.get(name, "") for name in LABELS}
    return {name: "" if value == NOT_AVAILABLE else str(value) for name, value in values.items()}


def labels_by_run(trajectories: Trajectories) -> dict[int, dict[str, str]]:
    """Return the labels of each run with a frame, as texts, by the run's number."""
    return {run: label_texts(trajectories.labels.get(run, {})) for run in np.unique(trajectories.runs).tolist()}


def label_changes(trajectories: Trajectories) -> list[tuple[int, dict[str, str]]]:
    """Return (frame, labels) of the first frame, and of each frame whose labels differ from those before it."""
    by_run, found = labels_by_run(trajectories), list[tuple[int, dict[str, str]]]()
    begins = np.flatnonzero(np.diff(trajectories.runs, prepend=-1)).tolist() if len(trajectories) else []
    for frame in begins:
        labels = by_run[int(trajectories.runs[frame])]
        if not found or labels != found[-1][1]:
            found.append((frame, labels))
    return found


def in_words(labels: Mapping[str, str]) -> str:
    """Return labels as a text, such as ``participant 7, scenario walk``; empty without any."""
    return ", ".join(f"{name} {text}" for name, text in labels.items() if text)


def left_out(trajectories: Trajectories) -> list[str]:
    """Return a sentence for a format that cannot carry labels which change during the take; none if they do not."""
    changes = label_changes(trajectories)[1:]
    if not changes:
        return []
    at = ", ".join(
        f"{in_words(labels) or 'no labels'} from {trajectories.times_s[k]:.1f} s" for k, labels in changes[:3]
    )
    more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
    return [f"the labels change during the take ({at}{more}), which this format cannot tell; csv and c3d do"]
