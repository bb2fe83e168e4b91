"""Measures a scene: against its clip, against simple baselines, and as a point tracker."""
