"""Names of OpenPose's keypoints on our body models."""

from __future__ import annotations

from typing import Final

LANDMARKS: Final = {
    "Nose": "nose", "LEye": "left eye", "REye": "right eye", "LEar": "left ear", "REar": "right ear", "Head": "head",
    "LShoulder": "left shoulder", "RShoulder": "right shoulder", "LElbow": "left elbow", "RElbow": "right elbow",
    "LWrist": "left wrist", "RWrist": "right wrist", "LHip": "left hip", "RHip": "right hip", "LKnee": "left knee",
    "RKnee": "right knee", "LAnkle": "left ankle", "RAnkle": "right ankle", "LBigToe": "left toe",
    "RBigToe": "right toe", "LHeel": "left heel", "RHeel": "right heel",
}  # fmt: skip
"""The landmark of `mocapella.model.body_meshes` for each keypoint."""
NO_LANDMARKS: Final = ("Neck", "MidHip")
"""Keypoints without a landmark: OpenPose's neck differs from our models' joint of that name."""
