"""The mapper's kernels, once for each kind of machine."""
