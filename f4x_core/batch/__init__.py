"""Many clips: a manifest of rows, each a small graph of ordinary `f4x` commands, run here or on a Ray cluster. Torch-free."""
