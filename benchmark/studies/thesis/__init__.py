"""The replication of the thesis' evaluation, `skybench study thesis`."""
