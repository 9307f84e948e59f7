"""The scenario: the user's description of frames, read strictly from YAML and validated before anything is computed."""
