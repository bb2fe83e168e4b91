"""Feature4X core: from one monocular video to an editable 4D scene of Gaussians. Nothing here imports bpy."""

__version__ = "0.1.0"
