"""`f4x info`."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from ..edit.apply import open_scene
from ..edit.uncovered import summary_of, uncovered
from ..language.lexicon import plural
from ..printing import one_line
from ..progress import Progress
from ..query.knowledge import known_words, unknown_kinds, words_found
from ..scene.runs import run_lengths

MARGIN = 12
"""Characters before what is told of a scene."""
LINE = 110
"""Characters of a line of what may take several."""


def run_info(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Return the counts, sizes and provenance of a scene file."""
    scene = open_scene(args.scene, args.edits)
    info = scene.info()
    if scene.scaffold is not None:
        runs = run_lengths([scene.scaffold.xyz, scene.scaffold.quat, scene.scaffold.certain])
        info["poses"] = {"all": scene.scaffold.certain.size, "kept": len(runs)}
    unknown = unknown_kinds(scene)
    info["words"], info["unknown_words"], info["found"] = known_words(scene, unknown), [*unknown], words_found(scene)
    lines = [f"{name + ':':<{MARGIN}}{one_line(value)}" for name, value in summary(info).items()]
    shows = uncovered(scene)
    if shows is not None:
        info["uncovered"] = shows.to_json()
    words = ", ".join(info["words"])
    if unknown:
        kinds = ", ".join(dict.fromkeys(unknown.values()))
        words += f" (not looked for, since the teacher of words knows no {kinds}: {len(unknown)} more)"
    found = ", ".join(info["found"]) or "no word that is looked for"
    long = [("uncovered", summary_of(shows)), ("answers to", found)]
    long += [("looked for", words)] if words else []
    long += [("reading", sentence) for sentence in sentences(info["provenance"].get("reading"))]
    for title, text in long:
        first = f"{title + ':':<{MARGIN}}"
        lines += textwrap.wrap(text, LINE, initial_indent=first, subsequent_indent=" " * MARGIN)
    return {**info, "text": "\n".join(lines)}


def sentences(reading: object) -> list[str]:
    """Return the remarks on its clip that a scene file holds, checked, since a file may hold anything."""
    return [each for each in reading if isinstance(each, str)] if isinstance(reading, list) else []


def summary(info: dict[str, Any]) -> dict[str, str]:
    """Return title -> text for about ten lines that summarise `Scene.info`."""
    width, height = info["size"]
    parts = info["megabytes"]
    by_part = ", ".join(f"{part} {megabytes:.1f}" for part, megabytes in parts.items() if megabytes)
    metrics, made = info["metrics"], info["provenance"]
    quality = {
        "used_psnr": "used frames",
        "held_out_psnr_registered": "held-out frames",
        "held_out_psnr_flow_blend_registered": "a blend of their neighbours",
        "held_out_psnr": "held-out frames, interpolated cameras",
    }
    measured = [f"{metrics[name]:.2f} dB ({title})" for name, title in quality.items() if name in metrics]
    baked = len(made.get("baked", ()))
    if measured and baked:  # of the scene that was fitted
        measured.append(f"before {baked} {plural('edit', baked)} {'was' if baked == 1 else 'were'} baked")
    after = ""
    if "edited" in info:
        after = ", after which there are {gaussians:,} Gaussians: {copies:,} copies, {gone:,} gone".format(
            **info["edited"]
        )
    moments = info["color_moments"]
    changes = f", colors of {moments} moments" if moments else ""
    poses = ""
    if "poses" in info and info["poses"]["kept"] < info["poses"]["all"]:
        poses = "; {kept:,} of {all:,} poses stored, the others repeat the frame before".format(**info["poses"])
    return {
        "name": info["name"],
        "frames": f"{info['frames']}, {info['held_out']} of them held out",
        "pictures": f"{width}x{height} pixels",
        "video": f"{info['frames'] / info['fps']:.2f} s at {info['fps']:g} frames per second",
        "Gaussians": f"{info['static']:,} static, {info['dynamic']:,} dynamic, SH degree {info['sh_degree']}{changes}",
        "nodes": f"{info['nodes']:,}{poses}",
        "memory": f"{sum(parts.values()):.1f} MB: {by_part}",
        "PSNR": ", ".join(measured) or "not measured",
        "edits": f"{info['edits']}{after}",
        "source": made.get("source", "unknown") + (f", frames {made['frames']}" if made.get("frames") else ""),
        "made by": f"Feature4X {made['feature4x']}" if "feature4x" in made else "unknown",
    }
