"""The Moon in a frame: its path over the exposure, the points of its disk, and the occultation of lights."""
