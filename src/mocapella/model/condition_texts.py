"""Texts of the conditions that the calibration from people reports about a sensor: the cause and its remedy.

An *unfinished* condition only says what the calibration still needs. Any other condition is a warning: something is
wrong, and somebody has to act. docs/health.md lists all of them.
"""

from __future__ import annotations

from typing import Final

SEES_NOBODY: Final = "it sees nobody yet: walk where two sensors see you"
NOBODY_SHARED: Final = "no other sensor sees the same people: walk where two sensors see you"
NO_PERSON: Final = "both sensors must see a person"
WALK: Final = "walk a few steps"
WALK_ACROSS: Final = "walk a few steps, also sideways"
ON_A_LINE: Final = "the joints that both see lie on a line: walk a few steps where both see you"
NOT_ONE_BODY: Final = "their skeletons do not move as one body: walk a few steps where both see you"
WHICH_SIDE: Final = "left and right are not clear yet: lift one arm, or walk a few steps"
WHO_IS_WHO: Final = "it is not clear yet who is who: one of you, walk a few steps alone"
UNFINISHED: Final = (
    SEES_NOBODY, NOBODY_SHARED, NO_PERSON, WALK, WALK_ACROSS, ON_A_LINE, NOT_ONE_BODY, WHICH_SIDE, WHO_IS_WHO,
)  # fmt: skip

FROZEN: Final = "its picture stands still: start the sensor again"
CLOCK_BEHIND: Final = "its clock is {seconds:.0f} s behind another sensor's: set the clocks alike"
CLOCK_JUMPED: Final = "its clock jumped back: start the sensor again if this returns"
MOVED: Final = "it was moved (or the sensor beside it): walk a few steps where both see you"
ONE_PLACE: Final = "it stands where {other} stands, and sees no more: move one of them"
UNSEEN: Final = "it does not see people where {other} sees them: walk a few steps where both see you"
UNSEEN_BY_LAYOUT: Final = "it does not see people where the layout says: walk a few steps where both see you"
MIRRORED_STREAM: Final = "one of the two images is mirrored: switch mirroring off"
MISTILTED: Final = "people do not stand upright by its tilt: correct the tilt, or set its height to 0"
WARNINGS: Final = (
    FROZEN, CLOCK_BEHIND, CLOCK_JUMPED, MOVED, ONE_PLACE, UNSEEN, UNSEEN_BY_LAYOUT, MIRRORED_STREAM, MISTILTED,
)  # fmt: skip
