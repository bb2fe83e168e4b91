"""Edits and selections shown on the point clouds, and their fields as properties."""
