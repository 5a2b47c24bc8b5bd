"""What two runs have in common, and where they part: decisions of two traces, instances of two maps."""
