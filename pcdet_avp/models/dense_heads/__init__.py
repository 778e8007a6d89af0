"""The SSD head: anchors, target assignment, box coding, losses, rotated NMS."""
