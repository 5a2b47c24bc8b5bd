"""Pages that people keep: one HTML file with everything in it."""
