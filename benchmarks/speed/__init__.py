"""Times of backends, forms of the deformation, batches, long clips and features, each against its alternatives."""
