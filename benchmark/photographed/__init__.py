"""Stars of a photograph whose place and time are known: their light, the true attitude, and what of the frame is sky."""
