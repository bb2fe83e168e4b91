"""Figures that Feature4X reports in its supplement: on other data and another machine, so they stand beside ours, never mixed."""

from ..study import Row

THEIRS = "Feature4X"
"""`source` of their rows."""
OURS = "here"

DIMENSIONS: list[Row] = [
    {"width": width, "source": THEIRS, "train (s)": 3600 * hours, "draw (ms)": None, "draw all (s)": seconds}
    | {"mIoU": miou, "accuracy": accuracy, "PSNR (dB)": psnr, "SSIM": ssim, "LPIPS": lpips}
    for width, hours, seconds, miou, accuracy, psnr, ssim, lpips in (
        (8, 2.30, 4.818, 0.468, 0.827, 24.466, 0.788, 0.092),
        (16, 2.48, 4.898, 0.483, 0.831, 24.595, 0.793, 0.091),
        (32, 2.83, 4.872, 0.482, 0.830, 24.616, 0.793, 0.090),
        (64, 3.45, 4.967, 0.485, 0.834, 24.623, 0.790, 0.091),
        (128, 4.22, 5.815, 0.471, 0.832, 24.585, 0.792, 0.091),
        (256, 8.75, 10.167, 0.494, 0.837, 24.629, 0.796, 0.090),
        (512, 14.80, 16.313, 0.497, 0.841, 24.491, 0.789, 0.095),
    )
]
"""Tables D and E: NVIDIA Jumping, training time with the scene, rendering time of the sequence."""

FOLLOWED: list[Row] = [
    {"source": THEIRS, "data": data, "from": way, "mIoU": miou, "time (s)": seconds}
    for data, way, miou, seconds in (
        ("NVIDIA", "pictures", 0.456, 1.83),
        ("NVIDIA", "features", 0.739, 1.01),
        ("Nerfies", "pictures", 0.519, 9.10),
        ("Nerfies", "features", 0.594, 3.10),
    )
]
"""Table A: SAM2 masks from one point."""

LABELLED: list[Row] = [
    {"source": THEIRS, "data": f"Nerfies {scene}", "from": way, "mIoU": miou, "accuracy": accuracy, "time (s)": seconds}
    for scene, *pair in (
        ("Broom", (0.193, 0.321, 207.59), (0.333, 0.610, 30.22)),
        ("Curls", (0.514, 0.877, 155.25), (0.443, 0.872, 20.82)),
        ("Tail", (0.261, 0.652, 389.89), (0.338, 0.860, 46.43)),
        ("Toby-sit", (0.504, 0.757, 355.82), (0.470, 0.737, 45.96)),
        ("mean", (0.368, 0.652, 277.14), (0.396, 0.770, 35.86)),
    )
    for way, (miou, accuracy, seconds) in zip(("pictures", "features"), pair, strict=True)
]
"""Table C: CLIP-LSeg semantic segmentation."""

VIEWS: list[Row] = [
    {"scene": scene, "source": THEIRS, "method": method, "PSNR (dB)": psnr, "SSIM": ssim, "LPIPS": lpips}
    | {"accuracy": accuracy, "mIoU": miou, "static (MB)": static, "dynamic (MB)": dynamic, "size (MB)": size}
    for scene, *methods in (
        (
            "Jumping",
            (24.558, 0.792, 0.092, None, None, 29.08, 29.70, 58.78),
            (24.516, 0.793, 0.092, 0.840, 0.483, 271.30, 212.58, 483.88),
            (24.633, 0.795, 0.090, 0.836, 0.495, 44.15, 30.51, 74.66),
            (24.616, 0.793, 0.090, 0.831, 0.483, 44.09, 30.84, 74.93),
        ),
        (
            "Skating",
            (31.478, 0.926, 0.059, None, None, 32.49, 4.90, 37.39),
            (31.568, 0.927, 0.059, 0.835, 0.446, 302.50, 35.40, 337.90),
            (31.572, 0.927, 0.059, 0.838, 0.450, 49.32, 4.90, 54.22),
            (31.666, 0.926, 0.059, 0.819, 0.418, 47.52, 5.60, 53.12),
        ),
        (
            "Truck",
            (26.688, 0.824, 0.115, None, None, 38.31, 11.84, 50.15),
            (26.619, 0.824, 0.115, 0.973, 0.880, 353.97, 90.18, 444.15),
            (26.630, 0.820, 0.122, 0.971, 0.878, 58.35, 12.27, 70.62),
            (26.610, 0.822, 0.117, 0.969, 0.868, 58.16, 13.51, 71.67),
        ),
        (
            "Umbrella",
            (23.355, 0.706, 0.185, None, None, 71.29, 11.42, 82.71),
            (23.362, 0.708, 0.176, 0.875, 0.556, 657.96, 75.12, 733.08),
            (23.433, 0.707, 0.185, 0.869, 0.559, 107.87, 11.28, 119.15),
            (23.392, 0.708, 0.180, 0.880, 0.565, 107.58, 11.50, 119.08),
        ),
        (
            "Balloon1",
            (22.666, 0.760, 0.117, None, None, 56.88, 18.59, 75.47),
            (22.687, 0.762, 0.115, 0.901, 0.377, 525.09, 129.88, 654.97),
            (22.668, 0.760, 0.118, 0.905, 0.435, 85.95, 18.84, 104.79),
            (22.691, 0.759, 0.117, 0.903, 0.446, 85.72, 19.90, 105.62),
        ),
        (
            "Balloon2",
            (26.827, 0.850, 0.082, None, None, 51.82, 15.22, 67.04),
            (27.018, 0.854, 0.080, 0.819, 0.350, 475.71, 108.96, 584.67),
            (26.904, 0.851, 0.081, 0.821, 0.321, 78.22, 15.18, 93.40),
            (26.871, 0.853, 0.078, 0.813, 0.319, 77.77, 15.36, 93.13),
        ),
        (
            "Playground",
            (20.591, 0.777, 0.130, None, None, 92.74, 9.80, 102.54),
            (20.569, 0.776, 0.124, 0.922, 0.447, 857.32, 61.38, 918.70),
            (20.463, 0.775, 0.130, 0.922, 0.430, 141.02, 9.20, 150.22),
            (20.536, 0.775, 0.130, 0.913, 0.419, 140.44, 10.21, 150.65),
        ),
        (
            "mean",
            (25.166, 0.805, 0.111, None, None, 53.230, 14.496, 67.726),
            (25.191, 0.806, 0.109, 0.881, 0.506, 491.979, 101.929, 593.907),
            (25.186, 0.805, 0.112, 0.880, 0.510, 80.697, 14.597, 95.294),
            (25.197, 0.805, 0.110, 0.876, 0.503, 80.183, 15.274, 95.457),
        ),
    )
    for method, (psnr, ssim, lpips, accuracy, miou, static, dynamic, size) in zip(
        ("MoSca", "MoSca + Feature 3DGS", "Feature4X, CLIP head alone", "Feature4X"), methods, strict=True
    )
]
"""Table B: NVIDIA. Sizes are of their checkpoints, features in static and dynamic."""
