"""The benchmark's tasks: one definition and one scenario each, frozen at a revision (docs/tasks.md)."""
