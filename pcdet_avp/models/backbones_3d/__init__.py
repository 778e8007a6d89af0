"""Features of point clouds: pillars."""
