"""Rotations, rigid motions, spherical harmonics and cameras, written once for numpy and torch. Needs numpy alone."""
