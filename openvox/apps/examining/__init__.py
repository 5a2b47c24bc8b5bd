"""doctor: one file a kind of finding, pure functions on a sample of frames."""
