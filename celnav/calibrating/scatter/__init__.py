"""What the lens leaves of the measured positions: noise, what neighbours share, and what the grid of the pixels does."""
