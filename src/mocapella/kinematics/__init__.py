"""Estimation of poses from points: kinematic chains of twists with bone lengths, joint limits and predictions."""
