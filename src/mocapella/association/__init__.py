"""Data association: match the skeletons of one person.

Bodies of one sensor are assigned to tracked people by gating and global nearest neighbour (`tracks`); a lost body is
re-identified by position or body proportions. Baseline of the thesis: `closest_pairs`.
"""
