"""Detect people's keypoints by a pose network in an ONNX file: top-down with SimCC, or one-stage.

Top-down networks (Jiang et al., RTMPose, 2023) see one person's crop; crops come from the last image, or from a
prediction. One-stage networks (Lu et al., RTMO, CVPR 2024) see the whole image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import PeopleDetector, SeenPeople
from mocapella.detectors.people_slots import BLANK_MARGIN, MOST_COVERED
from mocapella.errors import InputError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import Topology, topology
from mocapella.sensing.image_crops import letterbox, person_crop, to_image, to_rgb
from mocapella.sensing.person_regions import SEEN, alike, box_of, covered, without
from mocapella.sensing.simcc import decode_people, decode_simcc
from mocapella.settings import check

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]
Run = Callable[[Float32], Sequence[Any]]
"""Runs a network: (1, 3, height, width) float32 → its outputs."""

TOPOLOGIES: Final = {17: "coco_17", 26: "halpe_26", 133: "coco_wholebody_133", 136: "halpe_136"}
"""Topology by number of keypoints."""
FITS: Final = (
    "an RTMPose (outputs simcc_x, simcc_y) or RTMO (outputs dets, keypoints) export of MMDeploy, "
    "heatmaps of one person, or a YOLO pose network"
)
FLOATS: Final[Mapping[str, type[np.floating[Any]]]] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
"""Types of numbers that networks take."""
MEAN: Final = np.array([123.675, 116.28, 103.53], np.float32)
SD: Final = np.array([58.395, 57.12, 57.375], np.float32)
"""Mean and standard deviation of ImageNet's red, green and blue, which the family's networks expect."""
MOST_SIDE_PX: Final = 4096
"""Largest side of a network's input [px]."""
WINDOWS: Final = ((0.0, 1.0), (0.0, 0.5), (0.25, 0.75), (0.5, 1.0))
"""Parts of the image's width that are searched in turn: a person is too small in the whole of a wide image."""


@dataclass(frozen=True)
class OnnxSettings:
    """Settings of the detector ``onnx``.

    Attributes:
        most_people: people at once in one image; larger: slower with each person [number]
        least_confidence: least mean confidence of the keypoints of a person that counts; larger: fewer mistakes, and
            fewer people [0 to 1]
        search_every_s: time between two searches for further people while a person is followed, of networks that see
            one person; larger: faster, and later to find [s]
        threads: threads of the network; 0 takes all cores [number]

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    most_people: int = 10
    least_confidence: float = 0.4
    search_every_s: float = 0.25
    threads: int = 0

    def __post_init__(self) -> None:
        check(1 <= self.most_people <= 100, "most_people", self.most_people, "from 1 to 100")
        check(0 <= self.least_confidence <= 1, "least_confidence", self.least_confidence, "from 0 to 1")
        check(0 <= self.search_every_s <= 60, "search_every_s", self.search_every_s, "from 0 to 60 s")
        check(0 <= self.threads <= 256, "threads", self.threads, "from 0 to 256")


@dataclass(frozen=True, eq=False)
class PoseNetwork:
    """A network whose inputs and outputs are known.

    Attributes:
        file: its file, for messages.
        one_stage: whether it sees the whole image, instead of one person's crop.
        size_px: (width, height) of its input.
        topology: names and order of its keypoints.
        run: runs it.
        first: index of the output that comes first in the decoding: the bins of x, or the boxes.
    """

    file: Path
    one_stage: bool
    size_px: tuple[int, int]
    topology: Topology
    run: Run
    first: int = 0


def open_model(path: Path, threads: int = 0) -> PoseNetwork:
    """Open a network's file on the processor, and check that it is of the family. Nothing is downloaded.

    Args:
        path: the ONNX file.
        threads: threads of the network; 0 takes all cores.

    Raises:
        InputError: it cannot be read, or its inputs or outputs are of another kind; says which kind would fit.
    """
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = threads, 4
    faults = (state.Fail, state.InvalidArgument, state.InvalidGraph, state.InvalidProtobuf, state.NotImplemented)
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except (*faults, RuntimeError) as error:
        raise InputError("is no ONNX model that can be read", file=path, fix=f"give {FITS}") from error
    inputs = [(one.name, one.type, one.shape) for one in session.get_inputs()]
    outputs = [(one.name, one.shape) for one in session.get_outputs()]
    try:
        return network_of(path, inputs, outputs, lambda values: session.run(None, {inputs[0][0]: values}))
    except (*faults, state.RuntimeException, RuntimeError) as error:
        raise InputError(f"fails on a black image ({_first_line(error)})", file=path, fix=f"give {FITS}") from error


def network_of(
    path: Path, inputs: Sequence[tuple[str, str, Sequence[Any]]], outputs: Sequence[tuple[str, Sequence[Any]]], run: Run
) -> PoseNetwork:
    """Recognise a network by its inputs and outputs.

    Args:
        path: its file, for messages.
        inputs: name, type such as ``tensor(float)`` and shape of each input; a size that is not fixed is no int.
        outputs: name and shape of each output; a size that is not fixed is no int.
        run: runs the network; with sizes of outputs that are not fixed, as MMDeploy exports them, it runs once on a
            black image, which tells them.

    Raises:
        InputError: it is of another kind; names the fault, and the kinds that fit.
    """

    def refuse(what: str) -> InputError:
        return InputError(what, file=path, fix=f"give {FITS}")

    if len(inputs) != 1 or len(inputs[0][2]) != 4 or inputs[0][2][1] != 3:
        raise refuse(f"takes {', '.join(f'{name} {list(shape)}' for name, _, shape in inputs)}, not one colour image")
    if inputs[0][1] not in FLOATS:
        raise refuse(f"takes {inputs[0][1]}, not {' or '.join(FLOATS)}")
    run = _as_float32(run, FLOATS[inputs[0][1]])
    height, width = inputs[0][2][2:]
    if not all(isinstance(side, int) and 0 < side <= MOST_SIDE_PX for side in (height, width)):
        raise refuse(f"takes images of {width} × {height} px; a fixed size is needed")
    if len(outputs) not in (1, 2):
        raise refuse(f"gives {len(outputs)} outputs ({', '.join(name for name, _ in outputs)}), not one or two")
    if len(outputs) == 1:
        shape = np.shape(run(np.zeros((1, 3, height, width), np.float32))[0])
        both = _as_two(shape, run)
        if both is None:
            raise refuse(f"gives {outputs[0][0]} {list(shape)}: another kind of network")
        outputs, run = both
    if not _sizes_known([shape for _, shape in outputs]):
        made = run(np.zeros((1, 3, height, width), np.float32))
        outputs = [(name, np.shape(values)) for (name, _), values in zip(outputs, made, strict=True)]
    ranks = [len(shape) for _, shape in outputs]
    if sorted(ranks) == [3, 4]:
        first = ranks.index(3)
        boxes, points = outputs[first][1], outputs[1 - first][1]
        if boxes[2] != 5 or points[3] != 3:
            raise refuse(f"gives boxes of {boxes[2]} and keypoints of {points[3]} numbers, not 5 and 3")
        return PoseNetwork(path, True, (width, height), _topology(points[2], refuse), run, first)
    if ranks == [3, 3] and outputs[0][1][1] == outputs[1][1][1]:
        first = 1 if outputs[0][0].endswith("y") else 0
        return PoseNetwork(path, False, (width, height), _topology(outputs[0][1][1], refuse), run, first)
    raise refuse(f"gives {', '.join(f'{name} {list(shape)}' for name, shape in outputs)}: another kind of network")


def _as_float32(run: Run, dtype: type[np.floating[Any]]) -> Run:
    """Return a network that takes and gives float32, for one that takes ``dtype``."""
    if dtype is np.float32:
        return run
    return lambda values: [np.asarray(one, np.float32) for one in run(values.astype(dtype))]


def _as_two(shape: tuple[int, ...], run: Run) -> tuple[list[tuple[str, Sequence[Any]]], Run] | None:
    """Return names and shapes of two outputs, and a network that gives them, for one with a single output.

    Heatmaps (1, keypoints, height, width) become responses of columns and rows, as of SimCC. The people of a YOLO
    network, (1, 5 + 3 keypoints, people) or its transpose, become boxes and keypoints, as of RTMO (D. Maji et al.,
    YOLO-Pose, CVPR workshops 2022): each has the middle, width, height and score of its box, then x, y and score of
    each keypoint. None for other shapes.
    """
    if len(shape) == 4:
        columns, rows = (1, shape[1], shape[3]), (1, shape[1], shape[2])
        return [("x", columns), ("y", rows)], lambda values: _marginals(run(values)[0])
    counts = [5 + 3 * count for count in TOPOLOGIES]
    if len(shape) == 3 and (shape[1] in counts or shape[2] in counts):
        across = shape[1] in counts
        numbers, people = (shape[1], shape[2]) if across else (shape[2], shape[1])
        shapes: list[tuple[str, Sequence[Any]]] = [
            ("dets", (1, people, 5)),
            ("keypoints", (1, people, (numbers - 5) // 3, 3)),
        ]
        return shapes, lambda values: _yolo_people(run(values[:, ::-1] / np.float32(255))[0], across=across)
    return None


def _marginals(maps: Any) -> Sequence[Any]:
    """Return the largest responses of the columns and rows of heatmaps (1, keypoints, height, width)."""
    return [np.max(maps, axis=2), np.max(maps, axis=3)]


def _yolo_people(output: Any, *, across: bool) -> Sequence[Any]:
    """Return boxes (1, people, 5) and keypoints (1, people, keypoints, 3) of a YOLO network; see `_as_two`."""
    found = np.swapaxes(output, 1, 2) if across else np.asarray(output)
    middle, sides = found[..., :2], found[..., 2:4]
    boxes = np.concatenate([middle - sides / 2, middle + sides / 2, found[..., 4:5]], axis=-1)
    return [boxes, found[..., 5:].reshape(1, found.shape[1], -1, 3)]


def people_of(network: PoseNetwork, settings: OnnxSettings) -> PeopleDetector:
    """Return the detector that uses a network."""
    return OneStagePeople(network, settings) if network.one_stage else CropPeople(network, settings)


class OneStagePeople:
    """Keypoints of all people by a network that sees the whole image: a `PeopleDetector`.

    Args:
        network: a one-stage network.
        settings: number of people, and their least confidence.

    Attributes:
        topology: of the network.
    """

    def __init__(self, network: PoseNetwork, settings: OnnxSettings) -> None:
        self.topology = network.topology
        self._network, self._settings = network, settings

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the people in an image; see `PeopleDetector.update`. Regions are not used."""
        canvas, T = letterbox(image, self._network.size_px)
        outputs = self._network.run(np.ascontiguousarray(canvas.transpose(2, 0, 1)[None], np.float32))
        first = self._network.first
        found = decode_people(outputs[first][0], outputs[1 - first][0], self._settings.least_confidence)
        most = self._settings.most_people
        return _people(to_image(found.points_px[:most], T), found.confidences[:most], None)

    def reset(self) -> None:
        """Forget nothing: each image is independent."""


class CropPeople:
    """Keypoints of several people by a network that sees one person's crop: a `PeopleDetector`.

    Args:
        network: a top-down network.
        settings: number of people, and how new ones are found.

    Attributes:
        topology: of the network.
    """

    def __init__(self, network: PoseNetwork, settings: OnnxSettings) -> None:
        self.topology = network.topology
        self._network, self._settings = network, settings
        self._last: list[_Found] = []
        self._next_id = self._window = 0
        self._searched_s = -np.inf

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the people in the next image; see `PeopleDetector.update`."""
        pixels = to_rgb(image)
        found: list[_Found] = []
        boxes = [(one.id, one.box) for one in self._last]
        for region in () if regions_px is None else regions_px:
            if covered(region, [box for _, box in boxes]) < MOST_COVERED:
                boxes.append((NO_ID, region))
        for identity, box in boxes[: self._settings.most_people]:
            self._add(found, self._look(pixels, box), identity)
        if not found or not 0 <= at_s - self._searched_s < self._settings.search_every_s:
            self._searched_s = at_s
            self._search(pixels, found)
        self._last = found
        if not found:
            joints = len(self.topology)
            return _people(np.zeros((0, joints, 2), np.float32), np.zeros((0, joints), np.float32), None)
        ids = np.array([one.id for one in found], np.int64)
        return _people(np.stack([one.points_px for one in found]), np.stack([one.confidences for one in found]), ids)

    def reset(self) -> None:
        """Forget all earlier images."""
        self._last, self._next_id, self._window, self._searched_s = [], 0, 0, -np.inf

    def _look(self, pixels: UInt8, box: Float32) -> _Found | None:
        crop, T = person_crop(pixels, box, self._network.size_px)
        values = ((crop - MEAN) / SD).transpose(2, 0, 1)[None]
        outputs = self._network.run(np.ascontiguousarray(values, np.float32))
        first = self._network.first
        found = decode_simcc(outputs[first][0], outputs[1 - first][0], self._network.size_px)
        points = to_image(found.points_px, T)
        around = box_of(points, found.confidences, BLANK_MARGIN)
        return None if around is None else _Found(NO_ID, points, found.confidences, around)

    def _add(self, found: list[_Found], one: _Found | None, identity: int) -> bool:
        if one is None or len(found) >= self._settings.most_people:
            return False
        there = one.confidences >= SEEN
        sure = float(one.confidences[there].mean()) >= self._settings.least_confidence
        same = (alike(one.points_px, o.points_px, np.minimum(one.confidences, o.confidences)) for o in found)
        if not sure or any(same):
            return False
        if identity == NO_ID:
            identity, self._next_id = self._next_id, self._next_id + 1
        found.append(_Found(identity, one.points_px, one.confidences, one.box))
        return True

    def _search(self, pixels: UInt8, found: list[_Found]) -> None:
        """Look in one part of the image, without the people who are found, and again with them."""
        height, width = pixels.shape[:2]
        left, right = WINDOWS[self._window]
        self._window = (self._window + 1) % len(WINDOWS)
        rest = without(pixels, [one.box for one in found])
        rough = self._look(rest, np.array([left * width, 0, right * width, height], np.float32))
        if rough is not None and covered(rough.box, [one.box for one in found]) < MOST_COVERED:
            self._add(found, self._look(rest, rough.box), NO_ID)


@dataclass(frozen=True, eq=False)
class _Found:
    id: int
    points_px: Float32
    confidences: Float32
    box: Float32


def _people(points_px: Float32, confidences: Float32, ids: NDArray[np.int64] | None) -> SeenPeople:
    own = np.full(len(points_px), NO_ID, np.int64) if ids is None else ids
    return SeenPeople(own, points_px, confidences, None)


def _topology(count: Any, refuse: Callable[[str], InputError]) -> Topology:
    if count not in TOPOLOGIES:
        known = ", ".join(map(str, TOPOLOGIES))
        raise refuse(f"gives {count} keypoints; networks of {known} keypoints are read")
    return topology(TOPOLOGIES[count])


def _sizes_known(shapes: Sequence[Sequence[Any]]) -> bool:
    """Whether the sizes that tell a network's kind and keypoints are stated; the number of people need not be."""
    one_stage = sorted(map(len, shapes)) == [3, 4]
    return all(len(shape) and all(isinstance(n, int) for n in shape[2 if one_stage else 1 :]) for shape in shapes)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
