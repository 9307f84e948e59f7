"""Code shared by the studies: contestants, records, pages."""
