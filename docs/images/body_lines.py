"""Makes body-lines.png: the line skeleton of rendered people before a depth camera, stage by stage.

python docs/images/body_lines.py [FILE.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from mocapella.model.camera import Camera
from mocapella.sensing.body_lines import body_lines, pictures
from mocapella.sensing.line_skeleton_sheet import contact_sheet, write_picture
from mocapella.sources.simulate.room_depth import room_depth_scene


def main(file: Path) -> None:
    """Draw it."""
    scene = room_depth_scene("exchange", seed=1, sensor="kinect")
    shot = scene.at(9.0)
    camera = Camera("depth", scene.sensor.size_px, scene.lens)
    seen = body_lines(shot.depth * np.float32(shot.unit_m), camera)
    made = pictures(seen)
    whole = (np.minimum(shot.depth / shot.depth.max(), 1) * 255).astype(np.uint8)
    chosen = {"depth": whole, **{name: made[name] for name in ("8 bits", "outlines", "thinning", "lines")}}
    write_picture(file, contact_sheet(chosen))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "body-lines.png")
