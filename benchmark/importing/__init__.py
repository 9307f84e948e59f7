"""Photographs as datasets: place and time are the truth, and the names of stars where these follow from them."""
