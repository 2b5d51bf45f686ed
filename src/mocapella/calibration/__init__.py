"""Calibration methods: estimate poses of sensors, cameras and bodies from observations.

Cameras: calibration board, intrinsics and extrinsics by bundle adjustment. Body sensors: extrinsics and clock offsets
from people's motion. Depth cameras: extrinsics from an arm. Other trackers' spaces: hand-eye calibration.
"""
