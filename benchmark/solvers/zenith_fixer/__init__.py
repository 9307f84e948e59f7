"""The peer zenith-fixer."""
