"""The render engine Feature4X: Blender's camera, depsgraph and passes around the core's renderer.

Colours: a scene's Gaussians are display sRGB and are blended as such, over the world's colour. The Combined pass is that
picture in linear light, so the Standard view transform shows the core's own numbers.
"""

from collections.abc import Callable

import bpy
import gpu
import numpy as np
from bpy.props import BoolProperty, IntProperty, PointerProperty
from gpu_extras.presets import draw_texture_2d

from ...f4x_core.errors import Cancelled
from ...f4x_core.native.library import open_library
from ...f4x_core.query.matte import OBJECTS, refine_passes
from ...f4x_core.scene import cryptomatte, layers, stage
from ...f4x_core.scene.exposure import Exposure, Take, combined, shoot
from ...f4x_core.scene.ground import Look, ground
from ...f4x_core.scene.passes import Mist
from ...f4x_core.troubles import EXPECTED
from ..common.axes import Eye, Stereo, camera_eye, camera_lens, eye
from ..common.render_settings import ENGINE
from ..common.wording import refuse
from ..edits import display
from . import believed, evaluated, shadows, viewport_gpu
from .viewport_gpu import ProcessorPicture, SurfaceDepths

_INDEX = ("Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB", "X")
# channels -> kind of socket
_SOCKETS = {"RGB": "COLOR", "rgba": "COLOR", "XYZ": "VECTOR", "XYZW": "VECTOR"}
# pass of the stage -> Blender's own switch in the view layer
_SWITCHES = {
    "depth": "use_pass_z",
    "index": "use_pass_object_index",
    "mist": "use_pass_mist",
    "position": "use_pass_position",
    "normal": "use_pass_normal",
    "vector": "use_pass_vector",
    f"{stage.MATTE}object": "use_pass_cryptomatte_object",
    f"{stage.MATTE}collection": "use_pass_cryptomatte_asset",
}
# falloff of Blender's mist -> exponent
_FALLOFF = {"LINEAR": 1.0, "QUADRATIC": 2.0, "INVERSE_QUADRATIC": 0.5}
OWN_SOCKET = "Alpha"
"""Socket that the compositor's Render Layers has for the pass Combined. A second one of that name would end Blender: it loses
links when that one comes and goes. The pass is in files all the same."""
SAMPLES = 16
"""Sharp pictures that a blurred one is made of."""
COARSE_TO_FINE, WITHOUT_KERNELS = (2, 1), (4, 1)
"""The viewport first shows a picture this many times smaller, then the next: with compiled kernels, for which Gaussians count and
pixels hardly, and with numpy."""
# Blender's own panels that speak of passes or filters which this engine does not have
_OTHERS_PANELS = ("VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes")


class F4X_PG_passes(bpy.types.PropertyGroup):  # noqa: N801 - Blender wants this form
    """Passes of a view layer that only this engine has."""

    alpha: BoolProperty(name="Alpha", description="Coverage of Gaussians and surfaces")  # type: ignore[valid-type]
    latent: BoolProperty(  # type: ignore[valid-type]
        name="Latent", description="Three principal components of the features (point attribute f4x_latent)"
    )
    selection: BoolProperty(  # type: ignore[valid-type]
        name="Selection", description="Coverage of the selected points (point attribute .selection)"
    )
    score: BoolProperty(  # type: ignore[valid-type]
        name="Score", description="How well the points match a query (point attribute f4x_score)"
    )
    holdout: BoolProperty(  # type: ignore[valid-type]
        name="Holdout",
        description="Coverage of held-out meshes, where they are not hidden: lay a picture of them there",
    )
    unseen: BoolProperty(  # type: ignore[valid-type]
        name="Unseen", description="Matte of what no frame of the clip shows, such as behind what was removed"
    )


class F4X_PT_passes(bpy.types.Panel):  # noqa: N801
    """Passes of the engine."""

    bl_label = "Passes"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "view_layer"
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - read by Blender

    @classmethod
    def poll(cls, context):
        """Return True for this engine alone."""
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        """Draw the switches of passes in one column."""
        layer = context.view_layer
        column = self.layout.column()
        for name, switch in _SWITCHES.items():
            texts = {
                "depth": "Depth",
                "matte:object": "Cryptomatte Object",
                "matte:collection": "Cryptomatte Collection",
            }
            column.prop(layer, switch, **({"text": texts[name]} if name in texts else {}))
        column.prop(layer, "pass_cryptomatte_depth", text="Cryptomatte Levels")
        for name in F4X_PG_passes.__annotations__:
            column.prop(layer.f4x_passes, name)
        self.layout.prop(layer, "f4x_hold_out_meshes")


class F4X_PT_film(bpy.types.Panel):  # noqa: N801
    """Panel with the switch between the world's colour and a transparent film."""

    bl_label = "Film"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - read by Blender
    poll = F4X_PT_passes.poll

    def draw(self, context):
        """Draw the switch between the world's color and nothing, and the number of sharp pictures in a blurred one."""
        self.layout.prop(context.scene.render, "film_transparent", text="Transparent")
        self.layout.prop(context.scene, "f4x_samples")


class F4X_PT_motion_blur(bpy.types.Panel):  # noqa: N801
    """Blender's own settings of the shutter."""

    bl_label = "Motion Blur"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - read by Blender
    poll = F4X_PT_passes.poll

    def draw_header(self, context):
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context):
        """Draw when the shutter opens, and for how long."""
        render = context.scene.render
        self.layout.active = render.use_motion_blur
        self.layout.prop(render, "motion_blur_position")
        self.layout.prop(render, "motion_blur_shutter")


class F4X_PT_mist(bpy.types.Panel):  # noqa: N801
    """Blender's own settings of the pass Mist."""

    bl_label = "Mist Pass"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "world"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - read by Blender
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - read by Blender

    @classmethod
    def poll(cls, context):
        """Return True for this engine where there is a world."""
        return context.engine in cls.COMPAT_ENGINES and context.world is not None

    def draw(self, context):
        """Draw start, depth and falloff of the mist."""
        for name in ("start", "depth", "falloff"):
            self.layout.prop(context.world.mist_settings, name)


class Feature4XRenderEngine(bpy.types.RenderEngine):
    """Render engine that draws Gaussians as the core does; other surfaces occlude them and show their plain colors."""

    bl_idname = ENGINE
    bl_label = "Feature4X"
    bl_use_eevee_viewport = True  # Material Preview is EEVEE's
    bl_use_shading_nodes_custom = False

    def __init__(self, *args, **kwargs):
        """Start without a viewport picture; finished renders never ask for one."""
        super().__init__(*args, **kwargs)
        self._stage = self._view = self._texture = self._card = self._refused = self._drawn = None
        self._reader, self._step = evaluated.Reader(), 0

    def update_render_passes(self, scene, layer):
        """Tell the compositor which sockets there are."""
        self.register_pass(scene, layer, "Combined", 4, "RGBA", "COLOR")
        for title, channels in _titles(layer).items():
            if title == OWN_SOCKET:
                continue
            self.register_pass(scene, layer, title, len(channels), channels, _SOCKETS.get(channels, "VALUE"))

    def render(self, depsgraph):
        """Render one view layer at the current frame."""
        try:
            self._render(depsgraph)
        except Cancelled:
            self.update_stats("Feature4X", "cancelled")
        except EXPECTED as error:
            refuse(self, error)

    def _render(self, depsgraph):
        scene, layer = depsgraph.scene, depsgraph.view_layer
        self.update_stats("Feature4X", "reading the scene")
        display.check_frame(scene.original)
        believed.warn(self.report, depsgraph)
        for title, channels in _titles(layer).items():
            self.add_pass(title, len(channels), channels, layer=layer.name)
        for view in _views(scene.render):
            if view:
                self.active_view_set(view)
            self._render_view(depsgraph, view)

    def _render_view(self, depsgraph, view: str) -> None:
        """Render what one eye sees; without stereo there is one, which has no name."""
        scene, layer = depsgraph.scene, depsgraph.view_layer
        seen = self._eye(depsgraph, view)
        region, passes = _region(scene.render, self.resolution_x, self.resolution_y), _wanted(layer)
        mattes = evaluated.Mattes() if any(name.startswith(stage.MATTE) for name in passes) else None
        more = evaluated.More(
            mattes,
            unseen="unseen" in passes,
            moving=OBJECTS in passes,
            lit=shadows.lighting(depsgraph),
            hold_out=layer.f4x_hold_out_meshes,
        )
        background = None if scene.render.film_transparent else evaluated.world_color(scene.world)

        def progress(name: str, done: int, total: int, message: str = "") -> None:
            if self.test_break():
                raise Cancelled
            self.update_progress(done / total)
            self.update_stats("Feature4X", f"{view} row {done} of {total}".lstrip())

        settings = stage.DrawSettings(
            seen.near, seen.far, background, mist=_mist(scene.world, seen.back), region=region
        )
        images = shoot(
            self._takes(depsgraph, more, view),
            _exposure(scene, depsgraph, seen.back),
            settings,
            passes,
            refine=lambda images, take: refine_passes(images, take, settings, mattes.selections if mattes else ()),
            progress=progress,
        )
        if "depth" in images:
            there = images["depth"] < stage.NOTHING
            images["depth"] = np.where(there, images["depth"] - seen.back, stage.NOTHING)
        self._write(layer, images, region, mattes, view)

    def _eye(self, depsgraph, view: str) -> Eye:
        """Return the camera of a view at present."""
        scene, size = depsgraph.scene, (self.resolution_x, self.resolution_y)
        if not view:
            return camera_eye(scene.camera, scene, depsgraph, *size)
        camera = self.camera_override or scene.camera
        stereo = Stereo(np.array(self.camera_model_matrix(camera)), self.camera_shift_x(camera))
        return camera_eye(camera, scene, depsgraph, *size, stereo)

    def _takes(self, depsgraph, more: evaluated.More, view: str) -> Callable[[float], Take]:
        """Return a function of an offset in frames that reads the scene there; Blender evaluates each new frame."""
        scene = depsgraph.scene
        start = shown = scene.frame_current + scene.frame_subframe

        def take_at(offset: float) -> Take:
            nonlocal shown
            if start + offset != shown:
                shown = start + offset
                whole = int(np.floor(shown))
                self.frame_set(whole, shown - whole)
            here = self._eye(depsgraph, view)
            clouds, surfaces = evaluated.stage(depsgraph, more)
            return Take(stage.as_seen(clouds, here.back), surfaces, here.camera)

        return take_at

    def _write(self, layer, images: dict[str, np.ndarray], region: tuple[slice, slice], mattes, view: str) -> None:
        """Hand the pictures over to Blender in its own names, with the names of mattes in the file's header."""
        written = layers.named_layers(images, layer.pass_cryptomatte_depth)
        if "index" in images:
            written[_INDEX[0]] = (images["index"][..., None], _INDEX[1])
        rows, columns = region
        size = columns.stop - columns.start, rows.stop - rows.start
        result = self.begin_result(0, 0, *size, layer=layer.name, view=view)
        whole = self.get_result()
        for name, names in mattes.names.items() if mattes else ():
            if f"{stage.MATTE}{name}" in _wanted(layer):
                for key, value in cryptomatte.metadata(f"{layer.name}.{layers.MATTES[name]}", names).items():
                    whole.stamp_data_add_field(key, value)
        for render_pass in result.layers[0].passes:
            if render_pass.name in written:
                image, _ = written[render_pass.name]
                render_pass.rect.foreach_set(np.ascontiguousarray(image[::-1], np.float32).ravel())  # bottom row first
        self.end_result(result)

    def view_update(self, context, depsgraph):
        """Read the scene again, in which something has changed."""
        self._stage = (*self._reader.stage(depsgraph, context.space_data), evaluated.world_color(depsgraph.scene.world))
        self._step = 0

    def view_draw(self, context, depsgraph):
        """Draw the viewport: on the graphics card, else coarse after every change and then in full."""
        region, region_3d = context.region, context.region_data
        view = (np.array(region_3d.window_matrix), np.array(region_3d.view_matrix), region.width, region.height)
        if self._view is None or any(np.any(a != b) for a, b in zip(view, self._view, strict=True)):
            self._view, self._step = view, 0
        if not self._draw_on_card():
            self._draw_on_processor()
        gpu.state.blend_set("ALPHA_PREMULT")
        self.bind_display_space_shader(depsgraph.scene)
        draw_texture_2d(self._texture, (0, 0), region.width, region.height)
        self.unbind_display_space_shader()
        gpu.state.blend_set("NONE")

    def _draw_on_card(self) -> bool:
        """Let the graphics card draw the picture; False where it refuses."""
        if self._card is None and self._stage is not self._refused and not viewport_gpu.is_software():
            self._card = viewport_gpu.picture()
        if self._card is None:
            return False
        try:
            if self._step == 0:
                self._card.load(*self._stage)
            if self._step < 2:  # a coarse order first, the exact one when nothing has moved since
                moving = self._step == 0
                self._texture = self._card.draw(eye(*self._view), moving=moving)
                self._step += 1 if self._card.is_coarse(moving) else 2
                if self._step < 2:
                    self.tag_redraw()
        except Exception as error:  # drivers refuse in many words
            viewport_gpu.refuse(error)
            self._card, self._step, self._refused = None, 0, self._stage
            return False
        viewport_gpu.shown[bpy.context.region.as_pointer()] = self._card
        return True

    def _draw_on_processor(self) -> None:
        steps = WITHOUT_KERNELS if open_library()[0] is None else COARSE_TO_FINE
        if self._step < len(steps):
            self._drawn = self._picture(steps[self._step])
            self._texture = self._drawn.texture
            self._step += 1
            if self._step < len(steps):
                self.tag_redraw()
        viewport_gpu.shown[bpy.context.region.as_pointer()] = self._drawn

    def _picture(self, coarse: int) -> ProcessorPicture:
        """Return the viewport's picture, `coarse` times smaller."""
        projection, world_to_view, width, height = self._view
        size = (-(-width // coarse), -(-height // coarse))
        seen = eye(projection, world_to_view, *size)
        clouds, surfaces, background = self._stage
        settings = stage.DrawSettings(seen.near, seen.far, background, surface_samples=1)
        images = stage.draw(stage.as_seen(clouds, seen.back), surfaces, seen.camera, settings)
        picture = combined(images["rgb"], np.ones_like(images["alpha"]))
        flat = np.ascontiguousarray(picture[::-1], np.float32).ravel()
        texture = gpu.types.GPUTexture(size, format="RGBA16F", data=gpu.types.Buffer("FLOAT", flat.size, flat))
        if not surfaces:
            return ProcessorPicture(texture)
        look = Look(seen.camera, seen.near, seen.far, background, settings.mist, samples=1)
        return ProcessorPicture(texture, SurfaceDepths.of(ground(surfaces, look, ()).limit, seen.camera))


def _wanted(layer: bpy.types.ViewLayer) -> list[str]:
    """Return the passes of the stage that a view layer asks for."""
    own = [name for name in F4X_PG_passes.__annotations__ if getattr(layer.f4x_passes, name)]
    return [name for name, switch in _SWITCHES.items() if getattr(layer, switch)] + own


def _views(render: bpy.types.RenderSettings) -> list[str]:
    """Return the names of the views that are rendered; without stereo one without a name."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == "STEREO_3D"
    return [view.name for view in render.views if view.use and (not stereo or view.name in ("left", "right"))]


def _titles(layer: bpy.types.ViewLayer) -> dict[str, str]:
    """Return name in Blender -> channels of the passes that a view layer asks for, besides Combined."""
    titles = {}
    for name in _wanted(layer):
        if name.startswith(stage.MATTE):
            title = layers.MATTES[name.removeprefix(stage.MATTE)]
            count = (layer.pass_cryptomatte_depth + 1) // 2
            titles |= {f"{title}{number:02d}": layers.CRYPTO_CHANNELS for number in range(count)}
        else:
            title, channels = _INDEX if name == "index" else layers.PASSES[name]
            titles[title] = channels
    return titles


def _mist(world: bpy.types.World | None, back: float) -> Mist:
    """Return the mist by Blender's own settings; `back`: of the camera's `Eye`."""
    if world is None:
        return Mist(back=back)
    settings = world.mist_settings
    return Mist(settings.start, settings.depth, _FALLOFF[settings.falloff], back)


def _exposure(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, back: float) -> Exposure:
    """Return the shutter of the render settings and the lens of the camera."""
    render, lens = scene.render, camera_lens(scene.camera, depsgraph, back)
    span = render.motion_blur_shutter if render.use_motion_blur else 0.0
    opens = {"START": 0.0, "CENTER": -span / 2, "END": -span}[render.motion_blur_position]
    return Exposure(scene.f4x_samples, opens, opens + span, lens)


def _region(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[slice, slice]:
    """Return (rows, columns) from the top of the render region, cut to whole pixels as Blender cuts them."""
    if not render.use_border:
        return slice(0, height), slice(0, width)
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    return slice(height - top, height - bottom), slice(left, right)


def _shared_panels() -> list[type]:
    """Return Blender's own panels that every simple engine shows."""
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in _OTHERS_PANELS
    ]


def register() -> None:
    """Register the pass settings and show Blender's shared panels for this engine."""
    bpy.types.ViewLayer.f4x_passes = PointerProperty(type=F4X_PG_passes)
    bpy.types.Scene.f4x_samples = IntProperty(
        name="Samples",
        description="Sharp pictures that are averaged for motion blur and depth of field",
        default=SAMPLES,
        min=1,
        max=1024,
    )
    bpy.types.ViewLayer.f4x_hold_out_meshes = BoolProperty(
        name="Hold Out Meshes",
        description="Cut holes where meshes are, for the picture of another engine",
    )
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add(Feature4XRenderEngine.bl_idname)


def unregister() -> None:
    """Undo `register`."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard(Feature4XRenderEngine.bl_idname)
    del bpy.types.ViewLayer.f4x_passes, bpy.types.ViewLayer.f4x_hold_out_meshes, bpy.types.Scene.f4x_samples
    viewport_gpu.forget()


CLASSES = (F4X_PG_passes, F4X_PT_passes, F4X_PT_film, F4X_PT_motion_blur, F4X_PT_mist, Feature4XRenderEngine)
