"""Results for people: terminal tables, pages and figures."""
