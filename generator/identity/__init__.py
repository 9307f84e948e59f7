"""Identity of frames: the revision of the code that renders them, and hashes of their pixels."""
