"""The body of rays on recordings of cameras, against other people's results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocapella.geometry.plucker import camera_rays
from mocapella.geometry.rigid import inverse
from mocapella.kinematics.ray_body import RayBody
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.topology import topology
from mocapella.recording.image_tracks_file import read_openpose
from mocapella.recording.trc_file import read_trc

HALPE = topology("halpe_26")
SD_PX = 6.0


@pytest.mark.slow
def test_one_person_before_four_cameras_is_where_the_authors_of_pose2sim_found_them(camera_recordings: Path) -> None:
    folder = camera_recordings / "pose2sim_single_person"
    rig = load_camera_rig(folder / "calibration" / "Calib_qualisys.toml")
    tracks = read_openpose(sorted((folder / "pose").glob("*_json")))
    places = [rig.cameras[name] for name in sorted(rig.cameras)]
    # BODY_25B's neck is not Halpe's.
    own = [k for k, name in enumerate(tracks.points) if name in HALPE.joints and name != "Neck"]
    seen = np.array([HALPE.index(tracks.points[k]) for k in own])
    rays = np.stack(
        [camera_rays(tracks.pixels[:, c], p.camera.lens, p.T_camera_world) for c, p in enumerate(places)], 1
    )
    centres = np.stack([inverse(place.T_camera_world)[:3, 3] for place in places])
    focal = np.array([place.camera.lens[0] for place in places])
    body, found, supports = RayBody(), [], []
    for k in range(len(tracks.frames)):
        sure = tracks.confidences[k][:, own]
        camera, point = np.nonzero((sure > 0.1) & np.isfinite(rays[k][:, own, 0]))
        directions = rays[k][:, own][camera, point, :3]
        sds = SD_PX / focal[camera] / sure[camera, point]
        estimate = body.update(k / 60, seen[point], centres[camera], directions, sds)
        found.append(estimate.positions)
        supports.append(estimate.support[seen])
    theirs = read_trc(folder / "pose-3d" / "S00_P00_T01_BalancingTrial_0-100.trc")
    off = []
    for k, name in enumerate(theirs.keypoints):
        if name != "Neck":
            truth = theirs.positions[:, 0, k][:, [2, 0, 1]]
            off.append(np.linalg.norm(np.array(found)[:, HALPE.index(name)] - truth, axis=-1))
    assert np.nanmedian(off) < 0.018
    assert np.nanpercentile(off, 95) < 0.065
    assert np.mean(supports) > 3.5
