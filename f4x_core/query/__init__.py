"""Questions to a scene: scores of labels, selections, masks, answers. Needs numpy alone."""
