"""`mocapella export spots`: a table of the spots."""

import csv

from mocapella.cli.common import TakeArgument, say
from mocapella.cli.recordings import open_take
from mocapella.exports.export import Export


def spots(take: TakeArgument) -> None:
    """Write a row for each spot of each result: step, time [s], number, x and z [m], temperature [°C].

    Example:  mocapella export spots heat-1
    """
    source = open_take(take)
    target = source.path.with_suffix(".spots.csv")
    with target.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["step", "at_s", "id", "x_m", "z_m", "celsius"])
        for _, scene in source.scenes():
            rows.writerows([scene.step, scene.at_ns / 1e9, s.id, s.x, s.z, s.celsius] for s in scene.of("spots"))
    say(f"spots in {target}")


SPOTS = Export(
    interface=1,
    name="spots",
    summary="Hot spots: a row for each spot of each result.",
    parts=("spots",),
    command="mocapella_thermal.export:spots",
)
