"""Keypoints by a network from a file: kinds that fit are recognised, others are refused, and people are followed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.onnx_models import model

from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS, make_keypoint_detector
from mocapella.detectors.onnx_people import CropPeople, OneStagePeople, OnnxSettings, network_of, people_of
from mocapella.detectors.onnx_pose import missing
from mocapella.errors import InputError, SettingsError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import topology
from mocapella.sensing.simcc import decode_simcc

FILE = Path("pose.onnx")
IMAGE = ("image", "tensor(float)", ("batch", 3, 256, 192))
SIMCC = (("simcc_x", (1, 17, 384)), ("simcc_y", (1, 17, 512)))
RTMO = (("dets", (1, "n", 5)), ("keypoints", (1, "n", 17, 3)))


def nothing(values: Any) -> Sequence[Any]:
    return []


@pytest.mark.parametrize(("outputs", "one_stage", "first"), [
    (SIMCC, False, 0), (SIMCC[::-1], False, 1), (RTMO, True, 0), (RTMO[::-1], True, 1)])  # fmt: skip
def test_networks_of_the_family_are_recognised(outputs: Any, one_stage: bool, first: int) -> None:
    found = network_of(FILE, [IMAGE], outputs, nothing)
    assert (found.one_stage, found.first, found.size_px, found.topology.name) == (
        one_stage, first, (192, 256), "coco_17",
    )  # fmt: skip
    assert isinstance(people_of(found, OnnxSettings()), OneStagePeople if one_stage else CropPeople)


@pytest.mark.parametrize(("count", "name"), [(17, "coco_17"), (26, "halpe_26"), (133, "coco_wholebody_133")])
def test_the_number_of_keypoints_tells_the_topology(count: int, name: str) -> None:
    outputs = [("simcc_x", (1, count, 384)), ("simcc_y", (1, count, 512))]
    assert network_of(FILE, [IMAGE], outputs, nothing).topology is topology(name)


@pytest.mark.parametrize(
    ("inputs", "outputs", "named"),
    [
        ([IMAGE, IMAGE], SIMCC, "not one colour image"),
        ([("image", "tensor(float)", (1, 1, 256, 192))], SIMCC, "not one colour image"),
        ([("image", "tensor(uint8)", (1, 3, 256, 192))], SIMCC, r"tensor\(uint8\)"),
        ([("image", "tensor(float)", (1, 3, "h", "w"))], SIMCC, "fixed size"),
        ([IMAGE], (*SIMCC, *SIMCC), "gives 4 outputs"),
        ([IMAGE], (("heatmaps", (1, 17, 64, 48)), ("tags", (1, 17, 64, 48))), "another kind"),
        ([IMAGE], (("simcc_x", (1, 17, 384)), ("simcc_y", (1, 18, 512))), "another kind"),
        ([IMAGE], (("simcc_x", (1, 5, 384)), ("simcc_y", (1, 5, 512))), "17, 26, 133"),
        ([IMAGE], (("dets", (1, 9, 6)), ("keypoints", (1, 9, 17, 3))), "boxes of 6"),
    ],
)
def test_another_kind_of_network_is_refused_with_what_fits(inputs: Any, outputs: Any, named: str) -> None:
    with pytest.raises(InputError, match=rf"pose\.onnx.*{named}.*RTMPose"):
        network_of(FILE, inputs, outputs, nothing)


def test_sizes_that_a_file_does_not_state_are_those_of_a_black_image() -> None:
    seen: list[Any] = []

    def run(values: np.ndarray) -> Sequence[Any]:
        seen.append((values.shape, float(np.abs(values).max())))
        return [np.zeros((1, 26, 384), np.float32), np.zeros((1, 26, 512), np.float32)]

    named = (("simcc_x", ("batch", "MatMulsimcc_x_dim_1", 384)), ("simcc_y", ("batch", "MatMulsimcc_x_dim_1", 512)))
    found = network_of(FILE, [IMAGE], named, run)
    assert (found.topology.name, found.one_stage, seen) == ("halpe_26", False, [((1, 3, 256, 192), 0.0)])
    heat = (("heatmaps", ("batch", "joints", "h", "w")), ("tags", ("batch", 17, "h", "w")))
    with pytest.raises(InputError, match="another kind"):
        network_of(FILE, [IMAGE], heat, lambda values: [np.zeros((1, 17, 64, 48))] * 2)


def zeros(shape: tuple[int, ...], values: Any) -> Sequence[Any]:
    return [np.zeros(shape)]


def test_networks_with_one_output_are_recognised_and_decoded() -> None:
    """Heatmaps of one person, and the people of YOLO pose networks in both layouts."""
    maps = np.zeros((1, 17, 64, 48), np.float32)
    maps[0, np.arange(17), np.arange(17), 2 * np.arange(17)] = 0.8
    network = network_of(FILE, [IMAGE], [("output", ("batch", "joints", "h", "w"))], lambda values: [maps])
    x, y = network.run(np.zeros((1, 3, 256, 192), np.float32))
    found = decode_simcc(x[0], y[0], network.size_px)
    np.testing.assert_allclose(found.points_px, 4.0 * np.stack([2 * np.arange(17), np.arange(17)], axis=1))
    assert (found.confidences == np.float32(0.8)).all()
    row = np.concatenate([[50.0, 60.0, 20.0, 40.0, 0.9], np.tile([40.0, 50.0, 0.7], 17)]).astype(np.float32)
    people = np.zeros((1, 56, 7), np.float32)
    people[0, :, 3] = row
    square = [("images", "tensor(float)", (1, 3, 160, 160))]
    for output in (people, np.swapaxes(people, 1, 2)):
        seen: list[np.ndarray] = []

        def run(values: np.ndarray, output: np.ndarray = output, seen: list[np.ndarray] = seen) -> Sequence[Any]:
            seen.append(values)
            return [output]

        finds = people_of(network_of(FILE, square, [("output0", output.shape)], run), OnnxSettings())
        image = np.zeros((160, 160, 3), np.uint8)
        image[..., 0] = 255  # blue
        got = finds.update(image, 0.0)
        np.testing.assert_allclose(got.positions_px, np.tile([[[40.0, 50.0]]], (1, 17, 1)), atol=1e-4)
        assert [float(seen[-1][0, k].max()) for k in range(3)] == [0.0, 0.0, 1.0]  # red, green, blue
    for shape in ((1, 17, 6), (1, 57, 7), (1, 5)):
        with pytest.raises(InputError, match=r"pose\.onnx"):
            network_of(FILE, square, [("output0", shape)], partial(zeros, shape))


def test_networks_of_half_precision_get_and_give_it() -> None:
    seen: list[np.dtype[Any]] = []

    def run(values: np.ndarray) -> Sequence[Any]:
        seen.append(values.dtype)
        return [np.zeros((1, 17, 384), np.float16), np.zeros((1, 17, 512), np.float16)]

    half = ("image", "tensor(float16)", ("batch", 3, 256, 192))
    network = network_of(FILE, [half], SIMCC, run)
    assert [one.dtype for one in network.run(np.zeros((1, 3, 256, 192), np.float32))] == [np.float32, np.float32]
    assert seen == [np.float16]


def squares(image: np.ndarray) -> Sequence[Any]:
    """A top-down network that sees the brightest place of its crop as all keypoints around it."""
    red = image[0, 0]
    x, y = np.full((1, 17, 384), -1.0, np.float32), np.full((1, 17, 512), -1.0, np.float32)
    sure = float(red.max() > red.min() + 1)
    rows, columns = np.nonzero(red >= red.max() - 0.5)
    xs = np.linspace(columns.min(), columns.max(), 17)
    ys = rows.min() + (rows.max() - rows.min()) * (np.arange(17) % 3) / 2
    for k in range(17):
        x[0, k, round(2 * xs[k])] = y[0, k, round(2 * ys[k])] = 0.9 * sure
    return [x, y]


def picture(*corners: tuple[int, int]) -> np.ndarray:
    image = np.zeros((240, 320, 3), np.uint8)
    for x, y in corners:
        image[y : y + 60, x : x + 30] = 255
    return image


def test_a_top_down_network_follows_a_person() -> None:
    finds = CropPeople(network_of(FILE, [IMAGE], SIMCC, squares), OnnxSettings(search_every_s=0.0))
    for k, x in enumerate((100, 106, 112)):
        seen = finds.update(picture((x, 90)), k / 10)
        assert seen.ids.tolist() == [0]
        middle = np.nanmean(seen.positions_px[0], axis=0)
        assert np.abs(middle - [x + 14.5, 119.5]).max() < 4
    assert finds.update(picture(), 1.0).ids.tolist() == []
    assert finds.update(picture((20, 90)), 2.0).ids.tolist() == [1]
    finds.reset()
    assert finds.update(picture((20, 90)), 3.0).ids.tolist() == [0]


def test_a_region_leads_a_top_down_network_to_a_person() -> None:
    finds = CropPeople(network_of(FILE, [IMAGE], SIMCC, squares), OnnxSettings())
    region = np.array([[195, 85, 235, 155]], np.float32)
    seen = finds.update(picture((200, 90)), 0.0, region)
    assert seen.ids.tolist() == [0]
    assert np.abs(np.nanmean(seen.positions_px[0], axis=0) - [214.5, 119.5]).max() < 3


def test_several_people_have_several_crops() -> None:
    finds = CropPeople(network_of(FILE, [IMAGE], SIMCC, squares), OnnxSettings())
    regions = np.array([[15, 85, 55, 155], [195, 85, 235, 155]], np.float32)
    seen = finds.update(picture((20, 90), (200, 90)), 0.0, regions)
    assert seen.ids.tolist() == [0, 1]
    again = finds.update(picture((22, 90), (198, 90)), 0.1)
    assert again.ids.tolist() == [0, 1]
    assert np.nanmean(again.positions_px[:, :, 0], axis=1) == pytest.approx([36.5, 212.5], abs=4)


def test_a_one_stage_network_sees_the_image_letterboxed() -> None:
    boxes = np.array([[[10, 10, 60, 110, 0.8], [100, 10, 150, 110, 0.2]]], np.float32)
    points = np.full((1, 2, 17, 3), 40.0, np.float32)
    points[..., 2] = 0.7
    seen_shapes = []

    def run(image: np.ndarray) -> Sequence[Any]:
        seen_shapes.append(image.shape)
        return [points, boxes]

    network = network_of(FILE, [("image", "tensor(float)", (1, 3, 160, 160))], RTMO[::-1], run)
    seen = OneStagePeople(network, OnnxSettings()).update(np.zeros((240, 320, 3), np.uint8), 0.0)
    assert seen_shapes == [(1, 3, 160, 160)]
    assert seen.ids.tolist() == [NO_ID]
    np.testing.assert_allclose(seen.positions_px, np.full((1, 17, 2), 80.5), atol=1e-3)
    np.testing.assert_allclose(seen.confidences, np.full((1, 17), 0.7), rtol=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"most_people": 0}, {"least_confidence": -1}, {"search_every_s": 61}, {"threads": -1}]
)
def test_wrong_settings_of_networks_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        OnnxSettings(**wrong)


def test_a_missing_runtime_is_named_with_its_remedy() -> None:
    assert "--extra onnx" in missing({"cv2": True, "onnxruntime": False})
    assert "--extra cameras" in missing({"cv2": False, "onnxruntime": True})


def test_files_of_models_are_opened_and_others_refused(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    assert KEYPOINT_DETECTORS["onnx"].missing() == ""
    with pytest.raises(InputError, match="--model FILE"):
        make_keypoint_detector("onnx")
    boxes = np.array([[[10, 10, 60, 110, 0.8]]], np.float32)
    points = np.full((1, 1, 26, 3), 0.5, np.float32)
    (tmp_path / "rtmo.onnx").write_bytes(model((160, 160), {"dets": boxes, "keypoints": points}))
    finds = make_keypoint_detector("onnx", {"threads": 1}, tmp_path / "rtmo.onnx")
    assert finds.topology is topology("halpe_26")
    seen = finds.update(np.zeros((160, 160, 3), np.uint8), 0.0)
    np.testing.assert_allclose(seen.positions_px, points[..., :2].reshape(1, 26, 2), atol=1e-5)
    simcc = {"simcc_x": np.zeros((1, 133, 320), np.float32), "simcc_y": np.zeros((1, 133, 320), np.float32)}
    rtmo = {"dets": boxes, "keypoints": points}
    for name, outputs, kind in (("rtmw", simcc, "coco_wholebody_133"), ("free-rtmo", rtmo, "halpe_26")):
        (tmp_path / f"{name}.onnx").write_bytes(model((160, 160), outputs, free=True))
        assert make_keypoint_detector("onnx", None, tmp_path / f"{name}.onnx").topology is topology(kind)
    (tmp_path / "grey.onnx").write_bytes(model((160, 160), {"dets": boxes, "keypoints": points}, channels=1))
    (tmp_path / "free.onnx").write_bytes(model((160, 160), {"dets": boxes, "keypoints": points}, fixed=False))
    (tmp_path / "bad.onnx").write_bytes(b"no model")
    heat = {"heatmaps": np.zeros((1, 26, 40, 40), np.float32)}
    yolo = {"output0": np.zeros((1, 56, 9), np.float32)}
    for name, outputs, kind in (("heat", heat, "halpe_26"), ("yolo", yolo, "coco_17")):
        (tmp_path / f"{name}.onnx").write_bytes(model((160, 160), outputs, free=True))
        one = make_keypoint_detector("onnx", None, tmp_path / f"{name}.onnx")
        assert one.topology is topology(kind)
        assert len(one.update(np.zeros((160, 160, 3), np.uint8), 0.0).ids) == 0
    for name, fault in (("grey", "colour"), ("free", "fixed size"), ("bad", "is no ONNX model")):
        with pytest.raises(InputError, match=rf"{name}\.onnx.*{fault}"):
            make_keypoint_detector("onnx", None, tmp_path / f"{name}.onnx")
