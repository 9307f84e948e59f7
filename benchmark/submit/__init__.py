"""Answers of solvers that ran elsewhere: sets without truth, line-by-line checks, scores."""
