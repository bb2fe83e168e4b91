"""Small valid files of every kind that the program reads, and damaged copies of them: random bytes, and what a liar would write.

`try_all` reads copies in processes of its own, which are ended where they hang, and measures processor time and memory.
"""

import contextlib
import copy
import dataclasses
import gzip
import io
import json
import multiprocessing
import resource
import struct
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from random_scene import random_scene
from warped_clip import texture

from f4x_core.app.selecting import mask_of, read_selection
from f4x_core.batch.manifest import read_manifest
from f4x_core.cli.measuring import _read_joints
from f4x_core.clip import write_video
from f4x_core.clip.read import read_clip
from f4x_core.edit.apply import base_of, open_scene
from f4x_core.edit.json_files import read_operations
from f4x_core.edit.operations import read_operation
from f4x_core.edit.stack import EditStack, with_stack
from f4x_core.errors import F4xError
from f4x_core.features.maps import MapsPlan, read_maps, write_maps
from f4x_core.features.precomputed import Precomputed
from f4x_core.features.spec import FeatureSpec
from f4x_core.files import json_text
from f4x_core.fit.checkpoint import load_checkpoint, save_checkpoint
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors.files import _read_array
from f4x_core.priors.folder import Priors
from f4x_core.query.selection import Selection
from f4x_core.reading import DAMAGE
from f4x_core.scene import write_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export
from f4x_core.scene.formats.web import write_page
from f4x_core.scene.ply import read_properties

SECONDS, BYTES = 10, 1 << 30
"""Of processor time and of additional memory that one small file may cost."""
PATIENCE = 6 * SECONDS
"""Seconds of the clock after which a child counts as hanging: the machine may be busy."""
NUMBERS = (0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64, 10**400, 1e308, -1e308, 0.5)
VALUES = (None, True, "", "x" * 5000, "../../x", "\0", [], {}, [[]], [{}], float("inf"), float("nan"), *NUMBERS)
"""Replacements for a node of a JSON document."""
WORDS = (b"-1", b"0", b"999999999999", b"1e999", b"nan", b"x", b"", b"{}", b"[" * 5000, b"\0", b"\xff\xfe", b"1" * 5000)
"""Replacements for a number in a text."""
SEED = 2
"""Another one gives other copies."""
NPY_HEAD = 128
"""Bytes before the numbers of a .npy."""
MOST = 1 << 20
"""Bytes of a damaged copy at most."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """Something that the program reads."""

    make: Callable[[Path], Path]
    """Writes it into a folder, and returns the file of it that is damaged."""
    read: Callable[[Path], object]
    """Reads it all, given that file."""
    holds: str = "bytes"
    """`bytes`, `text`, `json`, `zip`, `gzip`, `scene` (a zip with digests) or `glb`: which lies it can tell."""


# ---------------------------------------------------------------------------------------------------------------- valid


def splats(suffix: str, count: int = 12, **options) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / f"a.{suffix}"
        name = {"glb": "gltf"}.get(suffix, suffix)
        export(random_scene(static=count, **options), path, [1.0], name)
        return path

    return make


def ascii_ply(folder: Path) -> Path:
    path = splats("ply", degree=0)(folder)
    vertices = read_properties(path)
    head = path.read_bytes().split(b"end_header\n")[0].replace(b"binary_little_endian", b"ascii")
    rows = "\n".join(" ".join(map(repr, row.tolist())) for row in vertices)
    path.write_bytes(head + b"end_header\n" + rows.encode() + b"\n")
    return path


def scene_file(folder: Path) -> Path:
    path = folder / "a.f4x"
    picture = {"left": 2, "top": 0, "width": 60, "height": 40}
    known = {"source": "a.mp4", "frames": "0:6:1", "believed_degrees": 8.5, "picture": picture, "baked": []}
    scene = random_scene(static=9, dynamic=6, provenance=known)
    span = np.tile(np.array([0, 1, 2, 3], np.float32), (9, 1))
    stack = EditStack()
    for number, operation in enumerate(OPERATIONS):
        stack = stack.append(
            read_operation(operation | ({"first_id": 50} if "offset" in operation else {}), f"operation {number}")
        )
    write_scene(
        with_stack(dataclasses.replace(scene, static=dataclasses.replace(scene.static, span=span)), stack), path
    )
    return path


def cameras(folder: Path) -> Path:
    random_scene().cameras.write(folder / "cameras.json")
    return folder / "cameras.json"


def written(name: str, content: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    return make


OPERATIONS = [
    {"op": "recolour", "select": {"by": "moving"}, "rgb": [1, 0, 0], "frames": [1, 4]},
    {"op": "duplicate", "select": {"by": "moving"}, "offset": [1.2, 0, 0], "name": "twin"},
    {"op": "transform", "select": {"by": "named", "name": "twin"}, "rotate": [0, 90, 0], "frames": [1, 3]},
    {"op": "delete", "select": {"by": "and", "of": [{"by": "moving"}, {"by": "ids", "ids": [3, 11]}]}},
]


def selection(folder: Path) -> Path:
    chosen = Selection(np.arange(30), np.linspace(0, 1, 30), np.arange(30) % 3 == 0, span=(0, 3))
    return written("selection.json", json.dumps(chosen.to_json()))(folder)


def joints(folder: Path) -> Path:
    frames = [{"frame": frame, "joints": {"knee": [3, 4.5], "hip": [9, 2]}} for frame in (0, 3)]
    return written("joints.json", json.dumps({"size": [64, 40], "frames": frames}))(folder)


def priors(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        scene, shape = random_scene(), (6, 8, 10)
        found = Priors(10, 8, np.arange(6), camera_kind="moving", cameras=scene.cameras.resized(10, 8))
        found.depth, found.mask = np.ones(shape, np.float32), np.zeros(shape, bool)
        found.tracks, found.tracks_visible = np.ones((6, 4, 2), np.float32), np.ones((6, 4), bool)
        found.write(folder)
        return folder / name

    return make


def prior_file(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path, values = folder / name, np.linspace(0, 1, 6 * 8 * 10).reshape(6, 8, 10)
        if name.endswith(".npz"):
            np.savez_compressed(path, depth=values)
        elif name.endswith(".npy"):
            np.save(path, values)
        else:
            Image.fromarray((values[0] * 255).astype(np.uint8)).save(path)
        return path

    return make


def feature_maps(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        maps = [np.full((3, 4, 5), value, np.float32) for value in (0.5, 1)]
        write_maps(folder / "maps", MapsPlan(FeatureSpec("look", 5, (3, 4)), 2), maps)
        return folder / "maps" / name

    return make


def other_maps(folder: Path) -> Path:
    np.savez(folder / "map.npz", map=np.ones((2, 3, 4, 5), np.float32))
    return folder / "map.npz"


def checkpoint(folder: Path) -> Path:
    import torch

    state = {"config_hash": "abc", "step": 3, "sets": {"static": {"means": torch.ones(4, 3)}}, "history": "[]"}
    save_checkpoint(folder / "a.pt", state)
    return folder / "a.pt"


def film(folder: Path) -> Path:
    write_video(folder / "a.mp4", np.stack([texture(32, 48, i) for i in range(4)]), 24)
    return folder / "a.mp4"


def pictures(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        for number in range(3):
            Image.fromarray(texture(24, 32, number)).save(folder / f"{number}.{suffix}")
        return folder / f"1.{suffix}"

    return make


def mask(folder: Path) -> Path:
    Image.fromarray(np.eye(40, 64, dtype=np.uint8) * 255).save(folder / "mask.png")
    return folder / "mask.png"


def posed(path: Path) -> object:
    return open_any(path).posed(0.0)


def edited(path: Path) -> object:
    scene = open_scene(path)
    json_text(scene.info())
    write_page(base_of(scene), path.with_name("page.html"))
    return scene.posed(1.0)


MANIFEST = [{"clip": "a.mp4", "name": "a", "frames": "0:20", "exports": ["ply"]}, {"clip": "b.mp4", "width": 320}]
KINDS = {
    "scene": Kind(scene_file, edited, "scene"),
    "ply": Kind(splats("ply"), posed, "text"),
    "ascii ply": Kind(ascii_ply, posed, "text"),
    "splat": Kind(splats("splat"), posed),
    "spz": Kind(splats("spz"), posed, "gzip"),
    "gltf": Kind(splats("gltf"), posed, "json"),
    "glb": Kind(splats("glb"), posed, "glb"),
    "cameras": Kind(cameras, CameraPath.read, "json"),
    "operations": Kind(written("edits.json", json.dumps(OPERATIONS)), read_operations, "json"),
    "selection": Kind(selection, read_selection, "json"),
    "joints": Kind(joints, _read_joints, "json"),
    "manifest csv": Kind(
        written("a.csv", "clip,name,frames,width\na.mp4,a,0:20,320\nb.mp4,b,,\n"),
        lambda path: read_manifest(str(path)),
        "text",
    ),
    "manifest json": Kind(written("a.json", json.dumps(MANIFEST)), lambda path: read_manifest(str(path)), "json"),
    "priors head": Kind(priors("priors.json"), lambda path: Priors.read(path.parent), "json"),
    "priors cameras": Kind(priors("cameras.json"), lambda path: Priors.read(path.parent), "json"),
    "priors depth": Kind(priors("depth.npy"), lambda path: Priors.read(path.parent)),
    "priors tracks": Kind(priors("tracks.npy"), lambda path: Priors.read(path.parent)),
    "prior npy": Kind(prior_file("depth.npy"), lambda path: _read_array("depth", path)),
    "prior npz": Kind(prior_file("depth.npz"), lambda path: _read_array("depth", path), "zip"),
    "prior png": Kind(prior_file("depth.png"), lambda path: _read_array("depth", path)),
    "feature spec": Kind(feature_maps("spec.json"), lambda path: read_maps(path.parent), "json"),
    "feature maps": Kind(feature_maps("maps.npy"), lambda path: read_maps(path.parent)),
    "other maps": Kind(other_maps, lambda path: Precomputed(path).read(0), "zip"),
    "checkpoint": Kind(checkpoint, lambda path: load_checkpoint(path, "abc"), "zip"),
    "mask": Kind(mask, lambda path: mask_of(path, random_scene())),
    "film": Kind(film, read_clip),
    "png clip": Kind(pictures("png"), lambda path: read_clip(path.parent)),
    "jpg clip": Kind(pictures("jpg"), lambda path: read_clip(path.parent)),
}

# -------------------------------------------------------------------------------------------------------------- damaged


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A copy with random damage of one sort."""
    size, at = len(data), int(rng.integers(max(len(data), 1)))
    length = int(rng.integers(1, max(size // 4, 2)))
    sort = rng.integers(8)
    if sort == 0:
        return data[:at]
    if sort == 1:
        changed = bytearray(data)
        for place in rng.integers(0, max(size, 1), int(rng.integers(1, 9))) if size else ():
            changed[place] = rng.integers(256)
        return bytes(changed)
    if sort == 2:
        return data[:at] + bytes(length) + data[at + length :]
    if sort == 3:
        return data[:at] + data[at : at + length] * int(rng.integers(2, 200)) + data[at + length :]
    if sort == 4:
        source = int(rng.integers(max(size, 1)))
        return data[:at] + data[source : source + length] + data[at + length :]
    if sort == 5:
        return data[:at] + rng.bytes(length) + data[at:]
    number = int(NUMBERS[int(rng.integers(9))]) & (2**64 - 1)
    width, order = (4, 8)[rng.integers(2)], ("little", "big")[rng.integers(2)]
    return data[:at] + (number & (256**width - 1)).to_bytes(width, order) + data[at + width :]


def renumbered(data: bytes, rng: np.random.Generator) -> bytes:
    """A copy of a text in which one word is another."""
    words = data[: 1 << 12].split(b" ")
    words[int(rng.integers(len(words)))] = WORDS[int(rng.integers(len(WORDS)))]
    return b" ".join(words) + data[1 << 12 :]


def lying(content: object, rng: np.random.Generator) -> bytes:
    """The text of a JSON document of which one node is something else, is gone, or is there very often."""
    content = copy.deepcopy(content)
    nodes = [(content, key) for key in _keys(content)]
    for parent, key in nodes:  # grows while it is walked
        nodes += [(parent[key], below) for below in _keys(parent[key])]
    if not nodes:
        return json.dumps(content).encode()
    parent, key = nodes[int(rng.integers(len(nodes)))]
    sort = rng.integers(6)
    if sort == 0:
        del parent[key]
    elif sort == 1:
        parent[key] = [parent[key]] * int(rng.integers(2, 3000))
    elif sort == 2:
        text = json.dumps(content)
        depth = int(rng.choice([150, 900, 50_000]))
        marked = json.dumps(parent[key])
        return text.replace(marked, "[" * depth + marked + "]" * depth, 1).encode()
    elif sort == 3:
        other, name = nodes[int(rng.integers(len(nodes)))]
        parent[key] = copy.deepcopy(other[name])
    else:
        parent[key] = VALUES[int(rng.integers(len(VALUES)))]
    return json.dumps(content).encode()


def _keys(node: object) -> list:
    return list(node) if isinstance(node, dict) else list(range(len(node))) if isinstance(node, list) else []


def rezipped(data: bytes, rng: np.random.Generator, digests: bool) -> bytes:
    """A zip of which one member is damaged, with the right checksums (and, in a scene, digests)."""
    import hashlib

    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = list(members)[int(rng.integers(len(members)))] if rng.random() < 0.5 else next(iter(members))
    if name.endswith(".json"):
        members[name] = lying(json.loads(members[name]), rng)
    else:
        head, numbers = members[name][:NPY_HEAD], members[name][NPY_HEAD:]
        if rng.random() < 0.7:
            members[name] = head + damaged(numbers, rng)[: len(numbers)].ljust(len(numbers), b"\0")
        else:
            members[name] = damaged(head + numbers, rng)
        if digests:
            header = json.loads(members["scene.json"])
            entry = header["arrays"][name.removesuffix(".npy")]
            entry["sha256"] = hashlib.sha256(members[name]).hexdigest()
            with contextlib.suppress(*DAMAGE):
                stream = io.BytesIO(members[name])
                np.lib.format.read_magic(stream)
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                entry |= {"shape": list(shape), "dtype": dtype.str}
            members["scene.json"] = json.dumps(header).encode()
    target, pressed, twice = io.BytesIO(), rng.random() < 0.05, rng.random() < 0.05
    with warnings.catch_warnings(), zipfile.ZipFile(target, "w") as archive:
        warnings.simplefilter("ignore")  # of names that are there twice
        for member, content in members.items():
            archive.writestr(member, content, zipfile.ZIP_DEFLATED if pressed else None)
            if twice:
                archive.writestr(member, content)
    return target.getvalue()


def mutant(kind: Kind, data: bytes, rng: np.random.Generator) -> bytes:
    """One damaged copy of a valid file."""
    if rng.random() < (0.4 if kind.holds in ("bytes", "text") else 0.1):
        return damaged(data, rng)[:MOST]
    if kind.holds == "json":
        return lying(json.loads(data), rng)
    if kind.holds == "text":
        return renumbered(data, rng)
    if kind.holds == "gzip":
        return gzip.compress(damaged(gzip.decompress(data), rng)[:MOST])
    if kind.holds == "glb":
        size = struct.unpack_from("<I", data, 12)[0]
        text = lying(json.loads(data[20 : 20 + size]), rng)
        return data[:12] + struct.pack("<I", len(text)) + b"JSON" + text + data[20 + size :]
    if kind.holds in ("zip", "scene") and kind.make is not checkpoint:
        return rezipped(data, rng, kind.holds == "scene")[:MOST]
    return damaged(data, rng)[:MOST]


# -------------------------------------------------------------------------------------------------------------- reading


@dataclasses.dataclass(frozen=True)
class Outcome:
    """The outcome of reading one damaged copy."""

    name: str
    number: int
    trouble: str
    """The traceback of what no reader may raise; empty where it was read, or refused in one sentence."""
    refused: str
    """The sentence; empty where it was read."""
    seconds: float
    """Of processor time."""
    memory: int
    """Bytes that the process held beyond those before."""


def try_all(folder: Path, jobs: list[tuple[str, int]]) -> list[Outcome]:
    """Read damaged copy `number` of kind `name` for all `jobs`, in child processes."""
    # Children of the test process itself would inherit locks of threads that are not there any more.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    outcomes, waiting = [], list(jobs)
    while waiting:
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(target=_try_some, args=(folder, waiting, sender))
        child.start()
        sender.close()
        done = 0
        with contextlib.suppress(EOFError):
            while receiver.poll(PATIENCE):
                outcomes.append(receiver.recv())
                done += 1
        if child.is_alive() and done < len(waiting):
            child.kill()
        child.join()
        if done < len(waiting):  # it hung, or was ended by the system
            outcomes.append(Outcome(*waiting[done], f"ended or hanging, exit code {child.exitcode}", "", PATIENCE, 0))
            done += 1
        waiting = waiting[done:]
    return outcomes


def _try_some(folder: Path, jobs: list[tuple[str, int]], sender) -> None:
    made: dict[str, tuple[Path, bytes]] = {}
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    room = _memory("VmSize") + 3 * BYTES  # what is asked for and not touched does not count, but must have an end
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
    for name, number in jobs:
        if name not in made:
            place = Path(tempfile.mkdtemp(dir=folder))
            path = KINDS[name].make(place)
            made[name] = path, path.read_bytes()
        path, whole = made[name]
        path.write_bytes(mutant(KINDS[name], whole, np.random.default_rng([SEED, number, *name.encode()])))
        sender.send(try_one(name, number, path))


def try_one(name: str, number: int, path: Path) -> Outcome:
    """Read one file that may be damaged."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak of memory starts anew
    before, began = _memory("VmRSS"), time.process_time()
    trouble, refused = "", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            KINDS[name].read(path)
    except F4xError as error:
        refused = str(error)
        trouble = "more than one line" if "\n" in refused else ""
    except Exception:
        trouble = traceback.format_exc()
    return Outcome(name, number, trouble, refused, time.process_time() - began, _memory("VmHWM") - before)


def _memory(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(field))
