"""Pixels to observations: pure functions on images."""
