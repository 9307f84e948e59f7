"""Answers of solvers that ran elsewhere: sets without truth, checks line by line, scores."""
