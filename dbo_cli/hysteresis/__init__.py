"""Mathematics of hysteresis: arrays in, arrays out; no files, no printing."""
