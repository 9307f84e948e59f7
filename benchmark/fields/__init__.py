"""Random star fields, and the bars that the default solver must reach on them."""
