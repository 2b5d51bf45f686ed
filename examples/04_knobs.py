"""A bank of knobs: grab above one, roll the hand to turn it, let go to leave it. python examples/04_knobs.py --help

Sends OSC: /knob/1 VALUE, 0 to 1. A hand that is uncertain turns nothing; one that is lost lets go.
"""

import argparse
import math
import sys
import time

import numpy as np

from mocapella.errors import MocapellaError
from mocapella.model.arms import PALM
from mocapella.settings import check
from mocapella.sources.osc_sender import OscSender
from mocapella.wire.reader import Newest
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader

MOST_M = 0.03  # a palm with a larger standard deviation turns nothing


def roll(R_world_before, R_world_now):
    """Twist about the palm's long axis z from one rotation to another, -pi to pi [rad]; clockwise for its owner."""
    R = R_world_before.T @ R_world_now
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])


class Knobs:
    """Values (n,) of knobs side by side on the x axis [m]; a roll of `turn` is the whole range [rad]."""

    def __init__(self, count, left, right, turn):
        self.values, self.left, self.right, self.turn, self.held = np.full(count, 0.5), left, right, turn, None

    def update(self, x, R, grabbing):
        """Feed a certain hand: its palm's x [m], rotation (3, 3) and whether it grabs. Return the knob it turned."""
        if not grabbing:
            self.held = None
        elif self.held is None:  # a grab beside the bank holds none, -1, until it lets go
            place = math.floor((x - self.left) / (self.right - self.left) * len(self.values))
            self.held = place if 0 <= place < len(self.values) else -1
            self.from_value, self.R, self.rolled = self.values[self.held], R, 0.0
        elif self.held >= 0:
            self.rolled += (roll(self.R, R) - self.rolled + math.pi) % (2 * math.pi) - math.pi  # past half a turn, too
            self.values[self.held] = min(max(self.from_value + self.rolled / self.turn, 0.0), 1.0)
        return self.held if self.held is not None and self.held >= 0 else None


def main(args, osc):
    """Follow one arm until Ctrl-C."""
    check(args.bank[0] < args.bank[1], "--bank", args.bank, "the left end, then a larger right end [m]")
    check(0 < args.turn <= 3600, "--turn", args.turn, "above 0, at most 3600 degrees")
    session, knobs = open_reader(args.connect), Knobs(args.knobs, *args.bank, math.radians(args.turn))
    newest, followed = Newest(session), None
    while True:
        time.sleep(0.005)
        if (scene := newest.scene()) is None:
            continue
        arm = next((arm for arm in scene.arms if arm.id == followed), next(iter(scene.arms), None))
        followed, knobs.held = arm and arm.id, knobs.held if arm and arm.id == followed else None
        sure = arm and arm.cameras and arm.T_world_palm is not None and arm.states[PALM] == 2 and arm.sd[PALM] < MOST_M
        if sure and (k := knobs.update(arm.points[PALM, 0], arm.T_world_palm[:3, :3], arm.grabbing)) is not None:
            osc.send(f"/knob/{k + 1}", knobs.values[k])
        bars = (f"{'*' if k == knobs.held else ' '}{k + 1} {'#' * round(8 * v):<8}" for k, v in enumerate(knobs.values))
        print("\r" + " ".join(bars), end="", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", default=DEFAULT_ADDRESS, help="the session's server")
    parser.add_argument("--osc", default="127.0.0.1:9000", help="HOST:PORT of the program that receives the values")
    parser.add_argument("--knobs", type=int, choices=range(1, 17), default=4, metavar="1..16", help="how many")
    parser.add_argument("--bank", type=float, nargs=2, default=[-0.3, 0.3], help="its left and right end, world x [m]")
    parser.add_argument("--turn", type=float, default=180.0, help="roll of the hand for the whole range [deg]")
    try:
        with OscSender((parsed := parser.parse_args()).osc) as sender:
            main(parsed, sender)
    except (MocapellaError, KeyboardInterrupt) as error:  # no session, or no OSC address; Ctrl-C
        sys.exit(str(error) or None)
