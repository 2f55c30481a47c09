"""Many channels: sets of models, patterns of columns, coupling, one shape for all, several processes."""
