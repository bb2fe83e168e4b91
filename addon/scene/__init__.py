"""An imported scene: its object, its file, its clip time, its colors over time."""
