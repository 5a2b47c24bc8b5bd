"""What every room speaks: types, parameters, digests, errors."""
