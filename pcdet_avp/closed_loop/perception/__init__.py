"""What the car is told: reference perceivers, line of sight, and the network behind a radio link."""
