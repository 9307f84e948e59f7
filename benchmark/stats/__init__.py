"""Statistics of results: intervals, clustered and paired tests, ranks, break points, confidence."""
