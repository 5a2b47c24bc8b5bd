"""What a live run is made of: frames that arrive, eyes, a map that others may ask, and how late it is."""
