"""Arrays of trajectories: an xarray data set in the layout of ``movement``, its netCDF file, and NumPy's NPZ."""

from __future__ import annotations

import datetime
import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.exports.needs import needed
from mocapella.exports.run_labels import labels_by_run
from mocapella.model.observations import JointState
from mocapella.model.trajectories import LABELS, Trajectories
from mocapella.settings import check

MOST_NETCDF_BYTES: Final = 1 << 31


def as_dataset(trajectories: Trajectories, source: str = "") -> Any:
    """Return an xarray data set in the layout of ``movement`` (https://movement.neuroinformatics.dev).

    Dimensions: time, space, keypoints, individuals. Variables: ``position`` [m], ``confidence`` (1 measured, 0.5
    inferred, 0 unknown), ``sd`` [m], ``state`` (`JointState`), and ``angle`` [rad] with the dimension ``angles`` if
    there are angles. The coordinate ``run`` has the number of the tracker's run of each time, and the attribute
    ``labels`` has participant, placement and scenario of each run, as JSON by the run's number.

    Args:
        trajectories: the trajectories.
        source: file that they are from, for the attribute ``source_file``.

    Raises:
        SettingsError: xarray is not installed; names the extra.
    """
    xarray = needed("xarray")
    own = ("time", "keypoints", "individuals")
    states = np.moveaxis(trajectories.states, 1, 2)
    variables: dict[str, Any] = {
        "position": (("time", "space", "keypoints", "individuals"), np.transpose(trajectories.positions, (0, 3, 2, 1))),
        "confidence": (own, states / float(JointState.TRACKED)),
        "sd": (own, np.moveaxis(trajectories.sd, 1, 2).astype(np.float64)),
        "state": (own, states.astype(np.int8)),
    }
    coords: dict[str, Any] = {
        "time": trajectories.times_s,
        "space": ["x", "y", "z"],
        "keypoints": list(trajectories.keypoints),
        "individuals": list(trajectories.individuals),
        "run": ("time", trajectories.runs.astype(np.int32)),
    }
    if trajectories.angle_names:
        variables["angle"] = (("time", "angles", "individuals"), np.moveaxis(trajectories.angles, 1, 2))
        coords["angles"] = list(trajectories.angle_names)
    attributes = {
        "source_software": "mocapella", "source_file": source, "ds_type": "poses", "time_unit": "seconds",
        "space_unit": "m", "kind": trajectories.kind, "began": began(trajectories),
        "labels": json.dumps(labels_by_run(trajectories)),
    }  # fmt: skip
    steps = np.diff(trajectories.times_s)
    if math.isfinite(trajectories.rate_hz) and np.ptp(steps) < 1e-6:  # movement takes it for that of all frames
        attributes["fps"] = trajectories.rate_hz  # type: ignore[assignment]
    return xarray.Dataset(variables, coords, attributes)


def began(trajectories: Trajectories) -> str:
    """Return the wall clock of time 0 as ISO 8601 in UTC, to the microsecond; empty if unknown."""
    if not trajectories.began_unix_ns:
        return ""
    at = datetime.datetime.fromtimestamp(trajectories.began_unix_ns // NS_PER_S, datetime.UTC)
    return at.replace(microsecond=trajectories.began_unix_ns % NS_PER_S // 1000).isoformat()


def write_netcdf(trajectories: Trajectories, path: Path) -> None:
    """Write the data set of `as_dataset` as netCDF, which ``movement`` and xarray open.

    Raises:
        SettingsError: xarray is not installed, names the extra; or a variable is too large for the format.
        OSError: the file cannot be written.
    """
    check(
        trajectories.positions.nbytes < MOST_NETCDF_BYTES, "size of the positions", trajectories.positions.nbytes,
        "below 2 GiB in a netCDF; choose fewer individuals, a lower rate, or npz",
    )  # fmt: skip
    as_dataset(trajectories).to_netcdf(path, engine="scipy")


def write_npz(trajectories: Trajectories, path: Path) -> None:
    """Write the arrays as NPZ, which `numpy.load` opens.

    Keys are attributes of `Trajectories`: kind, times_s, runs, individuals, keypoints, positions, states, sd, bones,
    rate_hz and began_unix_ns; angle_names and angles, and poses, for kinds that have them; and the texts (frames,)
    participant, placement and scenario, empty where not given.

    Raises:
        OSError: the file cannot be written.
    """
    own = trajectories
    more: dict[str, Any] = {"angle_names": own.angle_names, "angles": own.angles} if own.angle_names else {}
    if own.poses is not None:
        more["poses"] = own.poses
    known, of_frame = np.unique(own.runs, return_inverse=True)
    by_run = labels_by_run(own)
    for label in LABELS:
        more[label] = np.array([by_run[run][label] for run in known.tolist()], dtype=np.str_)[of_frame]
    with path.open("wb") as file:
        np.savez_compressed(
            file, kind=own.kind, times_s=own.times_s, runs=own.runs, individuals=np.array(own.individuals),
            keypoints=np.array(own.keypoints), positions=own.positions, states=own.states, sd=own.sd,
            bones=np.array(own.bones, dtype=np.int64).reshape(-1, 2), rate_hz=own.rate_hz,
            began_unix_ns=own.began_unix_ns, **more,
        )  # fmt: skip
