"""Pictures of frames, boxes and maps; numpy and OpenCV only, no display needed."""
