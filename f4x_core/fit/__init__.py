"""The fit: profiles, stages, losses, checkpoints and the diagnostics page."""
