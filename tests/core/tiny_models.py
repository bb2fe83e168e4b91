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
                weight.copy_(0.1 * noise + float(around_one or ("layer_norm" in name and name.endswith("weight"))))
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
    randomise(transformers.Sam2VideoModel(config)).save_pretrained(folder)
    return Path(folder)


WORDS = "a photo of the large small bad art itap origami in video game . cat dog sky".split()  # noqa: SIM905


def tiny_tokenizer(folder: Path, specials: dict[str, str], extra=()) -> None:
    """Words split at blanks and known from `WORDS`; enough to run a text tower."""
    from tokenizers import Tokenizer, models, pre_tokenizers

    names = [*dict.fromkeys(specials.values()), *extra]
    vocabulary = {word: index for index, word in enumerate([*names, *WORDS])}
    tokenizer = Tokenizer(models.WordLevel(vocabulary, unk_token=specials["unk_token"]))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    fast = transformers.PreTrainedTokenizerFast(tokenizer_object=tokenizer, **specials)
    fast.add_special_tokens({"additional_special_tokens": list(extra)})
    fast.save_pretrained(folder)


def tiny_tipsv2(folder: Path, seed=0) -> Path:
    """TIPSv2 with 16 channels, windows of 4 x 4 patches of 14 px."""
    torch.manual_seed(seed)
    sizes = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
    config = transformers.Tipsv2Config(
        vision_config={**sizes, "image_size": 56},
        text_config={**sizes, "intermediate_size": 32, "vocab_size": 64, "max_position_embeddings": 16},
    )
    model = randomise(transformers.Tipsv2Model(config), seed)
    with torch.no_grad():
        model.temperature.fill_(0.005)
    model.save_pretrained(folder)
    tiny_tokenizer(folder, {"unk_token": "<unk>", "pad_token": "<pad>"})
    return Path(folder)


def tiny_clip(folder: Path, seed=0, projection_dim=12) -> Path:
    """CLIP with 16 channels into a small space, windows of 4 x 4 patches of 16 px."""
    torch.manual_seed(seed)
    sizes = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    tokens = {"bos_token_id": 1, "eos_token_id": 2, "pad_token_id": 2}
    config = transformers.CLIPConfig(
        vision_config={**sizes, "image_size": 64, "patch_size": 16},
        text_config={**sizes, **tokens, "vocab_size": 64, "max_position_embeddings": 20},
        projection_dim=projection_dim,
    )
    model = randomise(transformers.CLIPModel(config), seed)
    with torch.no_grad():
        model.logit_scale.fill_(4.6)
    model.save_pretrained(folder)
    specials = {"unk_token": "<unk>", "bos_token": "<start>", "eos_token": "<end>", "pad_token": "<end>"}
    tiny_tokenizer(folder, specials)
    return Path(folder)


VLM_TOKENS = ("<|im_start|>", "<end_of_utterance>", "<fake_token_around_image>", "<global-img>", "<image>")


def tiny_smolvlm(folder: Path, seed=0) -> Path:
    """SmolVLM with an 8 x 8 vision grid of 16 channels that becomes 4 image tokens per frame."""
    torch.manual_seed(seed)
    tiny_tokenizer(folder, {"unk_token": "<unk>", "pad_token": "<pad>", "eos_token": "<eos>"}, VLM_TOKENS)
    config = transformers.SmolVLMConfig(
        vision_config={
            "hidden_size": 16,
            "intermediate_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "image_size": 64,
            "patch_size": 8,
        },
        text_config={
            "model_type": "llama",
            "hidden_size": 16,
            "intermediate_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "num_key_value_heads": 1,
            "vocab_size": 64,
            "pad_token_id": 1,
            "eos_token_id": 2,
            "bos_token_id": 3,
        },
        image_token_id=3 + VLM_TOKENS.index("<image>"),
        scale_factor=4,
    )
    randomise(transformers.SmolVLMForConditionalGeneration(config), seed).save_pretrained(folder)
    return Path(folder)


def tiny_depth_anything(folder: Path, seed=0) -> Path:
    """Depth Anything on a DINOv2 of 16 channels."""
    torch.manual_seed(seed)
    config = transformers.DepthAnythingConfig(
        backbone_config=transformers.Dinov2Config(
            hidden_size=16,
            num_hidden_layers=4,
            num_attention_heads=2,
            image_size=56,
            out_indices=[1, 2, 3, 4],
            reshape_hidden_states=False,
        ),
        reassemble_hidden_size=16,
        neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8,
        head_hidden_size=8,
    )
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    return Path(folder)
