"""Random checkpoints of the real architectures, small enough for everyday tests; production code loads them by folder."""

from pathlib import Path

import torch
import transformers


def randomise(model, seed=0):
    """Random weights of unit gain everywhere, also where training starts at zero: nothing drops out of a comparison."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, weight in model.named_parameters():
            noise = torch.randn(weight.shape, generator=generator)
            if weight.ndim > 1 and "embed" not in name:
                weight.copy_(noise / weight[0].numel() ** 0.5)
            else:
                around_one = name.endswith(("norm.weight", "norm1.weight", "norm2.weight", "lambda1"))
                weight.copy_(0.1 * noise + float(around_one or "layer_norm" in name and name.endswith("weight")))
    return model.eval()


def tiny_sam2(folder: Path, seed=0, **changes) -> Path:
    """SAM 2 at 128 px: pyramid of 128 channels on 32, 16 and 8 cells, 1.3 M weights."""
    torch.manual_seed(seed)
    side, width = 128, 128
    grids = [[side // 4] * 2, [side // 8] * 2, [side // 16] * 2]
    vision = transformers.Sam2VisionConfig(
        backbone_config=transformers.Sam2HieraDetConfig(
            hidden_size=8,
            image_size=[side, side],
            blocks_per_stage=[1, 1, 2, 1],
            embed_dim_per_stage=[8, 16, 32, 64],
            num_attention_heads_per_stage=[1, 1, 2, 4],
            global_attention_blocks=[3],
        ),
        backbone_channel_list=[64, 32, 16, 8],
        backbone_feature_sizes=grids,
        fpn_hidden_size=width,
    )
    config = transformers.Sam2VideoConfig(
        vision_config=vision,
        prompt_encoder_config=transformers.models.sam2_video.configuration_sam2_video.Sam2VideoPromptEncoderConfig(
            hidden_size=width, image_size=side
        ),
        mask_decoder_config=transformers.models.sam2_video.configuration_sam2_video.Sam2VideoMaskDecoderConfig(
            hidden_size=width, mlp_dim=64, num_attention_heads=4, iou_head_hidden_dim=32
        ),
        image_size=side,
        memory_attention_hidden_size=width,
        memory_attention_num_layers=2,
        memory_attention_feed_forward_hidden_size=64,
        memory_attention_rope_feat_sizes=[side // 16] * 2,
        memory_encoder_hidden_size=width,
        memory_encoder_output_channels=64,
        mask_downsampler_embed_dim=width,
        memory_fuser_embed_dim=width,
        memory_fuser_intermediate_dim=64,
        **changes,
    )
    model = randomise(transformers.Sam2VideoModel(config))
    with torch.no_grad():  # an object on every frame: masks, not the constant that stands for "nothing here"
        model.mask_decoder.pred_obj_score_head.proj_out.bias.fill_(5.0)
    model.save_pretrained(folder)
    return Path(folder)
