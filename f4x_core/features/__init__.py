"""Features: teachers turn frames into maps, one latent is distilled from them, small heads decode it.

`spec` and `maps` need numpy alone; everything else in this room needs torch.
"""
