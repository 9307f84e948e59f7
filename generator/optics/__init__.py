"""Effects of lens and mount on the image: point spread, stray light, motion during the exposure."""
