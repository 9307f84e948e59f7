"""Video cameras: the frames of a video within an exposure, their coding by H.264, and stacks of the decoded frames."""
