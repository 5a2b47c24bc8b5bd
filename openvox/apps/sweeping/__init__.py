"""The parts of a sweep: what is to be mapped, one item, many items side by side, what they tell together."""
