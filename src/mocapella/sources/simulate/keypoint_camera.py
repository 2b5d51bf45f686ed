"""A simulated camera with a detector of keypoints: frames as a node sends them, with ground truth.

All random numbers of a camera are drawn before its first frame, so equal seeds give equal bits, wherever one starts to
read. What lasts, such as a slow error or a swap, follows an autoregressive process of first order over the frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from mocapella.conventions import NS_PER_S
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.camera import PlacedCamera
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import Topology
from mocapella.model.topology import topology as named_topology
from mocapella.settings import check
from mocapella.sources.simulate.body import BODY, body_template
from mocapella.sources.simulate.keypoint_body import (
    GROUPS,
    HALPE,
    detected_positions,
    face_hidden,
    group_of,
    halpe_positions,
    head_axes,
    hiding_joint,
    keypoint_weights,
)
from mocapella.sources.simulate.keypoint_errors import ErrorTables, bin_of, detector_errors
from mocapella.sources.simulate.keypoint_faults import KeypointFaults
from mocapella.sources.simulate.keypoint_parts import (
    LIMBS,
    REACH,
    PartDraws,
    furniture,
    lower_part,
    snap,
    split,
    take_limbs,
)
from mocapella.sources.simulate.motion import Ensemble, normalised
from mocapella.sources.simulate.occlusion import Obstacles, hidden, obstacles

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

PHANTOM: Final = -1
"""Number of a detection that is not to be tracked: a false one, a bystander, a picture or a mirror image."""
_LOWER: Final = np.array([GROUPS[g] in ("hip", "knee", "ankle", "foot") for g in group_of()])
LEGS: Final = np.array([GROUPS[g] in ("knee", "ankle", "foot") for g in group_of()])
"""Whether each keypoint (26,) is of a leg below the hip."""
_MIRROR: Final = np.array(HALPE.mirror)
_CLOSE: Final = 0.12
"""Mean distance of two people's keypoints in an image below which they may be merged, relative to the size."""
_FALSE_CONFIDENCE: Final = (0.05, 0.45)


@dataclass(frozen=True)
class KeypointCameraSettings:
    """Timing and detector of a simulated camera.

    Attributes:
        hz: frame rate; larger: more frames [Hz].
        phase_s: capture of the first frame; larger: later [s].
        jitter_s: standard deviation of the capture times; larger: less regular [s].
        clock_offset_s: the camera's clock minus the true time, at 0; larger: the clock is ahead [s].
        clock_drift_ppm: excess rate of the camera's clock; larger: faster [ppm].
        known_clock_s: constant error of the times on the common clock; larger: frames seem later [s].
        known_clock_sd_s: standard deviation of a further such error; larger: worse [s].
        latency_s: time from capture to arrival; larger: later [s].
        lost: probability that a frame is lost; larger: more [ratio].
        topology: name of the topology of the frames.
        detector: name of the measured errors, see `keypoint_errors.detector_errors`.
        faults: assumed faults.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    hz: float = 30.0
    phase_s: float = 0.0
    jitter_s: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift_ppm: float = 0.0
    known_clock_s: float = 0.0
    known_clock_sd_s: float = 0.0
    latency_s: float = 0.05
    lost: float = 0.0
    topology: str = "halpe_26"
    detector: str = "openpose"
    faults: KeypointFaults = field(default_factory=KeypointFaults)

    def __post_init__(self) -> None:
        check(1 <= self.hz <= 500, "hz", self.hz, "from 1 to 500 Hz")
        check(0 <= self.phase_s <= 1, "phase_s", self.phase_s, "from 0 to 1 s")
        check(0 <= self.jitter_s <= 0.2 / self.hz, "jitter_s", self.jitter_s, "from 0 to a fifth of the period")
        check(0 <= self.latency_s <= 10, "latency_s", self.latency_s, "from 0 to 10 s")
        check(abs(self.known_clock_s) <= 1, "known_clock_s", self.known_clock_s, "within ±1 s")
        check(0 <= self.known_clock_sd_s <= 1, "known_clock_sd_s", self.known_clock_sd_s, "from 0 to 1 s")
        check(abs(self.clock_drift_ppm) <= 1000, "clock_drift_ppm", self.clock_drift_ppm, "within ±1000 ppm")
        check(0 <= self.lost < 1, "lost", self.lost, "from 0 to below 1")


class SimulatedKeypoints(msgspec.Struct, frozen=True, eq=False):
    """A frame with its ground truth.

    Attributes:
        frame: the frame.
        at_ns: capture on the common clock, as the tracker knows it [ns].
        due_ns: arrival, room time [ns].
        room_ns: capture of the first row, room time [ns].
        people: (people,) numbers of the people that can be tracked.
        positions: (people, 26, 3) their keypoints at ``room_ns``, world [m].
        visible: (people, 26) whether each keypoint is in the image and nothing hides it.
        detected: (detections,) number of the person of each detection, or `PHANTOM`.
        mirrored: (detections,) whether left and right of the person, or of the legs, are swapped.
    """

    frame: KeypointFrame
    at_ns: int
    due_ns: int
    room_ns: int
    people: Int64
    positions: Float64
    visible: Bools
    detected: Int64
    mirrored: Bools


@dataclass(frozen=True, eq=False)
class SeenRoom:
    """What cameras look at.

    Attributes:
        motion: the motion of all bodies, also of bodies that only some cameras see.
        numbers: (bodies,) number of the person, or `PHANTOM`.
        seen_by: (bodies,) names of the only cameras that see the body; empty for all.
        obstacles: what hides them, too.
        mirrors: for a camera's name the mirrors that it sees: (point, normal) of a plane, world [m].
    """

    motion: Ensemble
    numbers: Int64
    seen_by: tuple[tuple[str, ...], ...]
    obstacles: Obstacles
    mirrors: dict[str, tuple[tuple[Float64, Float64], ...]]


class _Draws(msgspec.Struct, frozen=True, eq=False):
    """Random numbers of all frames: Gaussian, of variance 1; axes (frames, bodies, 26, …)."""

    error: Float64
    confidence: Float64
    tail: Float64
    missing: Float64
    taken: Float64
    person: Float64


class _Bodies(msgspec.Struct, frozen=True, eq=False):
    """The bodies of one image: pixels (bodies, 26, 2), depth and state (bodies, 26), sizes and facing (bodies,)."""

    pixels: Float64
    inside: Bools
    states: Int64
    sizes: Float64
    depths: Float64
    towards: Float64


class _MoreDraws(msgspec.Struct, frozen=True, eq=False):
    """Random numbers of the faults that most scenes do not have: Gaussian, of variance 1; axes as of `_Draws`."""

    error_px: Float64
    unrelated: Float64
    exchanged: Float64
    limb: Float64


_PERSON_DRAWS: Final = ("missed", "mirrored", "legs", "merged", "duplicate")


class SimulatedKeypointCamera:
    """One camera of a room.

    Args:
        room: the room in its view.
        placed: its name, lens and true pose.
        settings: its timing and detector.
        seed: random seed of the scene.
        index: index of the camera in the scene, for the seed.
        duration_s: duration for which frames are made [s].

    Raises:
        SettingsError: an unknown detector, or a topology that is not simulated.
    """

    def __init__(
        self, room: SeenRoom, placed: PlacedCamera, settings: KeypointCameraSettings, *, seed: int, index: int,
        duration_s: float,
    ) -> None:  # fmt: skip
        self.room, self.placed, self.settings = room, placed, settings
        self.tables: ErrorTables = detector_errors(settings.detector)
        self.topology: Topology = named_topology(settings.topology)
        self._weights = keypoint_weights(settings.topology)
        self._rng = np.random.default_rng([seed, 1, index])
        self._key, self._more_key, self._part_key = [seed, 2, index], [seed, 6, index], [seed, 12, index]
        self._eye = inverse(placed.T_camera_world)[:3, 3]
        own = self._rng.normal(0.0, settings.known_clock_sd_s) if settings.known_clock_sd_s else 0.0
        count = max(0, int(np.ceil((duration_s - settings.phase_s) * settings.hz)))
        jitter = np.clip(self._rng.normal(0.0, 1.0, count), -2.5, 2.5) * settings.jitter_s
        times = settings.phase_s + np.arange(count) / settings.hz + jitter
        self._room_ns: Int64 = np.maximum(np.round(times * NS_PER_S), 0).astype(np.int64)
        self._lost: Bools = self._rng.random(count) < settings.lost
        self._clock_error_ns = round((own + settings.known_clock_s) * NS_PER_S)

    @property
    def name(self) -> str:
        """The camera's sensor name."""
        return self.placed.camera.name

    @property
    def kept(self) -> int:
        """Number of frames that are not lost."""
        return int((~self._lost).sum())

    def frames(self, since_ns: int = 0) -> Iterator[SimulatedKeypoints]:
        """Yield the frames that are not lost and arrive at ``since_ns``, room time, or later, in order of capture."""
        due_ns = self._room_ns + round(self.settings.latency_s * NS_PER_S)
        for sequence, k in enumerate(np.flatnonzero(~self._lost)):
            if due_ns[k] >= since_ns:
                yield self._frame(int(k), sequence)

    def bodies_at(self, time_ns: int) -> Float64:
        """Return the keypoints (bodies, 26, 3) of all bodies that it looks at, without mirror images, world [m].

        Args:
            time_ns: time on the camera's clock, as of a frame [ns].
        """
        settings = self.settings
        rate = 1 + 1e-6 * settings.clock_drift_ppm
        room_ns = round((time_ns - settings.clock_offset_s * NS_PER_S) / rate)
        return halpe_positions(self.room.motion.positions_at(room_ns))[self._looks_at()]

    @cached_property
    def _draws(self) -> _Draws:
        frames, bodies = len(self._room_ns), self._bodies
        data, hz = self.tables.data, self.settings.hz
        shape = (frames, bodies, len(HALPE))
        slow = np.sqrt(data.slow) * self._lasting((*shape, 2), data.slow_s * hz)
        error = slow + np.sqrt(1 - data.slow) * self._rng.standard_normal((*shape, 2))
        gap = self.settings.faults.missed_s * hz
        confidence, tail = (self._lasting(shape, data.slow_s * hz) for _ in range(2))
        missing, taken = (self._lasting(shape, gap) for _ in range(2))
        times = [
            self.settings.faults.mirrored_s * hz if name in ("mirrored", "legs") else gap for name in _PERSON_DRAWS
        ]
        person = np.stack([self._lasting((frames, bodies), time) for time in times], axis=-1)
        return _Draws(error, confidence, tail, missing, taken, person)

    @cached_property
    def _more_draws(self) -> _MoreDraws | None:
        """Random numbers of their own generator, so that scenes without these faults keep their bits."""
        faults, hz = self.settings.faults, self.settings.hz
        if not faults.noise_px + faults.exchanged_limbs + faults.unrelated_confidences > 0:
            return None
        shape, rng = (len(self._room_ns), self._bodies, len(HALPE)), np.random.default_rng(self._more_key)
        data, gap = self.tables.data, faults.missed_s * hz
        slow = np.sqrt(data.slow) * self._lasting((*shape, 2), data.slow_s * hz, rng)
        error_px = slow + np.sqrt(1 - data.slow) * rng.standard_normal((*shape, 2))
        unrelated, exchanged, limb = (self._lasting(some, gap, rng) for some in (shape, shape[:2], shape[:2]))
        return _MoreDraws(error_px, unrelated, exchanged, limb)

    @cached_property
    def _part_draws(self) -> PartDraws | None:
        """Random numbers of `keypoint_parts`, of their own generator; None without these faults."""
        faults = self.settings.faults
        if not faults.taken_limbs + faults.split + faults.snapped + faults.furniture > 0:
            return None
        rng, gap = np.random.default_rng(self._part_key), faults.missed_s * self.settings.hz
        frames, bodies = len(self._room_ns), self._bodies
        shape, places = (frames, bodies, len(HALPE)), int(rng.poisson(faults.furniture))
        snapped, where, person = (ndtr(self._lasting(some, gap, rng)) for some in (shape, shape, (frames, bodies, 3)))
        shapes = rng.normal(0.0, 0.06, (places, len(HALPE), 2))
        there = ndtr(self._lasting((frames, places), gap, rng))
        return PartDraws(snapped, where, person, rng.uniform(0.0, 1.0, (places, 3)), shapes, there)

    def _lasting(self, shape: tuple[int, ...], frames: float, rng: np.random.Generator | None = None) -> Float64:
        """Gaussian numbers with a time constant in frames along the first axis."""
        white = (rng or self._rng).standard_normal(shape)
        kept = float(np.exp(-1.0 / max(frames, 1e-3)))
        if len(white) < 2:
            return white
        white[1:] *= np.sqrt(1 - kept**2)
        for k in range(1, len(white)):
            white[k] += kept * white[k - 1]
        return white

    @cached_property
    def _bodies(self) -> int:
        return len(self.room.numbers) * (1 + len(self.room.mirrors.get(self.name, ())))

    def _frame(self, k: int, sequence: int) -> SimulatedKeypoints:
        room_ns, settings = int(self._room_ns[k]), self.settings
        joints = self.room.motion.positions_at(room_ns)
        later = self.room.motion.positions_at(room_ns + round(self.placed.camera.readout_s * NS_PER_S))
        seen, numbers = self._look(joints, later)
        rng = np.random.default_rng([*self._key, k])
        pixels, confidences, owners, mirrored = self._detect(k, seen, numbers, rng)
        order = rng.permutation(len(owners))
        pixels, confidences = self._in_topology(pixels[order], confidences[order])
        real = self.room.numbers >= 0
        count = len(self.room.numbers)
        drift = 1 + 1e-6 * settings.clock_drift_ppm
        frame = keypoint_frame(
            self.name, self.topology, time_ns=round((room_ns * drift) + settings.clock_offset_s * NS_PER_S),
            size_px=self.placed.camera.size_px, positions_px=pixels, confidences=confidences, sequence=sequence,
        )  # fmt: skip
        return SimulatedKeypoints(
            frame, room_ns + self._clock_error_ns, room_ns + round(settings.latency_s * NS_PER_S), room_ns,
            self.room.numbers[real], halpe_positions(joints)[real],
            (seen.inside & (seen.states == 0))[:count][real], owners[order], mirrored[order],
        )  # fmt: skip

    def _look(self, joints: Float64, later: Float64) -> tuple[_Bodies, Int64]:
        """The bodies in the image, mirror images after all others, and their numbers."""
        numbers = self.room.numbers
        parts = [self._seen(joints, later, self._eye)]
        for point, normal in self.room.mirrors.get(self.name, ()):
            eye = _reflected(self._eye[None], point, normal)[0]
            image = self._seen(
                _reflected(joints, point, normal), _reflected(later, point, normal), self._eye, joints, eye
            )
            parts.append(image)
            numbers = np.concatenate([numbers, np.full(len(self.room.numbers), PHANTOM)])
        return _Bodies(
            *(np.concatenate(rows) for rows in zip(*map(msgspec.structs.astuple, parts), strict=True))
        ), numbers

    def _seen(
        self, joints: Float64, later: Float64, eye: Float64, real: Float64 | None = None, behind: Float64 | None = None
    ) -> _Bodies:
        """Look at bodies; mirror images are hidden as their bodies ``real`` are from the mirrored lens ``behind``."""
        camera, T = self.placed.camera, self.placed.T_camera_world
        mirrored = real is not None
        keypoints = detected_positions(joints[:, _SWAPPED] if mirrored else joints, self.topology.name)
        first = apply(T, keypoints)
        pixels = project(first, camera.lens)
        if camera.readout_s > 0:
            after = detected_positions(later[:, _SWAPPED] if mirrored else later, self.topology.name)
            row = np.clip(np.nan_to_num(pixels[..., 1:]) / camera.size_px[1], 0.0, 1.0)
            pixels = project((1 - row) * first + row * apply(T, after), camera.lens)
        width, height = camera.size_px
        inside = (pixels >= -0.5).all(axis=-1) & (pixels[..., 0] < width - 0.5) & (pixels[..., 1] < height - 0.5)
        inside &= (first[..., 2] > 0.2) & self._looks_at()[:, None]
        depths = first[:, HALPE.index("Hip"), 2]
        lengths = self.room.motion.lengths
        stature = lengths.sum(axis=1) / _LENGTHS_OF_STATURE
        sizes = camera.lens[0] * stature / np.maximum(depths, 0.2)
        states = self._states(joints if real is None else real, eye if behind is None else behind)
        if real is not None:
            states = states[:, _MIRROR]
        ahead = head_axes(joints)[:, 2] * (1 if real is None else -1)
        towards = np.einsum("ij,ij->i", ahead, normalised(eye - joints[:, 0]))
        return _Bodies(pixels, inside, states, sizes, depths, towards)

    def _looks_at(self) -> Bools:
        return np.array([not names or self.name in names for names in self.room.seen_by])

    def _states(self, joints: Float64, eye: Float64) -> Int64:
        """Index in `keypoint_errors.STATES` of each keypoint (bodies, 26); bodies of other cameras hide nothing."""
        radii, place = self.room.motion.radii * self._looks_at()[:, None], hiding_joint()
        whole = hidden(eye, joints, radii, self.room.obstacles)[:, place]
        alone = [hidden(eye, joints[i : i + 1], radii[i : i + 1], _NOTHING)[0] for i in range(len(joints))]
        own = np.array(alone).reshape(len(joints), -1)[:, place] | face_hidden(joints, eye)
        return np.where(own, 1, np.where(whole, 2, 0))

    def _detect(
        self, k: int, seen: _Bodies, numbers: Int64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, Int64, Bools]:
        """Detections in Halpe's order: pixels (n, 26, 2), confidences (n, 26), owners and swaps (n,)."""
        faults = self.settings.faults
        chance = ndtr(self._draws.person[k])
        share = (seen.inside & (seen.states == 0)).sum(axis=1) / np.maximum(seen.inside.sum(axis=1), 1)
        missed = np.array(faults.missed)[np.minimum((4 * share).astype(np.int64), 3)]
        there = seen.inside.any(axis=1) & (seen.sizes >= faults.least_px) & (chance[:, 0] >= missed)
        pixels, confidences = self._noisy(k, seen)
        swapped = chance[:, 1] < np.array(faults.mirrored)[_view(seen.towards)]
        legs = chance[:, 2] < faults.legs_mirrored
        for i in np.flatnonzero(swapped):
            pixels[i], confidences[i] = pixels[i][_MIRROR], confidences[i][_MIRROR]
        for i in np.flatnonzero(legs):
            order = np.where(LEGS, _MIRROR, np.arange(len(HALPE)))
            pixels[i], confidences[i] = pixels[i][order], confidences[i][order]
        self._exchange_limbs(k, seen, there, pixels, confidences)
        parts = self._part_draws
        if parts is not None:
            take_limbs(parts, k, faults, pixels, confidences, true=seen.pixels, sizes=seen.sizes, there=there)
        self._merge(seen, chance[:, 3] < faults.merged, there, pixels, confidences)
        found = np.flatnonzero(there & np.isfinite(pixels[..., 0]).any(axis=1))
        more = self._parts(k, found, numbers, pixels, confidences)
        rows, sure, owners = [pixels[found], more[0]], [confidences[found], more[1]], [numbers[found], more[2]]
        flags = [(swapped | legs)[found], np.zeros(len(more[2]), dtype=np.bool_)]
        for i in found[chance[found, 4] < faults.duplicates]:
            half = _LOWER if rng.random() < 0.5 else ~_LOWER
            again = np.where(half[:, None], pixels[i] + rng.normal(0, 0.015 * seen.sizes[i], (len(HALPE), 2)), np.nan)
            rows.append(again[None])
            sure.append((0.7 * confidences[i])[None])
            owners.append(numbers[i : i + 1])
            flags.append(np.zeros(1, dtype=np.bool_))
        for _ in range(rng.poisson(faults.false_per_image)):
            one, confidence = self._nobody(seen, rng)
            rows.append(one[None])
            sure.append(confidence[None])
            owners.append(np.array([PHANTOM]))
            flags.append(np.zeros(1, dtype=np.bool_))
        return np.concatenate(rows), np.concatenate(sure), np.concatenate(owners), np.concatenate(flags)

    def _parts(
        self, k: int, found: Int64, numbers: Int64, pixels: Float64, confidences: Float64
    ) -> tuple[Float64, Float64, Int64]:
        """Detections of second parts of people, and of furniture: pixels, confidences and owners; see `keypoint_parts`.

        The legs of people in two parts are taken out of ``pixels`` and ``confidences``.
        """
        draws, made, owners = self._part_draws, list[tuple[Float64, Float64]](), list[int]()
        if draws is not None:
            halves = split(draws, k, self.settings.faults, found)
            made = [lower_part(pixels[i], confidences[i]) for i in halves]
            things = furniture(draws, k, self.placed.camera.size_px, _UPRIGHT)
            owners = [*numbers[halves].tolist(), *[PHANTOM] * len(things)]
            made += things
        places = np.array([one for one, _ in made]).reshape(len(made), len(HALPE), 2)
        sure = np.array([one for _, one in made]).reshape(len(made), len(HALPE))
        return places, sure, np.array(owners, dtype=np.int64)

    def _noisy(self, k: int, seen: _Bodies) -> tuple[Float64, Float64]:
        """Keypoints with errors, and their confidences; NaN and 0 where not reported."""
        tables, faults, draws = self.tables, self.settings.faults, self._draws
        group = np.broadcast_to(group_of(), seen.states.shape)
        confidences = tables.confidences(seen.states, group, ndtr(draws.confidence[k]))
        bins = bin_of(np.maximum(confidences, 1e-6))
        tail = ndtr(draws.tail[k]) < tables.tail_share[seen.states, bins]
        sd = tables.core[group, bins] * np.where(tail, tables.data.tail_ratio, 1.0) * faults.noise
        sd = sd * np.where(seen.states > 0, faults.hidden_noise, 1.0)
        front = self._front(seen)
        some = ndtr(draws.taken[k]) < faults.taken
        taken = (seen.states == 2) & some & np.isfinite(front[..., 0])  # the same keypoint of the person in front
        at = np.where(taken[..., None], front, seen.pixels)
        if self._part_draws is not None:
            snap(self._part_draws, k, faults, np.where(taken, 0, seen.states), at)
        pixels = at + draws.error[k] * (sd * seen.sizes[:, None])[..., None]
        more = self._more_draws
        if more is not None:
            pixels = pixels + faults.noise_px * more.error_px[k]
            unrelated, share = ndtr(more.unrelated[k]), faults.unrelated_confidences
            confidences = np.where(unrelated < share, unrelated / max(share, 1e-9), confidences)
        if faults.step_px > 0:
            pixels = np.round(pixels / faults.step_px) * faults.step_px
        absent = tables.missing[seen.states, group] if faults.noise > 0 else np.zeros(seen.states.shape)
        absent = np.where(seen.states > 0, np.maximum(absent, faults.hidden_missing), absent)
        gone = (draws.missing[k] < ndtri(np.clip(absent, 0.0, 1.0))) | ~seen.inside
        pixels[gone] = np.nan
        return pixels, np.where(gone, 0.0, np.clip(confidences, 0.01, 1.0))

    def _front(self, seen: _Bodies) -> Float64:
        """Keypoints (bodies, 26, 2) of the nearest body in the image among those in front of each; NaN without one."""
        offsets = np.nan_to_num(seen.pixels[:, None] - seen.pixels[None], nan=1e6)
        apart = np.linalg.norm(offsets, axis=-1).mean(axis=-1)
        apart = np.where(seen.depths[None] < seen.depths[:, None] - 0.05, apart, np.inf)
        nearest = np.argmin(apart, axis=1)
        found = np.isfinite(apart[np.arange(len(apart)), nearest])
        return np.where(found[:, None, None], seen.pixels[nearest], np.nan)

    def _exchange_limbs(self, k: int, seen: _Bodies, there: Bools, pixels: Float64, confidences: Float64) -> None:
        """Exchange an arm or a leg of two people who are close in the image."""
        more, faults = self._more_draws, self.settings.faults
        if more is None:
            return
        for i in np.flatnonzero(there & (ndtr(more.exchanged[k]) < faults.exchanged_limbs)):
            apart = np.linalg.norm(np.nan_to_num(seen.pixels - seen.pixels[i], nan=1e6), axis=-1).mean(axis=1)
            apart[i] = np.inf
            apart[~there] = np.inf
            j = int(np.argmin(apart))
            if not apart[j] < REACH * seen.sizes[i]:
                continue
            limb = LIMBS[min(int(ndtr(more.limb[k, i]) * len(LIMBS)), len(LIMBS) - 1)]
            for values in (pixels, confidences):
                values[i, limb], values[j, limb] = values[j, limb].copy(), values[i, limb].copy()

    def _merge(self, seen: _Bodies, may: Bools, there: Bools, pixels: Float64, confidences: Float64) -> None:
        """Give the legs of the person behind to the one in front, and drop the one behind, where both are close."""
        for i in np.flatnonzero(may & there):
            for j in np.flatnonzero(there):
                if j == i or seen.depths[j] < seen.depths[i]:
                    continue
                apart = np.linalg.norm(seen.pixels[i] - seen.pixels[j], axis=-1)
                if np.nanmean(apart) < _CLOSE * seen.sizes[i]:
                    pixels[i][LEGS], confidences[i][LEGS] = pixels[j][LEGS], confidences[j][LEGS]
                    there[j] = False
                    break

    def _nobody(self, seen: _Bodies, rng: np.random.Generator) -> tuple[Float64, Float64]:
        """A false detection: keypoints at random about a random place."""
        width, height = self.placed.camera.size_px
        size = rng.uniform(0.1, 0.6) * height
        shape = _UPRIGHT * size + rng.normal(0, 0.05 * size, (len(HALPE), 2))
        pixels = rng.uniform(0, 1, 2) * (width, height) + shape
        outside = (pixels < 0).any(axis=1) | (pixels >= (width, height)).any(axis=1) | (rng.random(len(HALPE)) < 0.4)
        pixels[outside] = np.nan
        return pixels, np.where(outside, 0.0, rng.uniform(*_FALSE_CONFIDENCE, len(HALPE)))

    def _in_topology(self, pixels: Float64, confidences: Float64) -> tuple[Float64, Float64]:
        """Keypoints in the frame's topology; a mean of keypoints is missing if one of them is."""
        there = confidences > 0
        whole = ~((~there).astype(np.float64) @ (self._weights > 0).T > 0)
        out = np.einsum("kj,njc->nkc", self._weights, np.nan_to_num(pixels))
        sure = confidences @ self._weights.T
        return np.where(whole[..., None], out, np.nan), np.where(whole, np.clip(sure, 0.0, 1.0), 0.0)


def _view(towards: Float64) -> Int64:
    """0 for a person seen from the front, 1 from the side, 2 from the back."""
    return np.where(towards > 0.5, 0, np.where(towards < -0.5, 2, 1))


def _reflected(points: Float64, point: Float64, normal: Float64) -> Float64:
    """Mirror images of points (..., 3) in a plane."""
    return np.asarray(points - 2 * np.einsum("...i,i->...", points - point, normal)[..., None] * normal)


_SWAPPED: Final = np.array(BODY.mirror)
_NOTHING: Final = obstacles((), ())
_REST: Final = body_template().chain @ body_template().offsets
_UPRIGHT: Final = -halpe_positions(_REST)[:, :2]
"""Keypoints (26, 2) of a standing person in an image, relative to the stature."""
_LENGTHS_OF_STATURE: Final = float(np.linalg.norm(body_template().offsets, axis=1).sum())
