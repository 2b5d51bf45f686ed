"""Fuse several views of one person or object, with uncertainty."""
