"""The scenario: what a user asks for, read strictly from YAML and validated before anything is computed."""
