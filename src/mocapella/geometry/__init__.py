"""Geometry on arrays: rotations, rigid motions, angles, lenses, triangulation; without people and files."""
