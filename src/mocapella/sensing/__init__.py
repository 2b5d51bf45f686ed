"""Pixels → observations: pure functions on images, and a small object where something is followed over time."""
