"""Pictures of a board that is carried about before two cameras, as folders that a camera's node can show."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.geometry.twists import exp_twist
from mocapella.model.board import Board, encode_board
from mocapella.sensing.boards import draw_board

BOARD = Board("charuco", 6, 5, 0.04, dictionary="DICT_4X4_50")
SIZE = (640, 480)
LENS = np.array([520.0, 520.0, 322.0, 238.0, 0, 0, 0, 0, 0])
BASELINE_M, YAW_DEG = 0.12, 3.0
"""The right camera stands so far to the right, and looks so far to the left."""
FPS, HELD = 20, 16
"""Pictures a second, and in how many of them the board is held still."""
_SQUARE_PX, _OVER = 60, 2


@dataclass(frozen=True)
class Pictures:
    """Folders by camera, and the true ``T_right_left``."""

    folders: dict[str, Path]
    T_right_left: np.ndarray


def board_pictures(folder: Path, poses: int = 12, seed: int = 0) -> Pictures:
    """Write ``left``, ``right`` and ``board.toml``: each pose is `HELD` pictures long."""
    (folder / "board.toml").write_text(encode_board(BOARD))
    R = rotation_about_y(np.radians(YAW_DEG)).T
    T_right_left = rigid(R, -R @ np.array([BASELINE_M, 0.0, 0.0]))
    drawn = draw_board(BOARD, _SQUARE_PX)
    folders = {name: folder / name for name in ("left", "right")}
    for name, T_camera_left in zip(folders, (np.eye(4), T_right_left), strict=True):
        folders[name].mkdir()
        for k, T_left_board in enumerate(_poses(poses, seed)):
            first = folders[name] / f"{k:02}-00.png"
            cv2.imwrite(str(first), _rendered(drawn, T_camera_left @ T_left_board, seed + 100 * k + len(name)))
            for copy in range(1, HELD):
                os.link(first, folders[name] / f"{k:02}-{copy:02}.png")
    return Pictures(folders, T_right_left)


def off_mm(T_right_world: np.ndarray, T_left_world: np.ndarray, true: Pictures) -> float:
    """How far the right camera is from where it truly is, as seen from the left one."""
    found, wanted = inverse(T_right_world @ inverse(T_left_world)), inverse(true.T_right_left)
    return 1e3 * float(np.linalg.norm(found[:3, 3] - wanted[:3, 3]))


def _poses(count: int, seed: int) -> list[np.ndarray]:
    """``T_left_board``: turned in all directions, through the whole picture."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        side, high = (-1, 1, 0)[k % 3], (-1, 1)[k // 3 % 2]
        middle = np.array([0.06 + 0.17 * side, 0.11 * high, 0.55]) + rng.uniform(-0.02, 0.02, 3)
        turn = np.r_[0, 0, 0, rng.uniform([-0.55, -0.55, -0.3], [0.55, 0.55, 0.3])]
        R = exp_twist(turn)[:3, :3]
        out.append(rigid(R, middle - R @ BOARD.corners_m.mean(axis=0)))
    return out


def _rendered(drawn: np.ndarray, T_camera_board: np.ndarray, seed: int) -> np.ndarray:
    scale = BOARD.square_m / _SQUARE_PX
    to_m = np.array([[scale, 0, 0.5 * scale - BOARD.square_m / 2], [0, scale, 0.5 * scale - BOARD.square_m / 2],
                     [0, 0, 1]])  # fmt: skip
    K = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
    larger = np.array([[_OVER, 0, (_OVER - 1) / 2], [0, _OVER, (_OVER - 1) / 2], [0, 0, 1]])
    H = larger @ K @ T_camera_board[:3, [0, 1, 3]] @ to_m
    size = (_OVER * SIZE[0], _OVER * SIZE[1])
    image = cv2.warpPerspective(drawn, H, size, flags=cv2.INTER_AREA, borderValue=90)
    image = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    noisy = 0.85 * image + 15 + np.random.default_rng(seed).normal(0, 2, image.shape)
    return cv2.cvtColor(noisy.clip(0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
