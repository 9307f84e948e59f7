"""The steps of star detection: background, matched filter, candidates, centroids; and the flood fill of the thesis."""
