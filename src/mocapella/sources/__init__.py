"""Sources of frames: simulations, recordings, cameras, and network bridges."""
