"""Triangulate the points of several cameras: python examples/07_triangulate_points.py points.csv rig.toml [walk.trc]"""

import sys

import numpy as np

import mocapella
from mocapella.errors import MocapellaError


def main(points: str, rig: str, out: str | None) -> None:
    """Print the residuals of each camera and the path of each point, and save the points at 60 Hz."""
    found = mocapella.triangulate(points, rig, fps=60.0)
    print(found)
    for name, camera in found.report.cameras.items():
        print(f"{name}: {camera.seen} detections, {camera.rejected_share:.0%} rejected, {camera.residual_px:.2f} px")
    motion = found.points
    steps = np.linalg.norm(np.diff(motion.positions[:, 0], axis=0), axis=2)
    for name, path_m in zip(motion.keypoints, np.nansum(steps, axis=0), strict=True):
        print(f"{name}: {path_m:.2f} m")
    if out is not None:
        found.save(out)


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    except IndexError:
        sys.exit(__doc__)
    except MocapellaError as error:
        sys.exit(str(error))
