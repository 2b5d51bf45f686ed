"""Where a body's memory is in its row of numbers, in the order of `ArticulatedModel.layout`."""

from typing import Final

AT, SEEN, STARTED, LOST_SINCE, RESTLESS = 0, 1, 2, 3, 4
"""The head: its instant [s], when it was last seen [s], 1 where a body was begun, since when it is lost or NaN [s], and
the surprise of late."""
DOFS, BALLS, JOINTS, LENGTHS = 0, 1, 2, 3
"""Places in the layout: how many there are of what."""
ANGLES: Final = 4
"""(dofs,) the root's position [m], three unused, and the angles of the hinges [rad]; those of balls are unused."""
VELOCITIES: Final = 5
"""(dofs,) of the root along the world's axes [m/s], and of all that turns, about its own axes [rad/s]."""
VARIANCE: Final = 6
"""(dofs,) [m² or rad²]; of the root's position along its own axes."""
COVARIANCE: Final = 7
"""(dofs,) with the velocity [m²/s or rad²/s]."""
SPEED_VARIANCE: Final = 8
"""(dofs,) of the velocity [m²/s² or rad²/s²]."""
ROTATIONS: Final = 9
"""(balls, 3, 3) of the joints that turn every way, the root's first."""
BONES: Final = 10
"""(lengths,) [m]; the two sides of the body share theirs."""
LEARNT: Final = 11
"""(lengths,) for how long each was learnt [s]."""
CONTACTS: Final = 12
"""(contacts, 6) where a joint that may stand was at the memory's instant [m], and its velocity of late [m/s]."""
JUMPS: Final = 13
"""(joints, 4) how far a joint was measured from its prediction the last time [m], NaN where it was not, and the
variance of a coordinate that follows from how much this changes from frame to frame [m²]."""
SIZE: Final = 14
"""How many numbers there are."""

(
    VELOCITY_MEMORY, REST_SD, NU, LENGTH_MEMORY, LEAST_JOINTS, LOST_M, LOST_S, FORGET_AFTER, SURPRISE_S, FULL_SURPRISE,
    CALM, STAND_DIFFUSION, STAND_SPEED, NOISE_S,
) = range(14)  # fmt: skip
"""The places of `ArticulatedModel.config`."""
