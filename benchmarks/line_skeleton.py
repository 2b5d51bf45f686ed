"""The skeleton stages of the detector `line-skeleton` beside the same stages of OpenCV, and the detector's own grid.

The masks are the detector's own for the frames of depth_hand_sr305, and for a drawn arm, which needs no
recording. OpenCV works on the whole image, in one thread as ours.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, at_most, compared, measured, median_seconds, times_the_peer
from benchmarks.tracker import recordings
from mocapella.evaluation.line_skeleton_grid import GridRow, grid_table
from mocapella.model.camera import Camera

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

STAGES_GOAL: Final = 30
THINNING_GOAL: Final = 100
SR305: Final = Camera("sr305", (640, 480), np.array([476.007, 476.007, 313.683, 242.755, 0, 0, 0, 0, 0]))
SR305_UNIT_M: Final = 0.000125


def run(quick: bool = False) -> list[Row]:
    try:
        import cv2  # noqa: F401
    except ImportError:
        warnings.warn("nothing measured: the extra cameras is not installed, which has OpenCV", stacklevel=2)
        return []
    frames = sr305_frames()
    rows = stage_rows({"drawn arm": drawn_mask(), **masks_of(frames)}, quick)
    if frames:
        rows.append(whole(frames, quick))
    return rows


def stage_rows(masks: Mapping[str, UInt8], quick: bool = False) -> list[Row]:
    """Thinning, and all skeleton stages, of each mask; and how many pixels differ.

    Args:
        masks: (height, width) 255 where an arm is, else 0, by a name.
        quick: fewer repetitions.
    """
    import cv2

    from mocapella.sensing.line_skeleton_thinning import skeleton, thin

    peer, different = f"OpenCV {cv2.__version__}", 0
    times: dict[str, list[tuple[float, float]]] = {"thinning": [], "skeleton stages": []}
    with one_thread():
        for mask in masks.values():
            pairs = {"thinning": (thin, cv2.ximgproc.thinning), "skeleton stages": (skeleton, opencv_chain)}
            for what, (ours, theirs) in pairs.items():
                turns = [
                    (
                        median_seconds(lambda f=ours, m=mask: f(m), repeat=1, number=4 if quick else 40),
                        median_seconds(lambda f=theirs, m=mask: f(m), repeat=1, number=1 if quick else 2),
                    )
                    for _ in range(2 if quick else 5)
                ]
                value, peer_value = (1000 * statistics.median(column) for column in zip(*turns, strict=True))
                times[what].append((value, peer_value))
            made = skeleton(mask)
            got = thin(mask), made.thinned, made.distance, made.ridges, made.dilated, made.lines
            wanted = cv2.ximgproc.thinning(mask), *opencv_chain(mask)
            different += sum(int((a != b).sum()) for a, b in zip(got, wanted, strict=True))
    rows = []
    for what, goal in (("thinning", THINNING_GOAL), ("skeleton stages", STAGES_GOAL)):
        in_order = sorted(times[what], key=lambda pair: pair[1] / pair[0])
        names = {pair: name for name, pair in zip(masks, times[what], strict=True)}
        for word, pair in (("the mask of least ratio", in_order[0]), ("the median one", in_order[len(in_order) // 2])):
            rows.append(
                compared(
                    f"line_skeleton: {what}, {word} of {len(masks)} ({names[pair]})",
                    pair[0],
                    "ms",
                    peer=peer,
                    peer_value=pair[1],
                    goal=times_the_peer(goal),
                )
            )
    rows.append(
        measured(f"line_skeleton: pixels that differ, {len(masks)} masks, all stages", different, "", goal=at_most(0))
    )
    return rows


def grid_rows(
    frames: Iterable[tuple[Float32, Float64, float]], camera: Camera
) -> tuple[list[Row], tuple[GridRow, ...]]:
    """The table of grids as rows, and as it is, for `mocapella.evaluation.line_skeleton_grid.plot_grid`.

    Args:
        frames: of `grid_table`.
        camera: of the frames.
    """
    table, rows = grid_table(frames, camera, time.perf_counter), []
    for row in table:
        name = f"line_skeleton: grid of {row.grid_px} px"
        rows += [
            measured(f"{name}, median of {row.frames} frames", row.median_ms, "ms"),
            measured(f"{name}, elbow, wrist and palm, median", row.arm_mm, "mm"),
            measured(f"{name}, fingertips found, median", row.tips_mm, "mm"),
            measured(f"{name}, fingertips found", 100 * row.tips_found, "%"),
        ]
    return rows, table


def whole(frames: Mapping[str, Float32], quick: bool) -> Row:
    """The whole detector, one image after the other."""
    from mocapella.sensing.line_skeleton import LineSkeleton

    detector = LineSkeleton(SR305)
    with one_thread():
        took = [
            median_seconds(lambda d=depth: detector.update(d, 0.0), repeat=2 if quick else 7, number=1)
            for depth in frames.values()
        ]
    return measured(
        f"line_skeleton: the whole detector, median of {len(frames)} frames", 1000 * statistics.median(took), "ms"
    )


def opencv_chain(mask: UInt8, ridge_least: int = 128) -> tuple[UInt8, Float32, UInt8, UInt8, UInt8]:
    """The peer: thinning, distance transform, Laplacian, normalisation, dilation, and thin lines on ridges."""
    import cv2

    thinned = cv2.ximgproc.thinning(mask)
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    negative = cv2.Laplacian(distance, cv2.CV_32F, scale=-1)
    ridges = cv2.normalize(negative, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    dilated = cv2.dilate(ridges, np.ones((3, 3), dtype=np.uint8))
    lines = cv2.bitwise_and(thinned, cv2.compare(dilated, ridge_least, cv2.CMP_GE))
    return thinned, distance, ridges, dilated, lines


def sr305_frames() -> dict[str, Float32]:
    """The frames of depth_hand_sr305 [m] by their names; none where they are not there."""
    import cv2

    folder = recordings() / "depth_hand_sr305" / "frames"
    if not folder.is_dir():
        warnings.warn(f"only a drawn arm: {folder} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return {}
    files = sorted(folder.glob("*.png"))
    return {
        path.name: cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(SR305_UNIT_M)
        for path in files
    }


def masks_of(frames: Mapping[str, Float32]) -> dict[str, UInt8]:
    """The arms that the detector finds in them."""
    from mocapella.sensing.line_skeleton import LineSkeletonSettings
    from mocapella.sensing.line_skeleton_outline import outline, separated

    s = LineSkeletonSettings()
    found = {name: outline(separated(depth, s), s) for name, depth in frames.items()}
    return {name: made.arm for name, made in found.items() if made is not None}


def drawn_mask() -> UInt8:
    """Draw an open hand and its forearm in their size at 0.6 m."""
    import cv2

    mask: Any = np.zeros((480, 640), dtype=np.uint8)
    cv2.line(mask, (330, 479), (322, 300), (255,), 58)
    cv2.ellipse(mask, (320, 250), (38, 46), 0, 0, 360, (255,), cv2.FILLED)
    for base, tip, width in (
        ((345, 275), (402, 225), 19), ((342, 225), (358, 150), 15), ((327, 215), (330, 132), 16),
        ((311, 218), (302, 142), 15), ((297, 228), (272, 165), 13),
    ):  # fmt: skip
        cv2.line(mask, base, tip, (255,), width)
    return np.asarray(mask)


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV without its own threads."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
