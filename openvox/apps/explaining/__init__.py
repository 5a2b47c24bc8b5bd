"""What a trace tells about a mask, an instance, a voxel, and about where it is likely wrong."""
