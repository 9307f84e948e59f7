"""Photographs as datasets: place and time are the truth, and so are the stars' names where these follow from them."""
