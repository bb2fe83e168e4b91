"""Rendered clips with truth: a scene of `clip.rendered_scenes`, what moves in it, a hand-held camera.

World frame of the truth: Blender's own (metres, z up). Cameras in it are OpenCV cameras (`world_to_camera`).
Everything is lit by one sharp sun plus an emission that stands for sky light, so 12 samples are already clean.

    OUT/images/%05d.png    sRGB, Standard view transform
    OUT/truth/%05d.exr     multilayer float32: Combined, Depth.Z (z depth, 1e10 = nothing), Vector, Position and
                           the object index (`IndexOB.X` from Blender 4.x, `Object Index.X` from 5.x)
    OUT/truth.json         cameras, moving object indices, extra cameras, people (model, object index, height in metres)
    OUT/joints.npy         (T,M,33,3) float32 world: joints of the people in that order (`priors.joints`)
    OUT/images_left10 ...  the same moments from 10 degrees to the side, on request
    OUT/truth_left10 ...   their passes

Truth flow in pixels (x right, y down): forward t -> t+1 = (-Vector.Z, +Vector.W); backward t -> t-1 = (+Vector.X,
-Vector.Y). The same seed gives the same pictures in one Blender version; cell colours of the room differ between versions.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..addon.common.axes import camera_path
from ..addon.common.render_settings import save_multilayer, save_png
from ..f4x_core.clip.rendered_motion import camera_poses
from ..f4x_core.clip.rendered_scenes import RenderedScene
from ..f4x_core.errors import F4xError
from .field import build_bodies, build_field
from .figures import BuiltFigure, build_figure
from .nodes import FPS, key_linear, keyed_times
from .room import build_deforming_subject, build_room, import_walker
from .truth import MOVING_INDEX, render_frames, use_passes, write_facts

EXTRA_VIEWS = 4
"""Moments that each extra camera sees, spread evenly over the clip."""
SCENE_CENTRE = Vector((0.0, 0.0, 0.75))  # where the subject of the room stays close to, metres
CAMERA_DISTANCE = 4.6  # metres from SCENE_CENTRE
HANDHELD_STRIDE = 2  # recorded cameras per clip frame (the recording runs at twice our pace)


@dataclass(frozen=True)
class ClipSettings:
    """Settings of a rendered clip."""

    scene: RenderedScene
    frames: int = 0  # clip frames, times 0..frames-1; 0 = as the scene wants
    width: int = 240  # pixels
    height: int = 136  # pixels
    samples: int = 12  # Cycles samples per pixel
    seed: int = 0  # camera jitter, textures, furniture
    assets: Path = Path("assets")  # folder with knight.glb, fox.glb and handheld_camera.json
    lens: float = 32.0  # mm, before a sensor 36 mm wide
    extra_degrees: tuple[float, ...] = ()  # also render extra cameras so far off the path

    def __post_init__(self) -> None:
        if self.count < 1 or self.width < 16 or self.height < 16 or self.samples < 1 or not self.lens >= 1:
            raise F4xError(
                "A clip needs at least 1 frame, 16x16 pixels, 1 sample and a lens of 1 mm; raise --frames, --size, --samples or"
                " --lens."
            )
        needed = [f"{model}.glb" for model in self.scene.models]
        needed += ["handheld_camera.json"] if self.scene.camera.kind == "recorded" else []
        for name in needed:
            if not (self.assets / name).is_file():
                raise F4xError(f"{self.assets / name} is missing; give the folder that holds it with --assets.")

    @property
    def count(self) -> int:
        """Number of clip frames."""
        return self.frames or self.scene.frames


@dataclass(frozen=True)
class ExtraPose:
    """An extra camera, by its name."""

    name: str
    degrees: float
    poses: dict[int, Matrix]
    """Blender camera-to-world by clip frame."""


def write_clip(folder: Path, settings: ClipSettings) -> None:
    """Build the scene and render images and truth into `folder`; `truth.json` comes last."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = _set_up_render(settings)
    poses, figures = _build(settings)
    for material in bpy.data.materials:
        material.cycles.emission_sampling = "NONE"  # a lamp for each face would cost half the time and add noise
    camera = _add_camera(scene, "camera", poses, settings.lens)
    times = np.arange(settings.count)
    render_frames(folder, scene, times)
    people = [{"model": f.model, "index": f.index, "height": f.height} for f in figures]
    if people:
        np.save(folder / "joints.npy", _joints(scene, figures, times))

    entries = []
    chosen = times[:: max(settings.count // EXTRA_VIEWS, 1)]
    for extra in _extra_poses(settings, poses):
        scene.camera = _add_camera(scene, extra.name, extra.poses, settings.lens)
        for time in chosen:
            scene.frame_set(int(time))
            save_multilayer(scene, folder / f"truth_{extra.name}" / f"{time:05d}.exr")
            save_png(scene, folder / f"images_{extra.name}" / f"{time:05d}.png")
        path = camera_path(scene, scene.camera, chosen)
        entry = {"name": extra.name, "degrees": extra.degrees, "cameras": path.to_json()}
        entries.append(entry | {"images": f"images_{extra.name}"})

    write_facts(folder, settings.scene.name, FPS, camera_path(scene, camera, times), entries, people)


def _joints(scene: bpy.types.Scene, figures: list[BuiltFigure], times: np.ndarray) -> np.ndarray:
    """World positions (T,M,33,3) float32 of the figures' joints."""
    found = []
    for time in times:
        scene.frame_set(int(time))
        found.append([figure.joints() for figure in figures])
    return np.array(found, np.float32)


def _build(settings: ClipSettings) -> tuple[dict[int, Matrix], list[BuiltFigure]]:
    """Everything but the cameras; returns the clip camera's poses and the people."""
    spec, count = settings.scene, settings.count
    if spec.figures:
        build_field(spec, count, settings.seed)
        figures = [
            build_figure(figure, MOVING_INDEX + i, settings.assets, count) for i, figure in enumerate(spec.figures)
        ]
        return _hand_held_poses(settings), figures
    if spec.setting in ("field", "yard", "room"):
        if spec.setting == "room":
            build_room(np.random.default_rng(settings.seed))
            build_bodies(spec, count)
        else:
            build_field(spec, count, settings.seed)
        times = np.array(keyed_times(count))
        positions, targets = camera_poses(spec, times / max(count - 1, 1), settings.seed)
        return {
            int(t): _looking_at(Vector(p), Vector(q)) for t, p, q in zip(times, positions, targets, strict=True)
        }, []
    random = np.random.default_rng(settings.seed)
    build_room(random)
    if spec.setting == "procedural":
        build_deforming_subject(count)
        return _smooth_hand_poses(count, random), []
    import_walker(spec.name, settings.assets, count)
    return _recorded_hand_poses(settings), []


def _set_up_render(settings: ClipSettings) -> bpy.types.Scene:
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 0, settings.count - 1
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = settings.width, settings.height, 100
    render.fps = FPS
    use_passes(scene, settings.samples, settings.seed)
    scene.view_settings.view_transform = "Standard"
    scene.cycles.max_bounces = 0  # direct light only: no noise from bounces
    scene.cycles.use_light_tree = False  # there is one lamp; a tree over it doubles the time

    world = bpy.data.worlds.new("world")
    world.color = (0.0, 0.0, 0.0)
    world.cycles.sampling_method = "NONE"  # the sky gives no light
    scene.world = world
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.data.color = 3.8, math.radians(2.0), (1.0, 0.95, 0.86)
    sun.rotation_euler = (math.radians(38), math.radians(-22), 0.0)
    scene.collection.objects.link(sun)
    return scene


def _smooth_hand_poses(frames: int, random: np.random.Generator) -> dict[int, Matrix]:
    """Blender camera-to-world poses: a slow sweep of about a sixth of the distance, with a hand's tremble."""
    times = np.array(keyed_times(frames))
    tremble = random.normal(size=(len(times) + 8, 6))
    kernel = np.hanning(7) / np.hanning(7).sum()
    tremble = np.stack([np.convolve(c, kernel, "same") for c in tremble.T], 1)[4:-4]
    s = times / max(frames - 1, 1)
    sweep = np.stack([0.8 * (s - 0.5), 0.22 * np.sin(2.2 * s), 0.12 * np.sin(4 * s)], 1)
    position = np.array([0.0, -CAMERA_DISTANCE, 1.45]) + sweep + 0.015 * tremble[:, :3]
    target = np.array(SCENE_CENTRE) + 0.05 * tremble[:, 3:] + np.stack([0.25 * (s - 0.5), 0 * s, 0.1 + 0 * s], 1)
    return {int(t): _looking_at(Vector(p), Vector(q)) for t, p, q in zip(times, position, target, strict=True)}


def _looking_at(position: Vector, target: Vector) -> Matrix:
    rotation = (target - position).to_track_quat("-Z", "Y").to_matrix()
    return Matrix.Translation(position) @ rotation.to_4x4()


@dataclass(frozen=True)
class Recording:
    """The recorded cameras in a frame whose z is up and whose +y is the mean viewing direction."""

    offset: dict[int, Vector]
    """Clip frame -> place, from the point that all cameras look at, in mean distances to it."""
    turn: dict[int, Matrix]
    """Clip frame -> rotation from Blender's camera axes (3x3)."""

    @classmethod
    def read(cls, settings: ClipSettings) -> "Recording":
        """Read the cameras (y up, OpenCV: `orientation` = R world to camera, `position` = centre) of the clip's frames.

        They are played back and forth when the clip is longer than the recording.
        """
        record = json.loads((settings.assets / "handheld_camera.json").read_text())
        position = np.array([c["position"] for c in record])  # (n,3)
        rotation = np.array([c["orientation"] for c in record])  # (n,3,3) world to camera
        axis = rotation[:, 2]  # viewing direction in the world
        across = np.eye(3) - axis[:, :, None] * axis[:, None, :]  # (n,3,3) projects away from the ray
        seen = np.linalg.solve(across.sum(0), (across @ position[:, :, None]).sum(0))[:, 0]
        scale = 1 / np.linalg.norm(position - seen, axis=1).mean()

        last, start = len(record) - 1, settings.scene.camera.start
        index = {
            t: last - abs(last - (abs(t) * HANDHELD_STRIDE + start) % (2 * last)) for t in keyed_times(settings.count)
        }
        mean_axis = axis[list(index.values())].mean(0)
        upright = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)))  # y up -> z up
        turn = Matrix.Rotation(math.atan2(*(upright @ Vector(mean_axis)).xy), 3, "Z") @ upright
        opengl = np.diag([1.0, -1.0, -1.0])
        return cls(
            {t: turn @ Vector(scale * (position[i] - seen)) for t, i in index.items()},
            {t: turn @ Matrix(rotation[i].T @ opengl) for t, i in index.items()},
        )


def _recorded_hand_poses(settings: ClipSettings) -> dict[int, Matrix]:
    """The recorded cameras, moved and scaled so that the point they look at becomes SCENE_CENTRE."""
    record = Recording.read(settings)
    return {
        t: Matrix.Translation(SCENE_CENTRE + CAMERA_DISTANCE * offset) @ record.turn[t].to_4x4()
        for t, offset in record.offset.items()
    }


def _hand_held_poses(settings: ClipSettings) -> dict[int, Matrix]:
    """A path of the wanted length that looks at the focus, with the recorded path's form and the shake of its hand."""
    record, move = Recording.read(settings), settings.scene.camera
    first, last = record.offset[0], record.offset[settings.count - 1]
    scale = move.path * move.distance / (last - first).length
    middle, start = (first + last) / 2, Vector((0.0, -move.distance, move.height))
    focus, poses = Vector((0.0, 0.0, settings.scene.focus_height)), {}
    for time, offset in record.offset.items():
        shake = _looking_at(offset, Vector()).to_3x3().transposed() @ record.turn[time]
        ours = _looking_at(start + scale * (offset - middle), focus)
        poses[time] = ours @ shake.to_4x4()
    return poses


def _extra_poses(settings: ClipSettings, poses: dict[int, Matrix]) -> list[ExtraPose]:
    """The cameras off the path that the settings ask for."""
    focus = Vector((0.0, 0.0, settings.scene.focus_height))
    return [
        ExtraPose(f"{side}{degrees:g}", degrees, _orbited(poses, focus, side, degrees))
        for degrees in settings.extra_degrees
        for side in settings.scene.aside
    ]


def _orbited(poses: dict[int, Matrix], focus: Vector, side: str, degrees: float) -> dict[int, Matrix]:
    """Turn every pose about `focus`: about the vertical for `left` and `right`, about its own right for `up` and `down`."""
    there = Matrix.Translation(focus)
    angle = math.radians(-degrees if side in ("left", "up") else degrees)
    turned = {}
    for time, pose in poses.items():
        axis = Vector((0.0, 0.0, 1.0)) if side in ("left", "right") else pose.to_3x3().col[0]
        turned[time] = there @ Matrix.Rotation(angle, 4, axis) @ there.inverted() @ pose
    return turned


def _add_camera(scene: bpy.types.Scene, name: str, poses: dict[int, Matrix], lens: float) -> bpy.types.Object:
    camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    camera.data.sensor_fit, camera.data.sensor_width, camera.data.lens = "HORIZONTAL", 36.0, lens
    camera.rotation_mode = "QUATERNION"
    scene.collection.objects.link(camera)
    key_linear(camera, "location", {t: pose.to_translation() for t, pose in poses.items()})
    key_linear(camera, "rotation_quaternion", {t: pose.to_quaternion() for t, pose in poses.items()})
    scene.camera = scene.camera or camera
    return camera
