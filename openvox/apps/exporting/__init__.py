"""The forms in which a map leaves for other programs, one file each."""
