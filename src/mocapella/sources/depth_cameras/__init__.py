"""Depth cameras through the packages of their makers, each of which is imported when such a camera is opened."""
