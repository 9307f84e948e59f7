"""Commands on frames that nobody rendered: `skybench import` and `skybench fetch`."""
