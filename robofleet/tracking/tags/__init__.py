"""Tags in images: search, sub-pixel fit, tracking from image to image."""
