"""Commands for real photographs: `skybench import` and `skybench fetch`."""
