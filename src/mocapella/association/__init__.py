"""Whose skeleton is this? Views of the same person are brought together."""
