"""openvox: instance-level, open-vocabulary, probabilistic voxel maps from RGB-D logs."""

__version__ = "0.1.0"
