"""Long clips: shots, overlapping windows that are fitted one after the other, and the scene that they become."""
