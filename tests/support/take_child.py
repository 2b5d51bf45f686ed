"""A process that records until it is killed; it says each frame that a flush acknowledged.

Usage: ``take_child.py PATH FRAMES``. Every process begins its nodes' history anew, as nodes do that send again what a
server may have missed.
"""

import sys
from pathlib import Path

from support.take_making import STEP, frame_bytes, info, scene_bytes

from mocapella.recording.take_writer import TakeWriter


def main(path: Path, frames: int) -> None:
    data = {s: [frame_bytes(s, i) for i in range(64)] for s in ("front", "side")}  # the content may repeat, keys do not
    writer = TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
    print("ready", flush=True)
    step = 0
    for sequence in range(frames):
        for sensor in ("front", "side"):
            raw = data[sensor][sequence] if sequence < 64 else frame_bytes(sensor, sequence)
            new = writer.write_frame(raw, sensor=sensor, node_id=1, sequence=sequence, log_ns=sequence * STEP)
            if new:
                writer.write_scene(scene_bytes(step, sensor, sequence), sequence * STEP + 1)
                step += 1
        if sequence % 5 == 4:
            writer.flush()
            print(sequence, flush=True)
    print("closed", writer.close().clean, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
