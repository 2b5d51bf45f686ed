"""Link the detections of one camera to tracks, and interpolate these to common instants.

A detection continues the track whose last keypoints it is nearest to, relative to the size of the person in the image;
a detector's own ids decide first. Tracks need not be right for ever: the calibration compares them in short
passages, so an exchange of two people costs one passage.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import CalibrationError
from mocapella.model.keypoints import NO_ID, KeypointFrame
from mocapella.model.topology import Topology, topology

Float64 = NDArray[np.float64]

HALPE: Final = topology("halpe_26")
"""The joints of all arrays of this package's calibration from keypoints."""
JOINTS: Final = len(HALPE)
_SAME: Final = {"MidHip": "Hip"}
"""Joints that other topologies call otherwise."""
_GATE: Final = 0.5
"""Largest mean distance of a detection from a track that it continues, in sizes of the person."""
_GAP_S: Final = 0.5
"""Longest gap within a track [s]."""
_SHORTEST_S: Final = 0.5
"""Shortest track that counts [s]."""
_BRIDGED_S: Final = 0.15
"""Longest gap across which keypoints are interpolated [s]."""
_SLOPE_S: Final = 0.3
"""Half the time over which velocities are taken: a detector's errors last nearly as long [s]."""
_FEWEST: Final = 5
"""Least number of keypoints of a detection that counts."""
_LEAST_CONFIDENCE: Final = 0.2
"""Confidence below which a keypoint is not used."""


class PersonTrack(msgspec.Struct, frozen=True, eq=False):
    """One person in the images of one camera.

    Attributes:
        at_s: (n,) ascending capture times, on the camera's clock [s].
        pixels: (n, 26, 2) keypoints of `HALPE` [px]; NaN where not seen.
        sizes_px: (n,) size of the person in the image: a robust extent of the keypoints [px].
    """

    at_s: Float64
    pixels: Float64
    sizes_px: Float64


@dataclass
class _Open:
    """A track that still grows."""

    id: int
    at_s: list[float] = field(default_factory=list)
    pixels: list[Float64] = field(default_factory=list)
    sizes: list[float] = field(default_factory=list)


class CameraTracks:
    """Links the detections of one camera, frame by frame.

    Args:
        name: the camera's name.
        size_px: (width, height) of its images.
    """

    def __init__(self, name: str, size_px: tuple[int, int]) -> None:
        self.name, self.size_px = name, size_px
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._closed: list[_Open] = []
        self._open: list[_Open] = []
        self.frames = 0
        self.first_s = self.last_s = float("nan")

    def update(self, frame: KeypointFrame, at_s: float) -> None:
        """Add a frame; one that is not newer than the last is ignored.

        Args:
            frame: the detections.
            at_s: capture time on the camera's clock [s].

        Raises:
            CalibrationError: the frame's image has another size than the camera's first, or its topology has no joint
                of `HALPE`.
        """
        if frame.size_px != self.size_px:
            raise CalibrationError(
                f"camera {self.name} has pictures of {self.size_px[0]}×{self.size_px[1]} and "
                f"{frame.size_px[0]}×{frame.size_px[1]} px: film with one size"
            )
        if at_s <= self.last_s:
            return
        self.first_s = at_s if not self.frames else self.first_s
        self.last_s, self.frames = at_s, self.frames + 1
        pixels = as_halpe(frame)
        sizes = sizes_of(pixels)
        usable = np.isfinite(sizes) & (np.isfinite(pixels[..., 0]).sum(axis=1) >= _FEWEST)
        self._closed += [track for track in self._open if at_s - track.at_s[-1] > _GAP_S]
        self._open = [track for track in self._open if at_s - track.at_s[-1] <= _GAP_S]
        self._assign(frame.ids[usable], pixels[usable], sizes[usable], at_s)

    def _assign(self, ids: NDArray[np.int64], pixels: Float64, sizes: Float64, at_s: float) -> None:
        left = set(range(len(ids)))
        free = set(range(len(self._open)))
        by_id = {track.id: k for k, track in enumerate(self._open) if track.id != NO_ID}
        pairs = [(-1.0, by_id[int(i)], d) for d, i in enumerate(ids) if int(i) in by_id]
        for k, track in enumerate(self._open):
            off = _apart(pixels, track.pixels[-1]) / np.maximum(sizes, 1e-9)
            pairs += [(float(off[d]), k, d) for d in range(len(ids)) if off[d] <= _GATE and ids[d] == NO_ID]
        for _, k, d in sorted(pairs):
            if k in free and d in left:
                free.discard(k)
                left.discard(d)
                self._append(self._open[k], pixels[d], float(sizes[d]), at_s)
        for d in sorted(left):
            self._open.append(_Open(int(ids[d])))
            self._append(self._open[-1], pixels[d], float(sizes[d]), at_s)

    def _append(self, track: _Open, pixels: Float64, size: float, at_s: float) -> None:
        track.at_s.append(at_s)
        track.pixels.append(pixels)
        track.sizes.append(size)

    def forget(self, before_s: float) -> None:
        """Drop all tracks that ended before a time on the camera's clock [s]; the camera then begins there."""
        self._closed = [track for track in self._closed if track.at_s[-1] >= before_s]
        for track in self._closed + self._open:
            first = sum(at < before_s for at in track.at_s)
            for values in (track.at_s, track.pixels, track.sizes):
                del values[:first]
        self._open = [track for track in self._open if track.at_s]
        self.first_s = max(self.first_s, before_s)

    def memory(self) -> dict[str, Any]:
        """Return all state as plain values and arrays, copied, for `recalled`."""
        lists = [[[t.id, np.array(t.at_s), np.array(t.pixels), np.array(t.sizes)] for t in of] for of in self._all]
        return {
            "name": self.name, "size_px": self.size_px, "frames": self.frames, "first_s": self.first_s,
            "last_s": self.last_s, "tracks": lists,
        }  # fmt: skip

    @property
    def _all(self) -> tuple[list[_Open], list[_Open]]:
        return self._closed, self._open

    @classmethod
    def recalled(cls, memory: dict[str, Any]) -> CameraTracks:
        """Return tracks with the state that `memory` returned."""
        made = cls(str(memory["name"]), (int(memory["size_px"][0]), int(memory["size_px"][1])))
        made.frames, made.first_s, made.last_s = int(memory["frames"]), memory["first_s"], memory["last_s"]
        made._closed, made._open = (
            [_Open(int(i), at.tolist(), list(pixels), sizes.tolist()) for i, at, pixels, sizes in of]
            for of in memory["tracks"]
        )
        return made

    def tracks(self) -> list[PersonTrack]:
        """Return all tracks that last for half a second or longer, in the order of their beginnings."""
        kept = [track for track in self._closed + self._open if track.at_s[-1] - track.at_s[0] >= _SHORTEST_S]
        kept.sort(key=lambda track: (track.at_s[0], float(np.nansum(track.pixels[0]))))
        return [PersonTrack(np.array(t.at_s), np.array(t.pixels), np.array(t.sizes)) for t in kept]


def collect_tracks(frames: Iterable[KeypointFrame]) -> dict[str, CameraTracks]:
    """Link the detections of all frames, by camera, in the order of the names.

    Args:
        frames: frames of any cameras; each camera's in the order of their times.

    Raises:
        CalibrationError: as `CameraTracks.update`.
    """
    cameras: dict[str, CameraTracks] = {}
    for frame in frames:
        if frame.sensor not in cameras:
            cameras[frame.sensor] = CameraTracks(frame.sensor, frame.size_px)
        cameras[frame.sensor].update(frame, frame.time_ns / NS_PER_S)
    return dict(sorted(cameras.items()))


def _joints_of(source: Topology) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return indices of joints of `HALPE`, and of the single joints of another topology at their positions."""
    if source.name == HALPE.name or HALPE.name in source.mappings:
        single = list(source.single_joints(HALPE.name).items())
    else:
        names = {_SAME.get(name, name): k for k, name in enumerate(source.joints)}
        single = [(k, names[name]) for k, name in enumerate(HALPE.joints) if name in names]
    if len(single) < _FEWEST:
        raise CalibrationError(
            f"keypoints of {source.name} have too few joints of {HALPE.name}: give keypoints of a body"
        )
    targets, sources = zip(*single, strict=True)
    return tuple(targets), tuple(sources)


def as_halpe(frame: KeypointFrame) -> Float64:
    """Return the keypoints (detections, 26, 2) of a frame as `HALPE`'s [px]; NaN where not seen or hardly confident."""
    targets, sources = _joints_of(frame.topology)
    out = np.full((len(frame.ids), JOINTS, 2), np.nan)
    sure = frame.confidences[:, sources] >= _LEAST_CONFIDENCE
    out[:, targets] = np.where(sure[..., None], frame.positions_px[:, sources], np.nan)
    return out


def sizes_of(pixels: Float64) -> Float64:
    """Return the size (...,) of people (..., joints, 2): the diagonal of the box of their keypoints; NaN if none."""
    seen = np.isfinite(pixels).all(axis=-1, keepdims=True)
    low = np.where(seen, pixels, np.inf).min(axis=-2)
    high = np.where(seen, pixels, -np.inf).max(axis=-2)
    extent = np.where(high > low, high - low, np.nan)
    return np.asarray(np.hypot(extent[..., 0], extent[..., 1]))


def _apart(pixels: Float64, last: Float64) -> Float64:
    """Return the median distance (detections,) of the keypoints from a track's [px]; infinite without common."""
    off = np.linalg.norm(pixels - last, axis=-1)
    common = np.isfinite(off).any(axis=1)
    out = np.full(len(off), np.inf)
    out[common] = np.nanmedian(off[common], axis=1)
    return out


def at_instants(track: PersonTrack, at_s: Float64) -> tuple[Float64, Float64]:
    """Interpolate a track linearly.

    Args:
        track: the track.
        at_s: (instants,) on the track's clock [s].

    Returns:
        (instants, 26, 2) pixels [px], NaN outside the track, in gaps, and where a keypoint of either neighbour is not
        seen; (instants,) sizes of the person [px].
    """
    after = np.clip(np.searchsorted(track.at_s, at_s), 1, len(track.at_s) - 1)
    before = after - 1
    span = track.at_s[after] - track.at_s[before]
    part = (at_s - track.at_s[before]) / span
    inside = (part >= -1e-9) & (part <= 1 + 1e-9) & (span <= _BRIDGED_S)
    part = np.where(inside, part, np.nan)[:, None, None]
    pixels = (1 - part) * track.pixels[before] + part * track.pixels[after]
    sizes = np.where(inside, np.maximum(track.sizes_px[before], track.sizes_px[after]), np.nan)
    return pixels, sizes


def velocities_at(track: PersonTrack, at_s: Float64) -> Float64:
    """Return the slopes (instants, 26, 2) of lines through the keypoints within 0.3 s [px/s]; 0 where unknown."""
    out = np.zeros((len(at_s), JOINTS, 2))
    first, last = np.searchsorted(track.at_s, at_s - _SLOPE_S), np.searchsorted(track.at_s, at_s + _SLOPE_S)
    for k in range(len(at_s)):
        pixels, t = track.pixels[first[k] : last[k]], track.at_s[first[k] : last[k], None, None] - at_s[k]
        if len(pixels) < 3:
            continue
        seen = np.isfinite(pixels)
        count = np.maximum(seen.sum(axis=0), 1)
        t0 = np.where(seen, t, 0).sum(axis=0) / count
        off = np.where(seen, t - t0, 0.0)
        square = (off**2).sum(axis=0)
        slope = (off * np.where(seen, pixels, 0.0)).sum(axis=0) / np.maximum(square, 1e-12)
        out[k] = np.where((count >= 3) & (square > 1e-6), slope, 0.0)
    return out
