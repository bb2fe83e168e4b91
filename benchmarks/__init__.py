"""The laboratory beside the product: studies, their runner and page, timings, and the figures that were recorded."""
