"""Edits of a scene: typed operations in an ordered stack, language that becomes operations, a judge. Needs numpy alone."""
