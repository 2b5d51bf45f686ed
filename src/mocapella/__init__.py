"""Mocapella tracks people, live, with several cheap depth sensors, and sees around occlusion."""

__version__ = "0.1.0"
