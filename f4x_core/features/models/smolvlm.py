"""SmolVLM2: the teacher that reads frames, and answers to questions about a video from feature maps alone.

The teacher's map is the last hidden state of the vision tower; at question time decoded maps go through the connector
(pixel shuffle and projection) to the places of the image tokens in `inputs_embeds`. The vision tower is not called.
The language part was trained on true vision features; what it makes of smooth, distilled ones is less certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...errors import F4xError
from ..memory import memory_guard
from ..preprocess import image_tensor
from ..spec import FeatureSpec
from .loading import find, load, load_tokenizer, transformers

MEAN, STD = (0.5,) * 3, (0.5,) * 3
DEFAULT = "smolvlm-256m"
FRAMES = 8
"""Frames worth showing to the model: 64 tokens each in the published sizes."""
IMAGE, AROUND, WHOLE = "<image>", "<fake_token_around_image>", "<global-img>"


class SmolVlmTeacher:
    """Frames to the grid of the vision tower's last hidden state, not normalised."""

    def __init__(self, model: str | Path | None = None) -> None:
        self.weights = find(DEFAULT, model)
        self.model: Any = load(transformers.SmolVLMForConditionalGeneration, self.weights).model.vision_model

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec for pictures of any size: they are stretched to the model's square."""
        vision = self.model.config
        return FeatureSpec(
            name="smolvlm",
            dim=vision.hidden_size,
            grid=(vision.image_size // vision.patch_size,) * 2,
            resize="area",
            normalised=False,
            text_encoder=None,
            temperature=None,
            has_global=False,
            provenance=self.weights.provenance([vision.image_size] * 2),
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return the features (h,w,C) float32 of a picture (H,W,3) uint8."""
        side, grid = self.model.config.image_size, self.spec_for(*rgb.shape[1::-1]).grid
        with torch.inference_mode(), memory_guard(f"SmolVLM on {side} x {side} pixels"):
            tokens = self.model(image_tensor(rgb, (side, side), MEAN, STD, mode="bicubic")).last_hidden_state
        return tokens[0].unflatten(0, grid).numpy().astype(np.float32)


class SmolVlm:
    """Answers questions about frames that are given as feature maps."""

    def __init__(self, model: str | Path | None = None) -> None:
        weights = find(DEFAULT, model)
        self.name = weights.name
        self.model: Any = load(transformers.SmolVLMForConditionalGeneration, weights)
        self.tokenizer = load_tokenizer(weights)
        vision = self.model.config.vision_config
        self.grid = (vision.image_size // vision.patch_size,) * 2
        self.tokens_per_frame = self.grid[0] * self.grid[1] // self.model.config.scale_factor**2

    def answer(
        self,
        features: Sequence[np.ndarray],
        seconds: Sequence[float],
        question: str,
        history: Sequence[tuple[str, str]] = (),
        max_tokens: int = 64,
    ) -> str:
        """Return the model's words about frames whose `smolvlm` maps (h,w,C) were seen at `seconds` of the video.

        `history` holds earlier (question, answer) pairs, `max_tokens` is the most new tokens. Greedy: the same every time.
        Errors: F4xError for an empty question, no frames, or maps of another shape.
        """
        if not question.strip():
            raise F4xError("The question is empty: ask something.")
        if any(sign in question for sign in (IMAGE, AROUND, WHOLE)):
            raise F4xError(
                f"The question contains {IMAGE} or a sign like it, which the model reserves for pictures: leave it out."
            )
        if not len(features) or len(features) != len(seconds):
            raise F4xError(
                f"{len(features)} feature maps with {len(seconds)} times: give one time for each, and at least one."
            )
        width = self.model.config.vision_config.hidden_size
        for frame in features:
            if np.shape(frame) != (*self.grid, width):
                raise F4xError(f"A feature map has shape {np.shape(frame)}; {self.name} reads {(*self.grid, width)}.")
        text = self.prompt(seconds, question, history)
        with torch.inference_mode(), memory_guard(f"{self.name} on {len(features)} frames"):
            embeds = self.embeddings(text, np.stack([np.asarray(frame, np.float32) for frame in features]))
            new = self.model.generate(
                inputs_embeds=embeds,
                attention_mask=torch.ones(embeds.shape[:2], dtype=torch.long),
                max_new_tokens=max_tokens,
                do_sample=False,
                pad_token_id=self.tokenizer.pad_token_id,
            )  # (1,n): the new tokens only
        return self.tokenizer.decode(new[0], skip_special_tokens=True).strip()

    def prompt(self, seconds: Sequence[float], question: str, history: Sequence[tuple[str, str]] = ()) -> str:
        """Return the conversation as SmolVLM2 was trained to read a video: frames with their times, then the questions."""
        image = AROUND + WHOLE + IMAGE * self.tokens_per_frame + AROUND
        shown = "".join(f"\nFrame from {_clock(second, 'mm:ss')}:{image}" for second in seconds)
        length = _clock(seconds[-1], "h:mm:ss")
        intro = f"You are provided the following series of {len(seconds)} frames from a {length} [H:MM:SS] video.\n"
        turns = [*history, (question, None)]
        text = "<|im_start|>"
        for index, (asked, answered) in enumerate(turns):
            text += (
                "User: "
                + (f"{intro}{shown}\n\n" if index == 0 else "")
                + f"{asked.strip()}<end_of_utterance>\nAssistant:"
            )
            text += "" if answered is None else f" {answered}<end_of_utterance>\n"
        return text

    def embeddings(self, text: str, features: np.ndarray) -> torch.Tensor:
        """Return the token embeddings (1,n,D) of `text` with `features (f,h,w,C)` at the places of its image tokens."""
        ids = self.tokenizer(text, return_tensors="pt", add_special_tokens=False)["input_ids"]
        places = ids == self.model.config.image_token_id
        embeds = self.model.get_input_embeddings()(ids)
        images = self.model.model.connector(torch.from_numpy(features).flatten(1, 2))  # (f,tokens,D)
        if int(places.sum()) != images.shape[0] * images.shape[1]:
            raise F4xError(f"{self.name}: its tokenizer does not know {IMAGE}; fetch the model again.")
        return embeds.masked_scatter(places[..., None], images.to(embeds.dtype))


def _clock(second: float, form: str) -> str:
    minutes, rest = divmod(int(second), 60)
    return f"{minutes:02d}:{rest:02d}" if form == "mm:ss" else f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
