"""The peer ruststartracker."""
