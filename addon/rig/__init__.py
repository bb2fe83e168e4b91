"""The scaffold as animated empties: keys, repair, motion edits, poses by the core during playback."""
