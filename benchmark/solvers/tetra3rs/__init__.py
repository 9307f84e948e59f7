"""The peer tetra3rs."""
