"""Foundation models through transformers. The modules import it (3 s) and torch: reach them through the registry, lazily."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Checkpoint:
    """Published weights of one model."""

    name: str
    """Name in `f4x models`; also the folder below `$F4X_MODELS`."""
    hub: str
    """Hugging Face id."""
    megabytes: int
    """Size of the download."""
    licence: str
    """SPDX id of the weights."""
    architecture: str
    """`model_type` in its `config.json`; Depth Anything 3 has none, and says which size it is as `model_name`."""


CHECKPOINTS = {
    entry.name: entry
    for entry in (
        Checkpoint("sam2-tiny", "facebook/sam2.1-hiera-tiny", 156, "Apache-2.0", "sam2_video"),
        Checkpoint("sam2-small", "facebook/sam2.1-hiera-small", 184, "Apache-2.0", "sam2_video"),
        Checkpoint("sam2-base", "facebook/sam2.1-hiera-base-plus", 323, "Apache-2.0", "sam2_video"),
        Checkpoint("sam2-large", "facebook/sam2.1-hiera-large", 898, "Apache-2.0", "sam2_video"),
        Checkpoint("tipsv2", "google/tipsv2-b14", 784, "CC-BY-4.0", "tipsv2"),
        Checkpoint("clip", "openai/clip-vit-base-patch16", 599, "MIT", "clip"),
        Checkpoint("clip-b32", "openai/clip-vit-base-patch32", 605, "MIT", "clip"),
        Checkpoint("smolvlm-256m", "HuggingFaceTB/SmolVLM2-256M-Video-Instruct", 1026, "Apache-2.0", "smolvlm"),
        Checkpoint("smolvlm-500m", "HuggingFaceTB/SmolVLM2-500M-Video-Instruct", 2030, "Apache-2.0", "smolvlm"),
        Checkpoint("depth-anything", "depth-anything/Depth-Anything-V2-Small-hf", 99, "Apache-2.0", "depth_anything"),
        Checkpoint("depth-anything-3", "depth-anything/DA3-SMALL", 137, "Apache-2.0", "depth_anything_3"),
        Checkpoint("depth-anything-3-base", "depth-anything/DA3-BASE", 541, "Apache-2.0", "depth_anything_3"),
    )
}
"""Name -> weights that the modules of this folder can open."""
