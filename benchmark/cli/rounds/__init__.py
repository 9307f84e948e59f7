"""Commands for rounds: `skybench bench round`."""
