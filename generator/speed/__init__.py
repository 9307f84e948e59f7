"""``skybench speed``: the time of a frame, stage by stage, compared with a floor that is measured in the same run."""
