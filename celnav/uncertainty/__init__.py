"""What the covariance of a fix needs beyond the scatter of single stars: lens, air, and errors that neighbours share."""
