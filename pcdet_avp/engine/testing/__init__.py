"""Running a trained network over a data set: detections, the benchmark, pictures."""
