"""Walking people as keypoints of simulated cameras, with the faults of detectors, for tests of the method webcams."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.topology import topology
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_warmup import standing_person

Float64 = NDArray[np.float64]
Path = Callable[[float], tuple[float, float, float]]
"""Place x, z on the floor [m] and heading [rad] of a person at a time [s]."""
Fault = Callable[[str, float, Float64, Float64], tuple[Float64, Float64]]
"""Changes the pixels (people, 26, 2) and confidences (people, 26) of a camera at a time."""

HALPE = topology("halpe_26")
SWING_M = {"Elbow": -0.1, "Wrist": -0.25, "Knee": 0.13, "Ankle": 0.25, "Heel": 0.25, "BigToe": 0.25, "SmallToe": 0.25}
RATE_HZ = 30.0


def walker(at_s: float, path: Path, *, height_m: float = 1.75, phase: float = 0.0) -> Float64:
    """(26, 3) joints of a person who walks along a path, with arms and legs that swing."""
    joints = standing_person().copy()
    swing = np.sin(2.0 * np.pi * 0.9 * at_s + phase)
    for name, i in zip(HALPE.joints, range(26), strict=True):
        side = 1.0 if name.startswith("L") else -1.0 if name.startswith("R") else 0.0
        part = name[1:] if side else name
        joints[i, 2] += side * swing * SWING_M.get(part, 0.0)
    x, z, heading = path(at_s)
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return joints * (height_m / 1.74) @ R.T + [x, 0.0, z]


def circling(radius_m: float, period_s: float, phase: float = 0.0, centre: tuple[float, float] = (0.0, 0.0)) -> Path:
    """A path around a point."""

    def at(t: float) -> tuple[float, float, float]:
        a = 2.0 * np.pi * t / period_s + phase
        return centre[0] + radius_m * np.sin(a), centre[1] + radius_m * np.cos(a), a + np.pi / 2.0

    return at


def between(start: tuple[float, float], end: tuple[float, float], speed_m_s: float = 1.2) -> Path:
    """A straight path from one point to another and beyond."""
    way = np.subtract(end, start)
    unit = way / np.linalg.norm(way)

    def at(t: float) -> tuple[float, float, float]:
        x, z = np.asarray(start) + unit * speed_m_s * t
        return float(x), float(z), float(np.arctan2(unit[0], unit[1]))

    return at


def standing(x: float, z: float, heading: float = 0.0) -> Path:
    """A path of somebody who stands."""
    return lambda t: (x, z, heading)


def frames(  # a scene, with its faults
    rig: CameraRig,
    people: Sequence[Callable[[float], Float64 | None]],
    *,
    seconds: float,
    noise: float = 0.01,
    seed: int = 1,
    fault: Fault | None = None,
    occlusion: bool = True,
    offsets_s: dict[str, float] | None = None,
    rates_hz: dict[str, float] | None = None,
) -> list[Arrival]:
    """Frames of all cameras in the order of their capture; a person's function gives the joints, or None if absent.

    ``noise`` is the keypoints' standard deviation relative to the person's size in the image.
    """
    random = np.random.default_rng(seed)
    events = []
    for name in sorted(rig.cameras):
        rate = (rates_hz or {}).get(name, RATE_HZ)
        offset = (offsets_s or {}).get(name, 0.0)
        events += [(offset + k / rate, name, k) for k in range(round(seconds * rate))]
    found = []
    for at_s, name, k in sorted(events):
        px, sure = seen(rig, name, [one(at_s) for one in people], random, noise, occlusion)
        if fault is not None:
            px, sure = fault(name, at_s, px, sure)
        at_ns = round(1e9 * (1.0 + at_s))
        size = rig.cameras[name].camera.size_px
        frame = keypoint_frame(
            name,
            HALPE,
            time_ns=at_ns,
            size_px=size,
            positions_px=px,
            confidences=sure if len(sure) else 1.0,
            sequence=k,
        )
        found.append(Arrival(frame, at_ns))
    return found


def seen(  # noqa: PLR0917
    rig: CameraRig, name: str, bodies: Iterable[Float64 | None], random: Any, noise: float, occlusion: bool
) -> tuple[Float64, Float64]:
    """Pixels and confidences of the people in a camera's image; a person behind another loses the joints there."""
    placed = rig.cameras[name]
    own = [apply(placed.T_camera_world, one) for one in bodies if one is not None]
    pixels, confidences = [], []
    for i, one in enumerate(own):
        px = project(one, placed.camera.lens)
        size = np.ptp(px[np.isfinite(px).all(axis=1)], axis=0).max(initial=1.0)
        noisy = px + random.normal(size=px.shape) * noise * 0.6 * size
        hidden = ((px < 0) | (px > np.array(placed.camera.size_px) - 1)).any(axis=1) | ~np.isfinite(px).all(axis=1)
        for k, other in enumerate(own):
            if occlusion and k != i and other[:, 2].mean() < one[:, 2].mean() - 0.25:
                box = project(other, placed.camera.lens)
                low, high = np.nanmin(box, axis=0), np.nanmax(box, axis=0)
                hidden |= ((px > low) & (px < high)).all(axis=1)
        sure = np.where(hidden, 0.0, random.uniform(0.5, 1.0, len(px)))
        if (sure > 0).sum() >= 4:
            pixels.append(noisy)
            confidences.append(sure)
    return np.array(pixels).reshape(-1, 26, 2), np.array(confidences).reshape(-1, 26)


def run(tracker: WebcamsTracker, arrivals: Iterable[Arrival]) -> list[Scene]:
    """The scenes of all arrivals."""
    return [tracker.update(one) for one in arrivals]


def last_of_each(scenes: Sequence[Scene]) -> list[Scene]:
    """The last scene of each capture time."""
    return list({scene.at_ns: scene for scene in scenes}.values())


def identities(
    scenes: Sequence[Scene], people: Sequence[Callable[[float], Float64 | None]]
) -> list[list[tuple[int, float]]]:
    """For each true person, number and mean joint error [m] of the nearest tracked one within 0.5 m, in each scene."""
    found: list[list[tuple[int, float]]] = [[] for _ in people]
    for scene in scenes:
        for i, one in enumerate(people):
            truth = one(scene.at_ns / 1e9 - 1.0)
            if truth is None:
                continue
            errors = [(float(np.nanmean(np.linalg.norm(p.positions - truth, axis=1))), p.id) for p in scene.people]
            error, number = min(errors, default=(np.inf, -1))
            if error < 0.5:
                found[i].append((number, error))
    return found
