"""Figures that Feature4X reports in its supplement: on other data and another machine, so they stand beside ours, never mixed."""

from .study import Row

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
