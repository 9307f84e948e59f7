"""Identification of the solver ``skybench``: hypotheses from bright detections, verified against the whole field."""
