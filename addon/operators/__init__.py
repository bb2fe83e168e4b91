"""Operators: buttons, menus and gestures."""
