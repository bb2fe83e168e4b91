"""SAM 2.1: the teacher that reads frames, and the decoder that masks whole videos from feature maps alone.

`Sam2VideoModel` keeps its memory attention, memory encoder, prompt encoder and mask decoder (11.7 M weights in every
variant); the image encoder is removed, so that it cannot be called. "Frames" of the session are frame numbers, for which
`get_image_features` fetches feature maps. Facts: algorithm 13.1 (Feature4X keeps the last level of the feature pyramid only,
which equals zeros in the two finer ones: `skips = "zero"`); `"distilled"` feeds these two from their own heads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch.nn import functional

from ...errors import F4xError
from ..memory import memory_guard
from ..preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor
from ..spec import FeatureSpec
from .loading import find, load, transformers
from .prompt import Prompt, check_frame, check_prompt

DEFAULT = "sam2-tiny"
LEVELS = {"sam2_s0": 0, "sam2_s1": 1, "sam2": 2}
"""Head -> level of the feature pyramid, fine to coarse; the fine two are the skip connections of the mask decoder."""
BOX_LABELS = (2, 3)
"""Point labels with which the prompt encoder knows the corners of a box."""

FeatureSource = Callable[[int], np.ndarray]
"""Frame number -> (h,w,C) float32."""


class Sam2Teacher:
    """Frames to one level of SAM 2's feature pyramid (`LEVELS`), not normalised, without the no-memory embedding."""

    def __init__(self, model: str | Path | None = None, head: str = "sam2") -> None:
        self.head, self.level = head, LEVELS[head]
        self.weights = find(DEFAULT, model)
        self.model: Any = load(transformers.Sam2VideoModel, self.weights)

    def spec_for(self, width: int, height: int) -> FeatureSpec:
        """Return the spec for pictures of any size: they are stretched to the model's square."""
        decoder = self.model.config.mask_decoder_config.hidden_size
        return FeatureSpec(
            name=self.head,
            dim=(decoder // 8, decoder // 4, decoder)[self.level],
            grid=tuple(self.model.backbone_feature_sizes[self.level]),
            resize="bilinear",
            normalised=False,
            text_encoder=None,
            temperature=None,
            has_global=False,
            provenance=self.weights.provenance([self.model.image_size] * 2),
        )

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """Return the features (h,w,C) float32 of a picture (H,W,3) uint8."""
        side = self.model.image_size
        with torch.inference_mode(), memory_guard(f"SAM 2 on {side} x {side} pixels"):
            pixels = image_tensor(rgb, (side, side), IMAGENET_MEAN, IMAGENET_STD)  # (1,3,side,side)
            flat = self.model.get_image_features(pixels, return_dict=True).fpn_hidden_states[self.level]  # (hw,1,C)
        height, width = self.model.backbone_feature_sizes[self.level]
        return flat[:, 0].reshape(height, width, -1).numpy().astype(np.float32)


class FeatureSam2(transformers.Sam2VideoModel):
    """SAM 2 without its image encoder; reads full checkpoints and those that `save_pretrained` made of itself."""

    _keys_to_ignore_on_load_unexpected = [r"^vision_encoder\."]  # noqa: RUF012 - as the base class declares it

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        del self.vision_encoder
        self.source: Callable[[int], list[torch.Tensor]] | None = None
        """Frame number -> maps (C,h,w) of the three levels, fine to coarse."""

    def get_input_embeddings(self) -> None:  # type: ignore[override]
        """None: there is no encoder."""

    def get_image_features(self, pixel_values: torch.Tensor, **_: Any) -> Any:
        """Return the maps of the frame whose number is `pixel_values`, flattened as the tracker wants them (hw,1,C)."""
        assert self.source is not None
        maps = self.source(int(pixel_values))
        flat = [level.flatten(1).T[:, None] for level in maps]
        position = sine_position_encoding(*maps[-1].shape).flatten(1).T[:, None]
        # The tracker reads the coarsest position encoding only.
        output: Any = transformers.models.sam2_video.modeling_sam2_video.Sam2VideoVisionEncoderOutput
        return output(last_hidden_state=None, fpn_hidden_states=flat, fpn_position_encoding=[*flat[:-1], position])


def sine_position_encoding(channels: int, height: int, width: int) -> torch.Tensor:
    """Return (C,h,w) float32: sines of the row in the first half of the channels, of the column in the second (DETR, A.4)."""
    half = channels // 2
    frequency = 10000 ** (2 * torch.div(torch.arange(half), 2, rounding_mode="floor") / half)  # (half,)
    parts = []
    for length in (height, width):
        place = torch.arange(1, length + 1, dtype=torch.float32)
        angle = (place / (length + 1e-6) * (2 * math.pi))[:, None] / frequency  # (length,half)
        parts.append(torch.stack((angle[:, 0::2].sin(), angle[:, 1::2].cos()), 2).flatten(1))
    rows = parts[0][:, None].expand(height, width, half)
    columns = parts[1][None].expand(height, width, half)
    return torch.cat((rows, columns), 2).permute(2, 0, 1)


def load_sam2(model: str | Path | None = None) -> FeatureSam2:
    """Return everything of SAM 2 behind the encoder, from a full checkpoint or what `save_pretrained` wrote of one.

    It must be of the variant that the teacher used: `FeatureSpec.provenance["model"]` says which.
    """
    return load(FeatureSam2, find(DEFAULT, model))


class Sam2MaskDecoder:
    """Masks of one object through a video, from feature maps (`query.segmentation.MaskDecoder`).

    `features(t)` gives the `sam2` map (64,64,256) of frame t in [0, count), rendered or extracted; `skips(t)` the maps of
    `sam2_s0` (256,256,32) and `sam2_s1` (128,128,64), zeros without it. `size (H, W)` are the pictures of prompts and logits.
    `memory` counts the frames remembered, a prompted one among them (7 as trained, and the time grows with it).
    """

    def __init__(
        self,
        model: FeatureSam2,
        features: FeatureSource,
        count: int,
        size: tuple[int, int],
        skips: Callable[[int], tuple[np.ndarray, np.ndarray]] | None = None,
        memory: int | None = None,
    ) -> None:
        self.model: Any = model
        self.count, self.size = count, size
        self._features, self._skips = features, skips
        max_memory = self.model.config.num_maskmem
        self._memory = max_memory if memory is None else memory
        if not 1 <= self._memory <= max_memory:
            raise F4xError(f"SAM 2 remembers 1 to {max_memory} frames, not {memory}.")
        self._prompts: dict[int, Prompt] = {}
        self._session: Any = None

    @property
    def skips(self) -> str:
        """`zero` or `distilled`: what the skip connections of the mask decoder are fed with."""
        return "zero" if self._skips is None else "distilled"

    def prompt(
        self,
        t: int,
        points: ArrayLike | None = None,
        labels: ArrayLike | None = None,
        box: ArrayLike | None = None,
        mask: ArrayLike | None = None,
    ) -> np.ndarray:
        """Return the logits (H,W) float32 of the object on frame `t`; replaces an earlier prompt on that frame."""
        check_frame(t, self.count)
        self._prompts[t] = check_prompt(self.size, points, labels, box, mask)
        # A session built anew keeps no memory of replaced prompts; replaying the others costs one decoding each.
        self._session = self._new_session()
        shown = {frame: self._show(frame, prompt) for frame, prompt in sorted(self._prompts.items())}
        return self._logits(shown[t])

    def propagate(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield every frame once with its logits (H,W): from the first prompted one to the end, then back to frame 0."""
        if not self._prompts:
            raise F4xError("Nothing is prompted yet: give points, a box or a mask on some frame first.")
        start = min(self._prompts)
        self._use()
        for output in self.model.propagate_in_video_iterator(self._session, start_frame_idx=start):
            yield output.frame_idx, self._logits(output.pred_masks)
            self._use()  # another decoder may have used the model in between
        for output in self.model.propagate_in_video_iterator(self._session, start_frame_idx=start, reverse=True):
            if output.frame_idx != start:
                yield output.frame_idx, self._logits(output.pred_masks)
                self._use()

    def _new_session(self) -> Any:
        self._use()
        frames = torch.arange(self.count, dtype=torch.float32).reshape(-1, 1)  # frame numbers stand for the frames
        session = transformers.Sam2VideoInferenceSession(
            video=frames, video_height=self.size[0], video_width=self.size[1], dtype=torch.float32
        )
        session.obj_id_to_idx(1)
        return session

    def _use(self) -> None:
        self.model.source, self.model.num_maskmem = self._maps, self._memory

    def _show(self, t: int, prompt: Prompt) -> torch.Tensor:
        """Put a prompt into the session and decode its frame: (1,1,h,w) logits."""
        side = self.model.image_size
        if prompt.mask is not None:
            mask = torch.from_numpy(prompt.mask[None, None].astype(np.float32))
            mask = functional.interpolate(mask, (side, side), mode="bilinear", antialias=True, align_corners=False)
            self._session.add_mask_inputs(0, t, (mask >= 0.5).float())
        else:
            points, labels = prompt.points, prompt.labels.astype(np.int32)
            if prompt.box is not None:
                points = np.concatenate((prompt.box.reshape(2, 2), points))
                labels = np.concatenate((np.array(BOX_LABELS, np.int32), labels))
            scaled = torch.from_numpy(points / (self.size[1], self.size[0]) * side).float()
            inputs = {"point_coords": scaled[None, None], "point_labels": torch.from_numpy(labels)[None, None]}
            self._session.add_point_inputs(0, t, inputs)
        self._session.obj_with_new_inputs.append(1)
        return self.model(self._session, frame_idx=t).pred_masks

    def _maps(self, t: int) -> list[torch.Tensor]:
        """Return the three levels (C,h,w) of frame `t`, fine to coarse."""
        channels = self.model.hidden_dim
        fine = (None, None) if self._skips is None else self._skips(t)
        maps = []
        for given, width, (rows, columns), head in zip(
            (*fine, self._features(t)),
            (channels // 8, channels // 4, channels),
            self.model.backbone_feature_sizes,
            LEVELS,
            strict=True,
        ):
            if given is None:
                maps.append(torch.zeros(width, rows, columns))
            elif given.shape == (rows, columns, width):
                maps.append(torch.from_numpy(np.ascontiguousarray(given, np.float32)).permute(2, 0, 1))
            else:
                raise F4xError(
                    f"The '{head}' features of frame {t} have shape {given.shape}; this SAM 2 decodes {(rows, columns, width)}."
                )
        return maps

    def _logits(self, masks: torch.Tensor) -> np.ndarray:
        """Return (H,W) float32 from (1,1,h,w)."""
        full = functional.interpolate(masks.float(), self.size, mode="bilinear", align_corners=False)
        return full[0, 0].numpy()
