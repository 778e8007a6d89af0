"""What things look like: cars, pedestrians, the building, as triangle meshes."""
