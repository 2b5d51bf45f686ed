"""Run Pose2Sim's stages on a folder, and print their times; a program of its own, in an environment of its own.

`uv run --no-project --isolated --with pose2sim python benchmarks/_pose2sim.py FOLDER HZ`: FOLDER has ``calibration``
and ``pose``. The figures of its filter are switched off; all other settings are its own defaults for several people.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path

STAGES = ("personAssociation", "triangulation", "filtering")


def config(folder: Path, hz: float) -> dict[str, object]:
    """Settings that differ from the defaults of its single-person demonstration."""
    return {
        "project": {"project_dir": str(folder), "multi_person": True, "frame_rate": hz, "frame_range": "all"},
        "pose": {"pose_model": "BODY_25"},
        "triangulation": {"make_c3d": False, "show_interp_indices": False},
        "filtering": {"display_figures": False, "save_filt_plots": False, "make_c3d": False, "type": "butterworth"},
        "logging": {"use_custom_logging": True},
    }


def main() -> int:
    folder, hz = Path(sys.argv[1]).resolve(), float(sys.argv[2])
    os.environ.setdefault("MPLBACKEND", "Agg")
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    logging.disable(logging.CRITICAL)
    from Pose2Sim import Pose2Sim  # type: ignore[import-not-found]

    os.chdir(folder)
    out = sys.stdout
    sys.stdout = sys.stderr
    seconds = {}
    for stage in STAGES:
        begin = time.process_time()
        getattr(Pose2Sim, stage)(config(folder, hz))
        seconds[stage] = time.process_time() - begin
    begin = time.process_time()
    for path in (folder / "pose").glob("*/*.json"):
        json.loads(path.read_text(encoding="utf-8"))
    seconds["reading"] = time.process_time() - begin
    tracks = len(list((folder / "pose-3d").glob("*.trc")))
    print(json.dumps({"version": version("pose2sim"), "seconds": seconds, "tracks": tracks}), file=out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
