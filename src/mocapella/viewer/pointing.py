"""Progress of a user who clicks on the markers in one camera image, so that their colours can be learnt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from mocapella.errors import SettingsError

Point = tuple[float, float]
"""x, y in the camera's image [px]; the middle of the first pixel is (0, 0)."""

SKIN: Final = "skin"
MARKERS: Final = ("red", "yellow", "green", "blue", "magenta", "cyan")
"""Default marker names of the tracking method `hands`: thumb to little finger, and palm."""
MOST: Final = 64
_LONGEST: Final = 80
_WHERE: Final = dict(
    zip(MARKERS, ("thumb", "index finger", "middle finger", "ring finger", "little finger", "palm"), strict=True)
)


@dataclass(frozen=True)
class Pointing:
    """State while the user clicks on the markers in an image, one after the other, and finally on skin.

    Attributes:
        names: names of the markers, in the order of the clicks; the last is `SKIN`.
        done: clicked positions of the first markers [px]; None for a skipped marker.
    """

    names: tuple[str, ...] = (*MARKERS, SKIN)
    done: tuple[Point | None, ...] = ()

    @property
    def next(self) -> str | None:
        """Name of the next marker to click on; None if all are done."""
        return self.names[len(self.done)] if len(self.done) < len(self.names) else None

    @property
    def points(self) -> dict[str, Point]:
        """Clicked positions by the marker's name [px]."""
        return {name: at for name, at in zip(self.names, self.done, strict=False) if at is not None}

    @property
    def enough(self) -> bool:
        """Whether at least one marker was clicked, so that colours can be learnt."""
        return any(name != SKIN for name in self.points)

    def click(self, at: Point) -> Pointing:
        """Return the state after a click at ``at`` on the next marker (to 0.01 px); unchanged if all are done."""
        return self if self.next is None else replace(self, done=(*self.done, (round(at[0], 2), round(at[1], 2))))

    def skip(self) -> Pointing:
        """Return the state with the next marker skipped, such as one that is not visible."""
        return self if self.next is None else replace(self, done=(*self.done, None))

    def back(self) -> Pointing:
        """Return the state without the last click or skip."""
        return replace(self, done=self.done[:-1])

    def again(self) -> Pointing:
        """Return the state without any clicks."""
        return replace(self, done=())

    def named(self, names: tuple[str, ...]) -> Pointing:
        """Return the state with other marker names; clicks before the first changed name are kept."""
        same = next((k for k, (a, b) in enumerate(zip(self.names, names, strict=False)) if a != b), len(self.names))
        return Pointing(names, self.done[:same])


def read_names(text: str) -> tuple[str, ...]:
    """Parse marker names in a text such as ``red, blue``; return them, followed by `SKIN`.

    Empty names and `SKIN` in the text are left out.

    Raises:
        SettingsError: there is no name, or there are too many, or a name is repeated or too long.
    """
    names = tuple(part for part in (part.strip() for part in text.split(",")) if part and part != SKIN)
    if not names:
        raise SettingsError("no marker is named; write their names with commas between, such as red, blue")
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise SettingsError(f"{twice[0]} is named twice; each marker wants a name of its own")
    if long := [name for name in names if len(name) > _LONGEST]:
        raise SettingsError(f"{long[0][:20]}… has {len(long[0])} characters; a name has at most {_LONGEST}")
    if len(names) > MOST:
        raise SettingsError(f"{len(names)} markers are named; at most {MOST} can be pointed at")
    return (*names, SKIN)


def where(name: str) -> str:
    """Return the part of the hand that wears the marker with a default name; empty for other names."""
    return _WHERE.get(name, "")


def asks_for(name: str | None) -> str:
    """Return the instruction to the user to click on a marker; ``name`` is the next marker, or None if all are done."""
    if name is None:
        return "All are pointed at: press Learn"
    if name == SKIN:
        return "Click on skin, away from the markers"
    return f"Click on {name}" + (f", on the {where(name)}" if where(name) else "")
