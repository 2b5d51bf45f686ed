"""Where frames come from: a simulated room, recordings, and sensors."""
