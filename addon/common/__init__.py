"""Blender's data without a scene of ours: point attributes, keyframes, node trees, axes; reports of errors."""
