"""Angles of a recording beside a reference: python examples/08_compare.py walk-1.mcap vicon.c3d [report.html]"""

import sys

import numpy as np

import mocapella
from mocapella.errors import MocapellaError


def main(recording: str, reference: str, report: str | None) -> None:
    """Print what was estimated and corrected, and the agreement of each joint's position and of each angle."""
    comparison = mocapella.compare(recording, reference)
    print(comparison)
    found = comparison.result
    for rigid, words in ((False, "time corrected only"), (True, "time and rigid motion corrected")):
        agreement = found.all_positions(rigid=rigid)
        if agreement is not None:
            print(f"positions, {words}: RMSE {1e3 * agreement.rmse:.1f} mm of {agreement.n} samples")
    for name, angle in found.angle_agreement().items():
        mean, bias, low, high = np.degrees([angle.mean, angle.bias[0], angle.low[0], angle.high[0]])
        print(f"{name}: mean {mean:.1f}°, bias {bias:+.1f}°, 95 % of the differences from {low:.1f}° to {high:.1f}°")
    if report is not None:
        comparison.report(report)


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    except IndexError:
        sys.exit(__doc__)
    except MocapellaError as error:
        sys.exit(str(error))
