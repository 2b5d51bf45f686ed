"""Arrays in, arrays out: rotations, rigid motions, angles. Knows no people and no files."""
