"""Star identification by a network that was trained in this project."""
