"""A body followed through the videos of several cameras: what the command and the demo do, frame by frame.

Images in which nothing is to be seen do not count, and why is said; where nobody is there any more who could be
followed, the body waits where it was last, at rest, and goes on when somebody is there again.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.visual_cones import doubts, meetings
from mocapella.conventions import NS_PER_S
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, rest
from mocapella.model.silhouettes import overlap
from mocapella.model.twist_tree import TreePose
from mocapella.recording.followed_bodies import FollowedFrame, frame_of
from mocapella.sensing.empty_room import EmptyRoom, MovedSince
from mocapella.sensing.outline_picture import outlined
from mocapella.sources.dead_images import DeadImages
from mocapella.tracker.silhouettes import Followed, SeenIn, SilhouetteSettings, SilhouetteTracker

UInt8 = NDArray[np.uint8]
Say = Callable[[str], None]

SEEN_FROM: Final = 0.5
"""Overlap of the outlines from which on a camera sees the body that is meant."""
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


class Step(msgspec.Struct, frozen=True, eq=False):
    """One frame and what came of it.

    Attributes:
        images: (height, width, 3) BGR by camera, all.
        followed: what the tracker says.
        row: as the file has it.
        took_s: how long the tracker took.
    """

    images: Mapping[str, UInt8]
    followed: Followed
    row: FollowedFrame
    took_s: float

    def pictures(self, width: int | None = None) -> dict[str, UInt8]:
        """Each camera's image with the outlines drawn in, so many pixels wide; as it is without ``width``."""
        seen = self.followed.seen
        return {
            name: outlined(image, seen[name].contour, seen[name].outline.silhouette, width)
            if name in seen else outlined(image, None, None, width)
            for name, image in self.images.items()
        }  # fmt: skip


class SilhouetteRun:
    """A body from its first pose on.

    Args:
        mesh: of the body.
        rig: of the cameras, for images of their size.
        rate_hz: frames a second.
        settings: of the tracker.
        say: is told what happens.

    Attributes:
        rows: of all frames so far.
        notes: all that was said.
        took_s: of each frame.
        empty: the room without anybody, as far as it is known.
    """

    def __init__(
        self,
        mesh: RiggedMesh,
        rig: CameraRig,
        rate_hz: float,
        settings: SilhouetteSettings | None = None,
        say: Say = lambda _text: None,
    ) -> None:
        self.mesh, self.rig = mesh, rig
        self.tracker = SilhouetteTracker(mesh, rig, settings)
        self.rows: list[FollowedFrame] = []
        self.notes: list[str] = []
        self.took_s: list[float] = []
        self._rate_hz, self._tell, self._dead = rate_hz, say, DeadImages()
        self._trouble: dict[str, tuple[int, int]] = {}
        self._lost = False
        self._well = Followed(0, rest(mesh), np.empty((0, 3)), {}, {})
        self._seen_ns = 0
        self.empty = EmptyRoom()
        self._moved, self._shares = MovedSince(), dict[str, list[float]]()

    def start(self, pose: TreePose, frame: int, step: int = 1) -> None:
        """It is about there in the frame of that number, the frames being ``step`` apart.

        Raises:
            SettingsError: no camera sees it there.
        """
        time_ns = self._time_ns(frame - step)
        self.tracker.start(pose, time_ns)
        self._seen_ns = time_ns
        self._well = Followed(time_ns, pose, landmarks_at(self.mesh, pose), {}, {})

    def steps(self, images: Iterable[tuple[int, dict[str, UInt8]]]) -> Iterator[Step]:
        """Each frame when it is done."""
        for frame, shown in images:
            yield self.step(frame, shown)

    def step(self, frame: int, images: Mapping[str, UInt8]) -> Step:
        """The next frame."""
        dead = self._dead.update(images)
        begin_s = time.perf_counter()
        found = self.tracker.update({k: v for k, v in images.items() if k not in dead}, self._time_ns(frame))
        took_s = time.perf_counter() - begin_s
        found = msgspec.structs.replace(found, left_out={**found.left_out, **dead})
        found, lost = self._held(found, images)
        self._say_changes(frame, found, lost)
        row = frame_of(
            frame,
            frame / self._rate_hz,
            found.pose,
            joint_names=self.mesh.joint_names,
            landmarks=dict(zip(self.mesh.landmarks, found.landmarks, strict=True)),
            overlap={name: one.overlap for name, one in found.seen.items()},
            left_out=found.left_out,
            lost=lost,
        )
        self.rows.append(row)
        self.took_s.append(took_s)
        self._judge_rig(found, images)
        return Step(images, found, row, took_s)

    def _held(self, found: Followed, images: Mapping[str, UInt8]) -> tuple[Followed, bool]:
        """It, or where the body was last, where nobody has been seen for some time; and whether that is so.

        For a moment, as while all images show something else, the body goes on as it did. Where it waits, two cameras
        have seen it; one alone would soon take anything for it.
        """
        enough = min(2, len(self.rig.cameras))
        good = sum(self._sees(one, images[name], name) for name, one in found.seen.items())
        if good >= enough and not self._lost and self._whole_in(found) >= enough:
            self._well = found
        if good >= (enough if self._lost else 1):
            self._seen_ns = found.time_ns
        away_ns = found.time_ns - self._seen_ns
        if not self._lost and away_ns < LOST_AFTER_S * NS_PER_S:
            self.empty.learn({k: v for k, v in images.items() if k not in found.seen and k not in found.left_out})
        if away_ns == 0 or (not self._lost and away_ns < LOST_AFTER_S * NS_PER_S):
            return found, False
        self.tracker.start(self._well.pose, found.time_ns)
        return msgspec.structs.replace(found, pose=self._well.pose, landmarks=self._well.landmarks), True

    def _whole_in(self, found: Followed) -> int:
        """In how many cameras' images all of it is."""
        count = 0
        for name in found.seen:
            camera = self.rig.cameras[name].camera
            at = project(apply(self.rig.cameras[name].T_camera_world, found.landmarks), camera.lens)
            count += bool(((at >= 0) & (at < np.array(camera.size_px) - 1)).all())
        return count

    def _sees(self, one: SeenIn, image: UInt8, name: str) -> bool:
        """Whether a camera sees the body that is meant, rather than the empty room."""
        return one.overlap >= SEEN_FROM and not self.empty.differs(name, image, one.contour) < STANDS_OUT

    def note(self, text: str) -> None:
        """Say it, and keep it."""
        self.notes.append(text)
        self._tell(text)

    def summary(self) -> dict[str, object]:
        """What the run came to, as ``--json`` has it."""
        overlaps = [value for row in self.rows for value in row.overlap.values()]
        left_out = Counter(name for row in self.rows for name in row.left_out)
        return {
            "frames": len(self.rows),
            "lost": sum(row.lost for row in self.rows),
            "left_out": dict(left_out),
            "median_overlap": round(float(np.median(overlaps)), 4) if overlaps else None,
            "median_ms": round(1e3 * float(np.median(self.took_s)), 3) if self.took_s else None,
            "notes": self.notes,
        }

    def _time_ns(self, frame: int) -> int:
        return round(frame * NS_PER_S / self._rate_hz)

    def _say_changes(self, frame: int, found: Followed, lost: bool) -> None:
        """What has become different, and stays so for a moment: single images are counted in the summary."""
        for name in self.rig.cameras:
            now = found.left_out.get(name, "" if name in found.seen or lost else "the body is outside of its image")
            begun, count = self._trouble.get(name, (frame, 0))
            if now:
                self._trouble[name] = (begun, count + 1)
                if count + 1 == SAID_AFTER:
                    self.note(f"{name} does not count from frame {begun} on: {now}")
            elif count:
                del self._trouble[name]
                if count >= SAID_AFTER:
                    self.note(f"{name} counts again from frame {frame} on")
        if lost and not self._lost:
            self.note(f"frame {frame}: the body is in no camera's image any more; it waits where it was last")
        elif self._lost and not lost:
            self.note(f"frame {frame}: the body is there again")
        self._lost = lost

    def _judge_rig(self, found: Followed, images: Mapping[str, UInt8]) -> None:
        """In the first frames: whether the cameras see one body, each where the rig says that it would.

        The outlines alone do not say it: they are looked for where the body is expected. So it is asked what differs
        from the empty room, and where that is not known, what moves.
        """
        for name, one in found.seen.items():
            shares = self._shares.setdefault(name, [])
            if len(shares) < JUDGED_BY:
                share = self._moved.at_body(name, images[name], one.outline.silhouette)
                shares += [share] if np.isfinite(share) else []
                if len(shares) == JUDGED_BY and np.median(shares) < MOVES_WITH:
                    self.note(
                        f"{name}: only {np.median(shares):.0%} of what moves in its images is where the body is: is "
                        f"this the video of {name}, does it begin with the others, and stands it where the rig says?"
                    )
        if len(self.rows) == 1:
            for text in rig_doubts(found, images, self.empty, self.rig):
                self.note(text)


def rig_doubts(found: Followed, images: Mapping[str, UInt8], empty: EmptyRoom, rig: CameraRig) -> list[str]:
    """What in a frame says that a camera is not where the rig says, of the cameras whose empty room is known."""
    said, silhouettes = [], {}
    for name, one in found.seen.items():
        silhouette = empty.silhouette(name, images[name])
        if silhouette is None:
            continue
        silhouettes[name] = silhouette
        size = rig.cameras[name].camera.size_px
        shared = overlap(silhouette.mask(size), one.outline.silhouette.mask(size))
        if shared < DOUBTED_BELOW:
            said.append(
                f"{name}: the body covers other parts of the image than what is not in the empty room (overlap "
                f"{shared:.0%}): is this the video of {name}, and does the camera stand where the rig says?"
            )
    return doubts(meetings(silhouettes, rig)) + said
