"""The diagnostics page of a fit, and what a person can do about what it shows."""
