"""A stand-in for `f4x` in tests and benchmarks of the batch: `python -m benchmarks.speed.batch_stub VERB …` takes milliseconds.

It writes files with the right names, whose content depends on the clip and the arguments. A clip is a JSON file that controls
the verbs: `{"steps": 20, "seconds": 0.1, "fail": {"fit": "a sentence"}, "die": {"priors": 9}, "note": {"fit":
"a sentence"}}`.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from f4x_core.processes import LineProgress, stop_with_parent


def main(arguments: list[str]) -> int:
    """Pretend to run one verb and return the exit code."""
    stop_with_parent()
    lines = LineProgress(sys.stdout)
    verb, source = arguments[0], Path(arguments[1])
    content = source.read_bytes()
    clip = json.loads(content) if verb in ("priors", "fit") else {}
    print(f"stub {verb}", file=sys.stderr)
    if verb in clip.get("die", {}):
        os.kill(os.getpid(), clip["die"][verb])
    if verb in clip.get("fail", {}):
        lines.tell(error=clip["fail"][verb])
        return 2
    target = Path(arguments[arguments.index("-o") + 1]) if "-o" in arguments else source
    words = [word for word in arguments[2:] if word != "--resume"]
    result: dict[str, Any] = {}
    if verb == "fit":
        result = _fit(content, clip, words, target, lines)
    else:
        part = int(arguments[arguments.index("--part") + 1].split("/")[0]) - 1 if "--part" in arguments else 0
        names = {"priors": "priors/depth.npy", "render": f"rgb/{part:05d}.png", "query": "selection.json"}
        name = names.get(verb, "")
        name = "name_0000.ply" if verb == "export" and not target.suffix else name
        _write(target / name, _digest(content, *words))
    if verb in clip.get("note", {}):
        result["note"] = clip["note"][verb]
    lines.tell(result=result, text="")
    return 0


def _fit(content: bytes, clip: dict[str, Any], words: list[str], target: Path, lines: LineProgress) -> dict[str, Any]:
    """A chain of hashes, one for each step, with a checkpoint after each."""
    alone = "--window" in words
    place = target / "windows" / "000" if alone else target
    steps, checkpoint = clip.get("steps", 1), place / "checkpoints" / "photometric.pt"
    first, state = 0, _digest(content, "" if alone else (target / "priors" / "depth.npy").read_text(), *words)
    if checkpoint.is_file():
        first, state = json.loads(checkpoint.read_text())
    for step in range(first, steps):
        time.sleep(clip.get("seconds", 0) / steps)
        state = _digest(state.encode())
        _write(checkpoint, json.dumps([step + 1, state]))
        lines("fit", step + 1, steps)
    _write(target / "scene.f4x", state)
    return {"metrics": {"used_psnr": 30.0, "first_step": first}}


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    beside.write_text(text)
    beside.replace(path)


def _digest(content: bytes, *words: str) -> str:
    return hashlib.sha256(content + "\n".join(words).encode()).hexdigest()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
