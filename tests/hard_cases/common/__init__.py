"""What the hard cases share: how they film, fit, blend and draw."""
