"""What lens and mount do to the image: point spread, stray light, motion during the exposure."""
