"""`skybench show`: a dataset as a page to look at (`page`), from shards or from a folder of frames (`source`)."""
