"""What the studies share: contestants, records, pages."""
