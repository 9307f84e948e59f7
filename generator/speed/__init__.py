"""``skybench speed``: how long a frame takes, stage by stage, beside a floor that is measured in the same run."""
