"""Of a lens: how well it is known."""
