"""Figures that the fit and those who judge it share: likeness of pictures, angles of views, how far views can be believed."""
