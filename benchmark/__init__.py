"""The benchmark: solvers run over graded skies, judged, compared and reported."""
