"""From sensor data to features: pillars of points, images with a depth distribution, and the encoders of both."""
