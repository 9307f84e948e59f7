"""What frames are known by: the revision of the code that makes them, and hashes of their pixels."""
