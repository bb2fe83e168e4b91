"""Quality of answers, masks, edits and motion against the truth."""
