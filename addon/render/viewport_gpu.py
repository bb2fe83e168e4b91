"""The viewport's picture on the graphics card, with Blender's `gpu` module: what the core packs, in its order.

Off screen, in sRGB as the engine blends: the world's colour, surfaces with their depth, the Gaussians farthest first over
them, then the whole in linear light. Everything with numbers in it is the core's (`splat_textures`, `splat_shader`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakValueDictionary

import gpu
import numpy as np

from ...f4x_core.errors import F4xError
from ...f4x_core.geometry.camera import Camera
from ...f4x_core.scene import splat_shader as glsl
from ...f4x_core.scene.clouds import Cloud, fitted_config
from ...f4x_core.scene.depth_order import OrderSettings
from ...f4x_core.scene.splat_textures import SplatTextures, clip_matrix, refuse_too_large, triangle_vertices
from ...f4x_core.scene.stage import Surface, as_seen
from ..common.axes import Eye

FORMATS = {1: "R32F", 4: "RGBA32F"}
"""Format of a texture by the floats of a texel."""
HALF = {"harmonics": "RGBA16F"}
"""Textures of half floats: eleven bits are enough for what is added to a colour of eight."""
PICTURE = "RGBA16F"
EXACT_WHILE_MOVING = 250_000
"""Gaussians up to which the order is exact while the view moves, too: it then takes a few milliseconds."""
FARTHEST = 3e38
"""Depth that stands for infinity in a texture."""
_STRIP = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
_shaders: dict[str, gpu.types.GPUShader] = {}
_refusal: str | None = None  # why the graphics card cannot draw, once it has said so
_said: set[str] = set()


@dataclass(frozen=True, eq=False)
class SurfaceDepths:
    """Depths of the nearest surfaces in a viewport's picture, by which other things can be hidden behind them."""

    texture: gpu.types.GPUTexture
    """One float for each pixel, or for several of a coarse picture."""
    row: np.ndarray
    """(4,) times a point of the world, homogeneous: its depth."""

    @classmethod
    def of(cls, limit: np.ndarray, camera: Camera) -> SurfaceDepths:
        """Return the depths `limit (H,W)` float32 that `camera` sees."""
        depths = np.ascontiguousarray(limit[::-1, :, None])
        return cls(_texture(np.minimum(depths, np.float32(FARTHEST))), camera.world_to_camera[2])


@dataclass(frozen=True, eq=False)
class ProcessorPicture:
    """One viewport's picture that the processor has drawn."""

    texture: gpu.types.GPUTexture
    surface_depths: SurfaceDepths | None = None


class GpuPicture:
    """One viewport's picture. Needs an active GPU context; what the driver refuses is raised as it comes."""

    def __init__(self) -> None:
        """Compile the shaders, once per session."""
        if not _shaders:
            _shaders.update(_compile())
        self.splats = SplatTextures()
        self.milliseconds: dict[str, float] = {}
        """Milliseconds of this thread that the last `load` and `draw` took, and of the latter `prepare`."""
        self._background = np.zeros(3)
        self._textures: dict[str, gpu.types.GPUTexture] = {}
        self._surfaces: gpu.types.GPUBatch | None = None
        self._known: Sequence[Surface] | None = None
        self._strip = _batch("TRI_STRIP", {"corner": np.array(_STRIP, np.float32)})
        self._targets: _Targets | None = None
        self.surface_depths: SurfaceDepths | None = None

    def load(self, clouds: Sequence[Cloud], surfaces: Sequence[Surface], background: np.ndarray) -> None:
        """Take a stage; upload what of it is new."""
        start = time.thread_time()
        changed = self.splats.update(clouds)
        refuse_too_large(self.splats, gpu.capabilities.max_texture_size_get())
        for name in changed:
            self._textures[name] = _texture(self.splats.arrays[name], HALF.get(name))
        if surfaces != self._known:
            self._surfaces = _batch("TRIS", triangle_vertices(surfaces)) if surfaces else None
            self._known = list(surfaces)
        self._background = background
        self.milliseconds["load"] = 1e3 * (time.thread_time() - start)

    def draw(self, seen: Eye, *, moving: bool = False) -> gpu.types.GPUTexture:
        """Return the picture in linear light; `moving` allows a coarse order. Overwritten by the next call."""
        start = time.thread_time()
        size = (seen.camera.width, seen.camera.height)
        if self._targets is None or self._targets.size != size:
            self._targets = _Targets(size)
        targets, far = self._targets, min(seen.far, FARTHEST)
        config = fitted_config(as_seen(self.splats.clouds, seen.back), seen.camera)
        settings = OrderSettings(seen.near, seen.far, config.alpha_min, self.is_coarse(moving), config.threads)
        order, count = self.splats.order(seen.camera, settings)
        tables = {
            "order": _texture(order[: max(1, -(-count // order.shape[1]))]),
            "view": _texture(self.splats.view(seen.camera)),
        }
        self.milliseconds["prepare"] = 1e3 * (time.thread_time() - start)
        targets.clear(self._background, far)
        if self._surfaces is not None:
            self._draw_surfaces(targets, seen, far)
        if count:
            constants = glsl.splat_constants(seen.camera, seen.near, config, self.splats)
            self._draw_splats(targets, tables, constants, count)
        self._draw_linear(targets)
        self.surface_depths = SurfaceDepths(targets.limit, seen.camera.world_to_camera[2])
        self.milliseconds["draw"] = 1e3 * (time.thread_time() - start)
        return targets.linear

    def is_coarse(self, moving: bool) -> bool:
        """Return True if `draw` would take a coarse order."""
        return moving and len(self.splats) > EXACT_WHILE_MOVING

    def read(self) -> np.ndarray:
        """Return (H,W,4) sRGB of the last picture as it was blended, for tests."""
        assert self._targets is not None
        width, height = self._targets.size
        with self._targets.blended.bind():
            data = self._targets.blended.read_color(0, 0, width, height, 4, 0, "FLOAT")
        data.dimensions = width * height * 4
        return np.array(data, np.float32).reshape(height, width, 4)[::-1]

    def _draw_surfaces(self, targets: _Targets, seen: Eye, far: float) -> None:
        shader = _shaders["surface"]
        with targets.grounded.bind():
            _use("NONE", "LESS_EQUAL", depth_mask=True)
            shader.bind()
            shader.uniform_float("to_clip", clip_matrix(seen.camera, seen.near).T.ravel().tolist())
            shader.uniform_float("eye", (*seen.camera.center, far))
            self._surfaces.draw(shader)
            _use("NONE", "NONE", depth_mask=False)

    def _draw_splats(self, targets: _Targets, tables: Mapping, constants: Mapping, count: int) -> None:
        shader = _shaders["splat"]
        textures = {**self._textures, **tables, "limit": targets.limit}
        with targets.blended.bind():
            _use("ALPHA_PREMULT", "NONE", depth_mask=False)
            shader.bind()
            for name in glsl.SPLAT_SAMPLERS:
                shader.uniform_sampler(name, textures[name])
            for name, values in constants.items():
                shader.uniform_float(name, values)
            self._strip.draw_instanced(shader, instance_start=0, instance_count=count)
            _use("NONE", "NONE", depth_mask=False)

    def _draw_linear(self, targets: _Targets) -> None:
        shader = _shaders["linear"]
        with targets.shown.bind():
            _use("NONE", "NONE", depth_mask=False)
            shader.bind()
            shader.uniform_sampler("picture", targets.picture)
            self._strip.draw(shader)


class _Targets:
    """Textures and framebuffers for one size of the picture."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.picture = gpu.types.GPUTexture(size, format=PICTURE)
        self.linear = gpu.types.GPUTexture(size, format=PICTURE)
        self.limit = gpu.types.GPUTexture(size, format="R32F")
        self.depth = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F")
        self.grounded = gpu.types.GPUFrameBuffer(depth_slot=self.depth, color_slots=(self.picture, self.limit))
        self.blended = gpu.types.GPUFrameBuffer(color_slots=(self.picture,))
        self.shown = gpu.types.GPUFrameBuffer(color_slots=(self.linear,))

    def clear(self, background: np.ndarray, far: float) -> None:
        """Fill the picture with the world's colour, and the depths with `far`, before which nothing is."""
        with self.grounded.bind():
            self.grounded.clear(depth=1.0)
        self.picture.clear(format="FLOAT", value=(*background.tolist(), 1.0))
        self.limit.clear(format="FLOAT", value=(far,))


shown: WeakValueDictionary[int, GpuPicture | ProcessorPicture] = WeakValueDictionary()
"""Address of the region of a viewport -> the picture that it shows."""


def is_software() -> bool:
    """Return True where a program plays the graphics card: the engine's own kernels draw two to three times as fast."""
    return gpu.platform.device_type_get() == "SOFTWARE"


def picture() -> GpuPicture | None:
    """Return a new picture; None where the graphics card has refused."""
    if _refusal is not None:
        return None
    try:
        return GpuPicture()
    except Exception as error:  # drivers refuse in many words
        refuse(error)
        return None


def refuse(error: Exception) -> None:
    """Say once why the graphics card does not draw; it is not asked again, unless it is this scene that it cannot draw."""
    global _refusal
    sentence = (str(error).strip() or type(error).__name__).splitlines()[0]
    if not isinstance(error, F4xError):
        _refusal = sentence
    if sentence not in _said:
        _said.add(sentence)
        print(f"Feature4X: the graphics card does not draw the viewport ({sentence}); the processor does.", flush=True)


def forget() -> None:
    """Free the shaders and let the graphics card be asked again."""
    global _refusal
    _shaders.clear()
    _said.clear()
    _refusal = None


def _compile() -> dict[str, gpu.types.GPUShader]:
    splat = shader_info(glsl.SPLAT_CONSTANTS, glsl.SPLAT_SAMPLERS, {"corner": "VEC2"}, {"color": "VEC4"})
    splat.vertex_out(interface("splat_flat", glsl.SPLAT_FLAT, flat=True))
    splat.vertex_out(interface("splat_smooth", glsl.SPLAT_SMOOTH))
    surface = shader_info(
        glsl.SURFACE_CONSTANTS,
        (),
        {"pos": "VEC3", "normal": "VEC3", "color": "VEC4"},
        {"ground": "VEC4", "nearest": "FLOAT"},
    )
    surface.vertex_out(interface("surface_smooth", glsl.SURFACE_SMOOTH))
    linear = shader_info({}, ("picture",), {"corner": "VEC2"}, {"color": "VEC4"})
    sources = {
        "splat": (splat, glsl.SPLAT_VERTEX, glsl.SPLAT_FRAGMENT),
        "surface": (surface, glsl.SURFACE_VERTEX, glsl.SURFACE_FRAGMENT),
        "linear": (linear, glsl.LINEAR_VERTEX, glsl.LINEAR_FRAGMENT),
    }
    shaders = {}
    for name, (info, vertex, fragment) in sources.items():
        info.vertex_source(vertex)
        info.fragment_source(fragment)
        shaders[name] = gpu.shader.create_from_info(info)
    return shaders


def shader_info(
    constants: Mapping[str, str], samplers: Sequence[str], inputs: Mapping[str, str], outputs: Mapping[str, str]
) -> gpu.types.GPUShaderCreateInfo:
    """Return a description of a shader without its sources and without what goes from vertices to fragments."""
    info = gpu.types.GPUShaderCreateInfo()
    for name, kind in constants.items():
        info.push_constant(kind, name)
    for slot, name in enumerate(samplers):
        info.sampler(slot, "FLOAT_2D", name)
    for slot, (name, kind) in enumerate(inputs.items()):
        info.vertex_in(slot, kind, name)
    for slot, (name, kind) in enumerate(outputs.items()):
        info.fragment_out(slot, kind, name)
    return info


def interface(name: str, fields: Mapping[str, str], *, flat: bool = False) -> gpu.types.GPUStageInterfaceInfo:
    """Return what a vertex shader hands to a fragment shader; `flat`: without interpolation."""
    made = gpu.types.GPUStageInterfaceInfo(name)
    for field, kind in fields.items():
        (made.flat if flat else made.smooth)(kind, field)
    return made


def _use(blend: str, depth_test: str, *, depth_mask: bool) -> None:
    gpu.state.blend_set(blend)
    gpu.state.depth_test_set(depth_test)
    gpu.state.depth_mask_set(depth_mask)


def _texture(array: np.ndarray, kind: str | None = None) -> gpu.types.GPUTexture:
    """Return a texture of an array (rows, columns, channels) float32, in the format `kind` or that of its floats."""
    rows, columns, channels = array.shape
    data = gpu.types.Buffer("FLOAT", array.size, array.reshape(-1))
    return gpu.types.GPUTexture((columns, rows), format=kind or FORMATS[channels], data=data)


def _batch(kind: str, corners: Mapping[str, np.ndarray]) -> gpu.types.GPUBatch:
    form = gpu.types.GPUVertFormat()
    for name, values in corners.items():
        form.attr_add(id=name, comp_type="F32", len=values.shape[1], fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(form, len(next(iter(corners.values()))))
    for name, values in corners.items():
        vertices.attr_fill(name, values)
    return gpu.types.GPUBatch(type=kind, buf=vertices)
