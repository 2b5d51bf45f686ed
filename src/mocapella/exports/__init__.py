"""Export takes and results to files for other programs: CSV, JSON and TRC."""
