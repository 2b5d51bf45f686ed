"""Fuse several views of one person or object, with uncertainty.

Skeletons: robust weighted mean of views. Facing: histogram filter. Markers and rigid objects: extended Kalman filters
on pixels. Arms: inverse-variance weighting. Joint bias: learnt regression.
"""
