"""Calibration methods: estimate poses of sensors, cameras and bodies from observations."""
