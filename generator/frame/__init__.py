"""One frame from plan to files: scene, expected electrons, truth, record."""
