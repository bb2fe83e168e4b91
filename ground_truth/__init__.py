"""Data sets rendered with Blender: clips whose truth is known. No part of the extension."""
