"""Detections of named points in one camera's images, as other programs' files have them, and their conversion.

A file has neither the camera's image size nor, in most formats, times: the rig and the user state them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.decoding import check_filled
from mocapella.errors import InputError, one_of
from mocapella.model.keypoints import NO_ID, KeypointFrame, keypoint_frame
from mocapella.model.point_tracks import ImageTracks
from mocapella.model.topology import Topology, topology, topology_names
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MOST_PEOPLE: Final = 1024
"""Largest number of detections in an image, as in messages."""
MOST_PX: Final = 131_072.0
"""Largest absolute coordinate of a point, as in messages [px]."""
LEAST_SHARED: Final = 8
"""Least number of points whose names are a topology's, for the points to be a person's keypoints."""
ORDERS: Final = {
    "BODY_25B": "body_25b", "BODY_25": "body_25", "COCO_17": "coco_17", "COCO_18": "coco_18", "HALPE_26": "halpe_26",
    "HALPE_136": "halpe_136", "COCO_133": "coco_wholebody_133", "BLAZEPOSE": "mediapipe_pose",
}  # fmt: skip
"""Topologies of points without names, by the name of the order."""
AUTO: Final = "auto"
"""Order that follows from the number of points, and of 25 points from where they are."""
_LEAST_SIZE_PX: Final = 15.0
"""Least size of a detection that tells the order of its points [px]."""
_FACE_SHARE: Final = 0.2
"""Share of a person's size below which the second to the fifth point are in the face: a face is about 0.1 of the
stature wide, a neck and an arm are about 0.35 long [ratio]."""
_BASE_NS: Final = 1_000_000_000
"""Time of frame 0 [ns]; frames need a time above 0."""


class Detections(msgspec.Struct, frozen=True, eq=False):
    """All detections in one image.

    Attributes:
        positions_px: (detections, points, 2) x, y [px]; NaN where not seen.
        confidences: (detections, points) 0 to 1; 0 where not seen.
        ids: (detections,) the program's ids in this camera; `NO_ID` where it has none.
    """

    positions_px: Float64
    confidences: Float64
    ids: Int64


class CameraDetections(msgspec.Struct, frozen=True, eq=False):
    """The detections in the images of one camera.

    Attributes:
        camera: name of the camera, as the folder or file has it.
        points: names of the points.
        topology: topology of the points if they are a person's; None for other points, such as an animal's.
        individuals: names of the individuals by id; empty if the ids have no names.
        numbers: (frames,) numbers of the frames, ascending.
        at_s: (frames,) capture times on the camera's own clock [s]; NaN if not in the file.
        frames: the detections of each frame.
        notes: sentences for the user about omissions and choices in reading the files.
    """

    camera: str
    points: tuple[str, ...]
    topology: Topology | None
    individuals: tuple[str, ...]
    numbers: Int64
    at_s: Float64
    frames: tuple[Detections, ...]
    notes: tuple[str, ...] = ()


def no_detections(points: int) -> Detections:
    """Return the detections of an image without any."""
    return Detections(np.empty((0, points, 2)), np.empty((0, points)), np.empty(0, np.int64))


def detections(values: Float64, ids: Sequence[int] | Int64 | None = None) -> Detections:
    """Return detections of x, y and confidence (detections, points, 3); a detection without any seen point is left out.

    A point is not seen if a value is not finite or the confidence is not above 0. Confidences above 1 become 1.
    """
    seen = np.isfinite(values).all(axis=-1) & (values[..., 2] > 0)
    kept = seen.any(axis=-1)
    own = np.full(len(values), NO_ID, np.int64) if ids is None else np.asarray(ids, dtype=np.int64)
    return Detections(
        np.where(seen[..., None], values[..., :2], np.nan)[kept],
        np.where(seen, np.minimum(values[..., 2], 1.0), 0.0)[kept], own[kept],
    )  # fmt: skip


def check_detections(values: Float64, *, file: object, field: str) -> None:
    """Check the number of detections in an image and the range of their coordinates.

    Args:
        values: (detections, points, 3) x, y [px] and confidence.
        file, field: named in errors.

    Raises:
        InputError: there are more than `MOST_PEOPLE`, or a coordinate is beyond ±`MOST_PX`.
    """
    if len(values) > MOST_PEOPLE:
        raise InputError(
            "too many people in an image", file=file, field=field, value=len(values), fix=f"at most {MOST_PEOPLE}"
        )
    with np.errstate(invalid="ignore"):
        far = np.abs(values[..., :2]) > MOST_PX
    if far.any():
        raise InputError(
            "not a place in an image", file=file, field=field, value=float(values[..., :2][far][0]),
            fix=f"coordinates within ±{MOST_PX:g} px",
        )  # fmt: skip


def topology_by_count(count: int, order: str, sample: Float64, *, file: object, field: str | None = None) -> Topology:
    """Return the topology of points without names.

    Args:
        count: number of the points.
        order: declared order, a key of `ORDERS` in any case, or `AUTO`.
        sample: (detections, points, 3) some detections, to tell the two orders of 25 points apart.
        file, field: named in errors.

    Raises:
        InputError: the points are not as many as the declared order has, no topology has as many, or 25 points are in
            another order than declared; names what would have worked.
    """
    declared = ORDERS.get(order.upper())
    if declared is None and order != AUTO:
        known = one_of(order, (AUTO, *ORDERS))
        raise InputError(
            f"no order of keypoints is called {order!r}", file=file, fix=f"give --set order= one of {known}"
        )
    sizes = {name: len(topology(known)) for name, known in ORDERS.items()}
    fitting = [name for name, size in sizes.items() if size == count]
    if not fitting:
        counts = ", ".join(f"{name} ({size})" for name, size in sizes.items())
        raise InputError(
            f"no known set of keypoints has {count} points", file=file, field=field, value=count,
            fix=f"give one of {counts}",
        )  # fmt: skip
    if declared is not None and order.upper() not in fitting:
        raise InputError(
            f"has {count} points, and the order {order.upper()} has {sizes[order.upper()]}", file=file, field=field,
            value=count, fix=f"leave the order out, or give {' or '.join(fitting)}",
        )  # fmt: skip
    if count == 25 and (seen := order_of_25(sample)) is not None:
        if declared is not None and seen != order.upper():
            raise InputError(
                f"the points are not in the order {order.upper()}: by their places it is {seen}", file=file,
                fix=f"leave the order out, or give {seen}",
            )  # fmt: skip
        return topology(ORDERS[seen])
    return topology(declared or ORDERS[fitting[0]])


def order_of_25(sample: Float64) -> str | None:
    """Return whether 25 points are in the order BODY_25 or BODY_25B, by their places; None if that cannot be told.

    In BODY_25 the second point, the neck, is halfway between the third and the sixth, the shoulders, from any side; in
    BODY_25B these three are the eyes and the left shoulder. Where shoulders are too narrow in the images, the second to
    the fifth point tell: BODY_25B's are close together, in the face, and BODY_25's are the neck and an arm.

    Args:
        sample: (detections, 25, 3) x, y [px] and confidence.
    """
    seen = (sample[:, [1, 2, 5], 2] > 0.2).all(axis=-1)
    second, third, sixth = (sample[seen, k, :2] for k in (1, 2, 5))
    width = np.linalg.norm(third - sixth, axis=-1)
    wide = width > 20.0
    if wide.sum() >= 3:
        off = np.linalg.norm(second - (third + sixth) / 2, axis=-1)[wide] / width[wide]
        return "BODY_25" if float(np.median(off)) < 0.25 else "BODY_25B"
    there = sample[..., 2] > 0.2
    places = np.where(there[..., None], sample[..., :2], np.nan)[there[:, 1:5].sum(axis=1) >= 3]
    if len(places) < 3:
        return None
    spread, size = (np.linalg.norm(np.nanmax(some, axis=1) - np.nanmin(some, axis=1), axis=-1)
                    for some in (places[:, 1:5], places))  # fmt: skip
    if not (size > _LEAST_SIZE_PX).sum() >= 3:
        return None
    share = float(np.median((spread / np.maximum(size, 1e-9))[size > _LEAST_SIZE_PX]))
    return "BODY_25B" if share < _FACE_SHARE else "BODY_25"


def topology_by_names(points: Sequence[str]) -> tuple[Topology, tuple[int, ...]] | None:
    """Return the topology that has joints of these names, and the joint of each point; None if there is none.

    Names are compared without case and punctuation. Of several topologies, the one with the fewest joints is returned.
    """
    plain = [_plain(name) for name in points]
    if len(plain) < LEAST_SHARED or len(set(plain)) < len(plain):
        return None
    found = []
    for name in topology_names():
        one = topology(name)
        joints = {_plain(joint): i for i, joint in enumerate(one.joints)}
        if "halpe_26" in (name, *one.mappings) and all(point in joints for point in plain):
            found.append((one, tuple(joints[point] for point in plain)))
    return min(found, key=lambda pair: len(pair[0]), default=None)


def in_topology(points: Sequence[str], frames: Sequence[Detections]) -> tuple[
    tuple[str, ...], Topology | None, tuple[Detections, ...]
]:  # fmt: skip
    """Return points with names in the order of a topology that has them; unchanged, with None, if none has.

    Returns:
        The names, the topology or None, and the frames with the columns of these names.
    """
    named = topology_by_names(points)
    if named is None:
        return tuple(points), None, tuple(frames)
    own, places = named
    made = []
    for frame in frames:
        positions = np.full((len(frame.ids), len(own), 2), np.nan)
        confidences = np.zeros((len(frame.ids), len(own)))
        positions[:, list(places)], confidences[:, list(places)] = frame.positions_px, frame.confidences
        made.append(Detections(positions, confidences, frame.ids))
    return own.joints, own, tuple(made)


def keypoint_frames(
    found: CameraDetections, sensor: str, size_px: tuple[int, int], rate_hz: float | None = None
) -> list[KeypointFrame]:
    """Return the frames of a camera, in the order of their times.

    Args:
        found: the camera's detections, of people.
        sensor: name of the camera in the rig.
        size_px: (width, height) of its images.
        rate_hz: rate that the frames' numbers follow [Hz]; None for the times of the file.

    Raises:
        InputError: the points are no person's, or there is no rate and the file has no rising times.
        SettingsError: the rate is not above 0.
    """
    check(rate_hz is None or 0 < rate_hz < 1e6, "fps", rate_hz, "above 0 and below 1000000")
    if found.topology is None:
        raise InputError("the points are no person's keypoints", file=found.camera, fix="triangulate them as points")
    at_s = found.at_s if rate_hz is None else found.numbers / rate_hz
    if not np.isfinite(at_s).all():
        raise InputError("the files have no times", file=found.camera, fix="give the frame rate with --fps")
    if (np.diff(at_s) <= 0).any():
        raise InputError("the times of the frames do not rise", file=found.camera, fix="give the frame rate with --fps")
    return [
        keypoint_frame(
            sensor, found.topology, time_ns=_BASE_NS + round(float(at) * NS_PER_S), size_px=size_px,
            positions_px=frame.positions_px, confidences=frame.confidences, ids=frame.ids, sequence=number,
        )
        for number, (at, frame) in enumerate(zip(at_s, found.frames, strict=True))
    ]  # fmt: skip


def image_tracks(cameras: Sequence[CameraDetections], *, file: object = None) -> ImageTracks:
    """Return the points of several cameras as tracks of named points.

    Of individuals with names, each has points of its own, ``NAME.POINT``. Of several detections without, the one with
    the largest sum of confidences is used, with a note.

    Raises:
        InputError: the cameras' points would need a far larger table than their number.
    """
    points = tuple(dict.fromkeys(point for one in cameras for point in one.points))
    individuals = tuple(dict.fromkeys(name for one in cameras for name in one.individuals))
    alone = len(individuals) <= 1
    names = points if alone else tuple(f"{name}.{point}" for name in individuals for point in points)
    frames = sorted({int(number) for one in cameras for number in one.numbers})
    row_of = {number: i for i, number in enumerate(frames)}
    shape = (len(frames), len(cameras), len(names))
    check_filled(math.prod(shape), sum(frame.confidences.size for one in cameras for frame in one.frames), file=file)
    pixels, confidences = np.full((*shape, 2), np.nan), np.zeros(shape)
    at_s = np.full(shape[:2], np.nan)
    several = 0
    for k, one in enumerate(cameras):
        own = [points.index(point) for point in one.points]
        for number, at, frame in zip(one.numbers, one.at_s, one.frames, strict=True):
            row = row_of[int(number)]
            at_s[row, k] = at
            if alone:
                several += len(frame.ids) > 1
                best = [int(frame.confidences.sum(axis=1).argmax())] if len(frame.ids) else []
                places = dict.fromkeys(best, 0)
            else:
                places = {i: individuals.index(one.individuals[j]) for i, j in enumerate(frame.ids)}
            for i, individual in places.items():
                columns = [individual * len(points) + column for column in own]
                pixels[row, k, columns], confidences[row, k, columns] = frame.positions_px[i], frame.confidences[i]
    notes = [f"{several} images have more than one person: the most confident of each was used"] if several else []
    missing = len(frames) * len(cameras) - sum(len(one.numbers) for one in cameras)
    notes += [f"{missing} frames are missing in some camera"] if missing else []
    notes += dict.fromkeys(note for one in cameras for note in one.notes)
    return ImageTracks(
        tuple(one.camera for one in cameras), names, np.array(frames, np.int64), at_s, pixels, confidences,
        tuple(notes),
    )  # fmt: skip


def by_frame(
    camera: str, points: Sequence[str], rows: Mapping[int, Detections], *, individuals: Sequence[str] = (),
    own: Topology | None = None, times_s: Mapping[int, float] | None = None, notes: Sequence[str] = (),
) -> CameraDetections:  # fmt: skip
    """Return a camera's detections by number of the frame; the names tell the topology if ``own`` is None."""
    numbers = sorted(rows)
    frames = tuple(rows[number] for number in numbers)
    names: tuple[str, ...] = tuple(points)
    if own is None:
        names, own, frames = in_topology(points, frames)
    at_s = np.array([(times_s or {}).get(number, np.nan) for number in numbers], dtype=np.float64)
    return CameraDetections(
        camera, names, own, tuple(individuals), np.array(numbers, dtype=np.int64), at_s, frames, tuple(notes)
    )


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
