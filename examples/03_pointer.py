"""A pointer: a finger or forearm points at a plane, and a grab clicks. python examples/03_pointer.py --help

Sends OSC: /pointer X Y, each 0 to 1 from the top left corner, and /pointer/click 1 or 0. A hand that is uncertain
moves nothing; one that is lost also ends its click.
"""

import argparse
import sys
import time

import numpy as np

from mocapella.errors import MocapellaError
from mocapella.model.arms import ELBOW
from mocapella.settings import check
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings
from mocapella.sources.osc_sender import OscSender
from mocapella.wire.reader import Newest
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader

RAYS = {"index": [5, 8], "forearm": [ELBOW, 0]}  # from the index finger's knuckle to its tip, from elbow to wrist
UNSURE_M = 0.03  # a joint with a larger standard deviation moves nothing
CORNERS = [-0.5, 1.4, 0.4, 0.5, 1.4, 0.4, -0.5, 0.2, 0.4]  # suits the arm of the demo


def hit(origin, direction, corners):
    """Where a ray meets the plane of the corners (top left, top right, bottom left), as (x, y); NaN if nowhere."""
    matrix = np.stack([corners[1] - corners[0], corners[2] - corners[0], -direction], axis=1)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-9:
        return np.full(2, np.nan)
    x, y, along = np.linalg.solve(matrix, origin - corners[0])
    return np.array([x, y]) if along > 0 else np.full(2, np.nan)


def is_sure(arm, points):
    """Whether a camera measures all these points now, and well enough."""
    return bool(arm.cameras) and (arm.states[points] == 2).all() and (arm.sd[points] < UNSURE_M).all()


def main(args, osc):
    """Follow one arm until Ctrl-C."""
    corners, points = np.reshape(args.corners, (3, 3)), RAYS[args.by]
    spread = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    check(1e-4 < spread < 1e4, "--corners", args.corners, "three corners that are not in a line [m]")
    session = open_reader(args.connect)
    newest, smooth, followed, clicked = Newest(session), OneEuro(OneEuroSettings(beta_per_m=1.0)), None, False
    while True:
        time.sleep(0.005)
        if (scene := newest.scene()) is None:
            continue
        arm = next((arm for arm in scene.arms if arm.id == followed), next(iter(scene.arms), None))
        same, followed, before = arm is not None and arm.id == followed, arm and arm.id, clicked
        clicked, word = clicked and same, "no hand" if arm is None else "uncertain"
        if arm is not None and is_sure(arm, points):
            clicked, (a, b) = arm.grabbing, arm.points[points]
            x, y = smooth.update(hit(b, b - a, corners)[None], scene.at_ns * 1e-9)[0].clip(0.0, 1.0)
            word = "points elsewhere"
            if clicked and args.by == "index":
                word = "held"  # a finger that bends to click does not point
            elif np.isfinite(x):
                osc.send("/pointer", x, y)
                word = f"x {x:.3f}  y {y:.3f}"
        if clicked != before:
            osc.send("/pointer/click", float(clicked))
        print(f"\r{word:<20}{'click' if clicked else '':<6}", end="", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", default=DEFAULT_ADDRESS, help="the session's server")
    parser.add_argument("--osc", default="127.0.0.1:9000", help="HOST:PORT of the program that receives the pointer")
    parser.add_argument("--by", choices=RAYS, default="index", help="what points")
    parser.add_argument("--corners", type=float, nargs=9, default=CORNERS, help="x y z of three corners, world [m]")
    try:
        with OscSender((parsed := parser.parse_args()).osc) as sender:
            main(parsed, sender)
    except (MocapellaError, KeyboardInterrupt) as error:  # no session, or no OSC address; Ctrl-C
        sys.exit(str(error) or None)
