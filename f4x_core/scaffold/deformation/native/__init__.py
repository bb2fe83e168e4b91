"""The compiled deformation: `library` for numpy arrays, without torch; `autograd` for tensors, with gradients."""
