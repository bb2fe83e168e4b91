"""Panels, their properties, and drawings over viewports."""
