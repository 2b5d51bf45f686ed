"""Bodies followed through the videos of several cameras, or live: what the command and the demo do, frame by frame.

Images in which nothing is to be seen do not count, and why is said; where somebody is not there yet, or not any more,
the body waits where it starts or was last, at rest, and goes on when somebody is there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.visual_cones import doubts, meetings
from mocapella.conventions import NS_PER_S
from mocapella.kinematics.silhouette_fit import eye, within
from mocapella.live.silhouette_tally import STEP_MS, BodyTally, Counted
from mocapella.model.camera import CameraRig
from mocapella.model.outline_colours import Colour, body_colour
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.silhouettes import Silhouette, overlap
from mocapella.model.twist_tree import TreePose
from mocapella.recording.followed_bodies import ALONE, FollowedFrame, frame_of
from mocapella.sensing.empty_room import EmptyRoom, MovedSince
from mocapella.sensing.outline_picture import Outlines, outlined
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.silhouette_camera import SeenIn
from mocapella.tracker.silhouette_people import SilhouettePeople
from mocapella.tracker.silhouette_return import place_again
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouettes import Followed

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]
Say = Callable[[str], None]

SEEN_FROM: Final = 0.5
"""Overlap of the outlines from which on a camera sees the body that is meant."""
HIDDEN_FROM: Final = 0.7
"""Share of what a body covers from which on, others being there, a camera says nothing of it."""
STANDS_OUT: Final = 0.3
"""Share of what was taken for the body that has to be unlike the empty room."""
DOUBTED_BELOW: Final = 0.4
"""Overlap of the body and of what is not in the empty room, below which a camera's video is doubted."""
MOVES_WITH: Final = 0.85
"""Share of what moves that has to be where the body is."""
SAID_AFTER: Final = 3
"""Frames in a row in which a camera does not count."""
LOST_AFTER_S: Final = 0.5
"""Without being seen for so long, nobody is there."""
JUDGED_BY: Final = 5
"""Images of a camera in which something has moved: later ones may show what has nothing to do with the body."""
NO_PICTURE: Final = "it gives no picture"


class PersonStep(msgspec.Struct, frozen=True, eq=False):
    """One body in one frame.

    Attributes:
        followed: what the tracker says.
        row: as the file has it.
        waits: by camera, what the body covers where it waits; nothing while somebody is there.
    """

    followed: Followed
    row: FollowedFrame
    waits: Mapping[str, Silhouette] = {}

    def outlines(self, camera: str, colour: Colour) -> Outlines | None:
        """To be drawn in a camera's image; None where the body is not in it."""
        if self.row.lost:
            place = self.waits.get(camera)
            return None if place is None else Outlines(place, place, colour)
        seen = self.followed.seen.get(camera)
        return None if seen is None else Outlines(seen.contour, seen.outline.silhouette, colour)


class Step(msgspec.Struct, frozen=True, eq=False):
    """One frame and what came of it.

    Attributes:
        frame: its number.
        images: (height, width, 3) BGR by camera; those that there are.
        people: by name.
        took_s: how long the tracker took.
    """

    frame: int
    images: Mapping[str, UInt8]
    people: Mapping[str, PersonStep]
    took_s: float

    def pictures(self, width: int | None = None) -> dict[str, UInt8]:
        """Each camera's image with the outlines drawn in, so many pixels wide; as it is without ``width``."""
        return {name: outlined(image, self._outlines(name), width) for name, image in self.images.items()}

    def _outlines(self, camera: str) -> list[Outlines]:
        drawn = [one.outlines(camera, body_colour(k)) for k, one in enumerate(self.people.values())]
        return [one for one in drawn if one is not None]


class _Person:
    """What a run knows of a body besides its rows."""

    def __init__(self, mesh: RiggedMesh) -> None:
        self.mesh = mesh
        self.lost = False
        self.came = True
        self.seen_ns = 0
        self.well: Followed | None = None
        self.waits: tuple[TreePose, dict[str, Silhouette]] | None = None
        self.whole_in = 0
        self.placed = True

    def start(self, found: Followed, whole_in: int) -> None:
        """It is there; all of it is in the images of so many cameras."""
        self.well, self.whole_in, self.seen_ns, self.lost = found, whole_in, found.time_ns, False

    def away(self, time_ns: int) -> bool:
        """Whether nobody has been seen who is meant, for so long that nobody is there."""
        return (self.lost and time_ns > self.seen_ns) or time_ns - self.seen_ns >= LOST_AFTER_S * NS_PER_S


class SilhouetteRun:
    """Bodies from their first poses on.

    Args:
        meshes: of the bodies, by name; `ALONE` for one that nobody named.
        rig: of the cameras, for images of their size.
        settings: of the tracker.
        say: is told what happens.

    Attributes:
        frames: how many so far.
        tallies: what they came to, by name; the rows themselves are the steps', and nothing here keeps them.
        took_ms: of the frames.
        notes: all that was said.
        empty: the room without anybody, as far as it is known.
    """

    def __init__(
        self,
        meshes: Mapping[str, RiggedMesh],
        rig: CameraRig,
        settings: SilhouetteSettings | None = None,
        say: Say = lambda _text: None,
    ) -> None:
        self.meshes, self.rig = meshes, rig
        self.tracker = SilhouettePeople(meshes, rig, settings)
        self.frames, self.took_ms = 0, Counted(STEP_MS)
        self.tallies = {name: BodyTally() for name in meshes}
        self.notes: list[str] = []
        self._tell = say
        self._eyes = {name: eye(placed) for name, placed in rig.cameras.items()}
        self._people = {name: _Person(mesh) for name, mesh in meshes.items()}
        self._trouble: dict[tuple[str, str], tuple[int, int]] = {}
        self.empty = EmptyRoom()
        self._moved, self._shares = MovedSince(), dict[str, list[float]]()
        self._doubted = False

    def start(self, poses: Mapping[str, TreePose], time_ns: int) -> None:
        """All are about there at that time, which is an interval before the first frame's.

        Raises:
            SettingsError: no camera sees one of them there.
        """
        for name, pose in poses.items():
            self.tracker.start(name, pose, time_ns)
            landmarks = landmarks_at(self.meshes[name], pose)
            found = Followed(time_ns, pose, landmarks, {}, {})
            self._people[name].start(found, self._whole_in(landmarks, self.rig.cameras))

    def wait(self) -> None:
        """Nobody is there yet: they are looked for as those are who left. After `start`.

        The empty room should be known: without it, whatever is there is taken for somebody.
        """
        for person in self._people.values():
            person.lost, person.came = True, False

    def learn_empty(self, images: Mapping[str, UInt8]) -> None:
        """Nobody is in these images (height, width, 3), by camera. After `start`."""
        self.tracker.learn_background(images)
        self.empty.learn(images)

    def steps(self, frames: Iterable[FrameSet]) -> Iterator[Step]:
        """Each frame when it is done."""
        for shown in frames:
            yield self.step(shown)

    def step(self, shown: FrameSet) -> Step:
        """The next frame."""
        frame, images = shown.frame, shown.images
        begin_s = time.perf_counter()
        waiting = [name for name, person in self._people.items() if person.lost]
        raw = self.tracker.update(images, shown.time_ns, waiting)
        took_s = time.perf_counter() - begin_s
        missing = {camera: NO_PICTURE for camera in self.rig.cameras if camera not in images}
        raw = {name: msgspec.structs.replace(one, left_out={**one.left_out, **missing}) for name, one in raw.items()}
        for name, one in raw.items():
            self._look_for(name, one, images)
        self._learn_empty(raw, images)
        people = {}
        for name, one in raw.items():
            found, lost = self._held(name, one, images)
            self._say_lost(name, frame, lost=lost)
            row = frame_of(
                frame,
                shown.time_ns / NS_PER_S,
                found.pose,
                joint_names=self.meshes[name].joint_names,
                landmarks=dict(zip(self.meshes[name].landmarks, found.landmarks, strict=True)),
                overlap={camera: seen.overlap for camera, seen in found.seen.items()},
                left_out=found.left_out,
                lost=lost,
            )
            self.tallies[name].add(row)
            people[name] = PersonStep(found, row, self._waits(name, found.pose) if lost else {})
        self._say_changes(frame, people)
        self.frames += 1
        self.took_ms.add(1e3 * took_s)
        self._judge_rig({name: one.followed for name, one in people.items()}, images)
        return Step(frame, images, people, took_s)

    def _look_for(self, name: str, found: Followed, images: Mapping[str, UInt8]) -> None:
        """Whether somebody is seen who is meant, and so well that the body can wait there.

        Where it waits, two cameras have seen it; one alone would soon take anything for it. Of who comes back all has
        to be there, if it ever was, and where the empty room says that somebody is: legs alone are soon lost again.
        """
        person, enough, others = self._people[name], min(2, len(self.rig.cameras)), self.tracker.others[name]
        good = sum(self._sees(one, images[k], k, others.get(k)) for k, one in found.seen.items())
        whole = self._whole_in(found.landmarks, found.seen)
        if good >= enough and not person.lost and whole >= enough:
            person.well, person.whole_in = found, whole
        again = good >= enough and whole >= min(enough, person.whole_in) and person.placed
        if again if person.lost else good >= 1:
            person.seen_ns = found.time_ns

    def _learn_empty(self, found: Mapping[str, Followed], images: Mapping[str, UInt8]) -> None:
        """Take in what a camera sees that somebody is not before, as long as it is known where everybody is."""
        if any(self._people[name].lost or self._people[name].away(one.time_ns) for name, one in found.items()):
            return
        without = [
            camera
            for camera in images
            if not any(camera in one.left_out for one in found.values())
            and any(camera not in one.seen for one in found.values())
        ]
        self.empty.learn({camera: images[camera] for camera in without}, _covered(found, self.rig))

    def _held(self, name: str, found: Followed, images: Mapping[str, UInt8]) -> tuple[Followed, bool]:
        """It, or where the body was last, where nobody has been seen for some time; and whether that is so.

        For a moment, as while all images show something else, the body goes on as it did. Then it is looked for where
        something is that was not in the empty room, or else where it was.
        """
        person = self._people[name]
        if not person.away(found.time_ns):
            return found, False
        assert person.well is not None  # it was started
        tracker, others = self.tracker.trackers[name], self.tracker.others[name]
        things = {
            camera: self.empty.silhouette(camera, image, others=others.get(camera))
            for camera, image in images.items()
            if camera not in found.left_out
        }
        seen = {camera: thing for camera, thing in things.items() if thing is not None}
        there = place_again(seen, tracker.body, person.well.pose, tracker.eyes)
        known = [camera for camera in self.rig.cameras if self.empty.knows(camera)]
        person.placed = there is not None or len(known) < min(2, len(self.rig.cameras))
        self.tracker.start(name, there or person.well.pose, found.time_ns)
        return msgspec.structs.replace(found, pose=person.well.pose, landmarks=person.well.landmarks), True

    def _whole_in(self, landmarks: Float64, cameras: Iterable[str]) -> int:
        """In how many of these cameras' images all landmarks (n, 3) are."""
        return sum(within(landmarks, self._eyes[name]) for name in cameras)

    def _sees(self, one: SeenIn, image: UInt8, name: str, others: Bool | None) -> bool:
        """Whether a camera sees the body that is meant, rather than somebody else or the empty room."""
        if others is not None:
            body = one.outline.silhouette.mask((others.shape[1], others.shape[0]))
            if np.count_nonzero(others & body) >= HIDDEN_FROM * max(int(np.count_nonzero(body)), 1):
                return False
        return one.overlap >= SEEN_FROM and not self.empty.differs(name, image, one.contour, others) < STANDS_OUT

    def note(self, text: str) -> None:
        """Say it, and keep it."""
        self.notes.append(text)
        self._tell(text)

    def summary(self) -> dict[str, object]:
        """What the run came to, as ``--json`` has it."""
        median_ms = self.took_ms.median
        return {
            "frames": self.frames,
            "median_ms": None if median_ms is None else round(median_ms, 2),
            "notes": self.notes,
        }

    def summary_of(self, name: str) -> dict[str, object]:
        """What it came to for one body."""
        return self.tallies[name].summary()

    def _waits(self, name: str, pose: TreePose) -> dict[str, Silhouette]:
        """What a body covers where it waits, by camera that sees it there."""
        person = self._people[name]
        if person.waits is None or person.waits[0] is not pose:
            covered = self.tracker.trackers[name].covered(pose)
            drawn = {
                camera: Silhouette((0, 0), 1, mask.astype(np.float32) - np.float32(0.5))
                for camera, mask in covered.items()
                if mask.any()
            }
            person.waits = pose, drawn
        return person.waits[1]

    def _say_changes(self, frame: int, people: Mapping[str, PersonStep]) -> None:
        """What has become different, and stays so for a moment: single images are counted in the summary."""
        for camera in self.rig.cameras:
            said: dict[str, None] = {}  # of several bodies the same is said once
            reasons = {one.followed.left_out.get(camera) for one in people.values()}
            of_all = len(reasons) == 1 and None not in reasons
            for name, one in people.items():
                outside = f"{_called(name)} is outside of its image"
                silent = camera in one.followed.seen or one.row.lost
                now = one.followed.left_out.get(camera, "" if silent else outside)
                begun, count = self._trouble.get((camera, name), (frame, 0))
                whom = f" for {name}" if name and not of_all else ""
                if now:
                    self._trouble[camera, name] = begun, count + 1
                    if count + 1 == SAID_AFTER:
                        said[f"{camera} does not count{whom} from frame {begun} on: {now}"] = None
                elif count:
                    del self._trouble[camera, name]
                    if count >= SAID_AFTER:
                        said[f"{camera} counts again{whom} from frame {frame} on"] = None
            for text in said:
                self.note(text)

    def _say_lost(self, name: str, frame: int, *, lost: bool) -> None:
        person = self._people[name]
        if lost and not person.lost:
            self.note(f"frame {frame}: {_called(name)} is in no camera's image any more; the last place is watched")
        elif person.lost and not lost:
            self.note(f"frame {frame}: {_called(name)} is there{' again' if person.came else ''}")
            person.came = True
        person.lost = lost

    def _judge_rig(self, found: Mapping[str, Followed], images: Mapping[str, UInt8]) -> None:
        """In the first frames: whether the cameras see the bodies, each where the rig says that it would.

        The outlines alone do not say it: they are looked for where a body is expected. So it is asked what differs
        from the empty room, and where that is not known, what moves. Who is not there yet may come from anywhere.
        """
        if any(person.lost for person in self._people.values()):
            return
        for name, covered in _covered(found, self.rig).items():
            shares = self._shares.setdefault(name, [])
            if len(shares) < JUDGED_BY:
                share = self._moved.at_body(name, images[name], covered)
                shares += [share] if np.isfinite(share) else []
                if len(shares) == JUDGED_BY and np.median(shares) < MOVES_WITH:
                    who = "the body is" if len(found) == 1 else "the bodies are"
                    self.note(
                        f"{name}: only {np.median(shares):.0%} of what moves in its images is where {who}: is "
                        f"this the video of {name}, does it begin with the others, and stands it where the rig says?"
                    )
        if not self._doubted:
            self._doubted = True
            for text in rig_doubts(found, images, self.empty, self.rig):
                self.note(text)


def rig_doubts(
    found: Mapping[str, Followed], images: Mapping[str, UInt8], empty: EmptyRoom, rig: CameraRig
) -> list[str]:
    """What in a frame says that a camera is not where the rig says, of the cameras whose empty room is known."""
    said, silhouettes = [], {}
    covers = "the body covers" if len(found) == 1 else "the bodies cover"
    for name, covered in _covered(found, rig).items():
        silhouette = empty.silhouette(name, images[name], len(found))
        if silhouette is None:
            continue
        silhouettes[name] = silhouette
        size = rig.cameras[name].camera.size_px
        shared = overlap(silhouette.mask(size), covered.mask(size))
        if shared < DOUBTED_BELOW:
            said.append(
                f"{name}: {covers} other parts of the image than what is not in the empty room (overlap "
                f"{shared:.0%}): is this the video of {name}, and does the camera stand where the rig says?"
            )
    return doubts(meetings(silhouettes, rig)) + said


def _covered(found: Mapping[str, Followed], rig: CameraRig) -> dict[str, Silhouette]:
    """What all bodies together cover, by camera that sees one of them."""
    out: dict[str, Silhouette] = {}
    for name, placed in rig.cameras.items():
        masks = [one.seen[name].outline.silhouette for one in found.values() if name in one.seen]
        if len(masks) == 1:
            out[name] = masks[0]
        elif masks:
            all_of_them = np.logical_or.reduce([mask.mask(placed.camera.size_px) for mask in masks])
            out[name] = Silhouette((0, 0), 1, all_of_them.astype(np.float32) - np.float32(0.5))
    return out


def _called(name: str) -> str:
    return name if name != ALONE else "the body"
