"""Files: reading beside writing, one file a format."""
