"""Data association: match the skeletons of one person."""
