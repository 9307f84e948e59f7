"""Residuals of the lens fit: noise, a pattern that neighbours share, and the pixel-phase error."""
