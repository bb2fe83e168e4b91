"""Feature4X for Blender: the extension's door."""


def register() -> None:
    """Add Feature4X to Blender."""
    from .addon import registration

    registration.register()


def unregister() -> None:
    """Take Feature4X out of Blender again."""
    from .addon import registration

    registration.unregister()
