"""Random star fields, and what the default solver must reach on them."""
