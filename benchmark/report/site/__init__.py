"""The report over all tasks: a folder of plain pages that needs neither a server nor the network."""
