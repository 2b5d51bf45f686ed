"""A sensor for the live benchmark: people who stand, at 30 Hz, as one process: python -m benchmarks._live_load …."""

from __future__ import annotations

import argparse
import itertools
import time

import msgspec
import numpy as np

from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.topology import topology
from mocapella.wire.node import NodeLink

RATE_HZ = 30


def standing_people(sensor: str, people: int, seed: int, count: int = 300) -> list[BodyFrame]:
    """Frames of people who stand before the sensor, with 3 mm of noise; made beforehand, so that sending is all."""
    rng = np.random.default_rng(seed)
    kind = topology("kinect_v2")
    body = np.random.default_rng(1).normal(size=(1, len(kind), 3)) * [0.2, 0.5, 0.1]
    place = np.stack([np.linspace(-1.5, 1.5, people), np.zeros(people), np.full(people, 2.5)], axis=-1)
    poses = body + place[:, None]
    noise = rng.normal(scale=0.003, size=(count, *poses.shape))
    return [body_frame(sensor, kind, time_ns=0, positions=poses + noise[k], depth_px=noise[k, ..., :2],
                       orientations=noise[k][..., [0, 1, 2, 0]]) for k in range(count)]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--connect", required=True)
    parser.add_argument("--sensor", required=True)
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    frames = itertools.cycle(standing_people(options.sensor, options.people, options.seed))
    with NodeLink(options.connect, options.sensor, history_frames=900) as link:
        while not link.join():
            time.sleep(0.1)
        began = time.monotonic() + options.seed / RATE_HZ / 6
        for k in range(round(options.seconds * RATE_HZ)):
            time.sleep(max(0.0, began + k / RATE_HZ - time.monotonic()))
            link.publish(msgspec.structs.replace(next(frames), time_ns=time.monotonic_ns()))


if __name__ == "__main__":
    main()
