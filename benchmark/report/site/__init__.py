"""The report over all tasks: a folder of plain pages that need neither a server nor a network."""
