"""The probabilistic mapper: associate, then evolve. It knows neither files, nor viewers, nor the clock."""
