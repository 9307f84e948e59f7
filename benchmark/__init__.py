"""The benchmark runs solvers over graded night skies, judges their answers, compares them and reports the results."""
