"""Camera images: lamps, shading, textures and the image sensor."""
