"""A keypoint detector of a bright cap, and steadier people."""
