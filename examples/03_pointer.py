"""A pointer: a finger or forearm points at a plane, and a grab clicks. python examples/03_pointer.py --help

Sends OSC: /pointer X Y, each 0 to 1 from the top left corner, and /pointer/click 1 or 0. A hand that is uncertain
moves nothing; one that is lost also ends its click. --learn asks you to point at the plane's corners first.
"""

import argparse
import time

import numpy as np

from mocapella.errors import MocapellaError
from mocapella.kinematics.pointing import POINTERS, CornerLearning, plane_corners, plane_hit, ray_of
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings
from mocapella.sources.osc_sender import OscSender
from mocapella.wire.reader import Newest
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader

CORNERS = [-0.5, 1.4, 0.4, 0.5, 1.4, 0.4, -0.5, 0.2, 0.4]  # suits the arm of the demo


def arms(newest):
    """Yield the time of each scene [s], one arm or None, and whether it is the arm of the scene before."""
    followed = None
    while True:
        time.sleep(0.005)
        if (scene := newest.scene()) is not None:
            arm = next((arm for arm in scene.arms if arm.id == followed), next(iter(scene.arms), None))
            same, followed = arm is not None and arm.id == followed, arm and arm.id
            yield scene.at_ns * 1e-9, arm, same


def learn(args, newest):
    """Ask for each corner from two places; print and return them, (3, 3) in the world [m]."""
    learning, frames = CornerLearning(), arms(newest)
    print(learning.request, flush=True)
    while learning.request:
        at_s, arm, _ = next(frames)
        if (ray := ray_of(arm, args.by)) and learning.update(*ray, at_s):
            print("\a" + learning.request, flush=True)  # with a beep
    words = " ".join(f"{x:z.3f}" for x in learning.corners().ravel())
    print(f"python {__file__} --connect {args.connect} --osc {args.osc} --by {args.by} --corners {words}", flush=True)
    return learning.corners()


def main(args, osc):
    """Follow one arm until Ctrl-C."""
    corners, session = plane_corners(args.corners, "--corners"), open_reader(args.connect)
    newest, smooth, clicked = Newest(session), OneEuro(OneEuroSettings(beta_per_m=1.0)), False
    corners = learn(args, newest) if args.learn else corners
    for at_s, arm, same in arms(newest):
        before, clicked, word = clicked, clicked and same, "no hand" if arm is None else "uncertain"
        if not same:
            smooth.reset()
        if ray := ray_of(arm, args.by):
            clicked, word = arm.grabbing, "points elsewhere"
            x, y = smooth.update(plane_hit(*ray, corners)[None], at_s)[0].clip(0.0, 1.0)
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
    parser.add_argument("--by", choices=POINTERS, default="index", help="what points")
    parser.add_argument("--corners", type=float, nargs=9, default=CORNERS, help="x y z of three corners, world [m]")
    parser.add_argument("--learn", action="store_true", help="point at the corners from two places instead")
    try:
        with OscSender((parsed := parser.parse_args()).osc) as sender:
            main(parsed, sender)
    except (MocapellaError, KeyboardInterrupt) as error:  # no session, or no OSC address; Ctrl-C
        raise SystemExit(str(error) or None) from None
