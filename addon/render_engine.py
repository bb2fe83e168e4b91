"""The render engine Feature4X: Blender's camera, depsgraph and passes around the core's renderer.

Colours: a scene's Gaussians are display sRGB and are blended as such, over the world's colour. The Combined pass is that
picture in linear light, so the Standard view transform shows the core's own numbers.
"""

import bpy
import gpu
import numpy as np
from bpy.props import BoolProperty, PointerProperty
from gpu_extras.presets import draw_texture_2d

from ..f4x_core.errors import Cancelled, F4xError
from ..f4x_core.scene import stage
from ..f4x_core.scene.color import linear_from_srgb
from ..f4x_core.troubles import with_code
from . import display, evaluated, viewport_gpu
from .axes import camera_eye, eye

# pass of the stage -> (name in Blender, channels, kind of socket)
_PASSES = {
    "depth": ("Depth", "Z", "VALUE"),
    "index": ("Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB", "X", "VALUE"),
    "alpha": ("Alpha", "A", "VALUE"),
    "latent": ("Latent", "RGB", "COLOR"),
    "selection": ("Selection", "X", "VALUE"),
    "score": ("Score", "X", "VALUE"),
}
COARSE_TO_FINE = (4, 1)
"""The viewport first shows a picture this many times smaller, then the next."""
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


class F4X_PT_passes(bpy.types.Panel):  # noqa: N801
    """Passes of the engine."""

    bl_label = "Passes"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "view_layer"
    COMPAT_ENGINES = {evaluated.ENGINE}  # noqa: RUF012 - read by Blender

    @classmethod
    def poll(cls, context):
        """Shown for this engine alone."""
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        """One column of switches."""
        layer = context.view_layer
        column = self.layout.column()
        column.prop(layer, "use_pass_z", text="Depth")
        column.prop(layer, "use_pass_object_index")
        for name in F4X_PG_passes.__annotations__:
            column.prop(layer.f4x_passes, name)


class F4X_PT_film(bpy.types.Panel):  # noqa: N801
    """Panel with the switch between the world's colour and a transparent film."""

    bl_label = "Film"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {evaluated.ENGINE}  # noqa: RUF012 - read by Blender
    poll = F4X_PT_passes.poll

    def draw(self, context):
        """One switch: the world's colour, or nothing."""
        self.layout.prop(context.scene.render, "film_transparent", text="Transparent")


class Feature4XRenderEngine(bpy.types.RenderEngine):
    """Render engine that draws Gaussians as the core does; other surfaces occlude them and show a flat colour."""

    bl_idname = evaluated.ENGINE
    bl_label = "Feature4X"
    bl_use_eevee_viewport = True  # Material Preview is EEVEE's
    bl_use_shading_nodes_custom = False

    def __init__(self, *args, **kwargs):
        """Start without a viewport picture; finished renders never ask for one."""
        super().__init__(*args, **kwargs)
        self._stage = self._view = self._texture = self._card = self._refused = None
        self._reader, self._step = evaluated.Reader(), 0

    def update_render_passes(self, scene, layer):
        """Tell the compositor which sockets there are."""
        self.register_pass(scene, layer, "Combined", 4, "RGBA", "COLOR")
        for name in _wanted(layer):
            title, channels, kind = _PASSES[name]
            self.register_pass(scene, layer, title, len(channels), channels, kind)

    def render(self, depsgraph):
        """Render one view layer at the current frame."""
        try:
            self._render(depsgraph)
        except Cancelled:
            self.update_stats("Feature4X", "cancelled")
        except F4xError as error:
            self.report({"ERROR"}, with_code(error))

    def _render(self, depsgraph):
        scene, layer = depsgraph.scene, depsgraph.view_layer
        self.update_stats("Feature4X", "reading the scene")
        display.check_frame(scene.original)
        seen = camera_eye(scene.camera, scene, depsgraph, self.resolution_x, self.resolution_y)
        clouds, surfaces = evaluated.stage(depsgraph)
        count = sum(len(cloud.means) for cloud in clouds)

        def progress(name: str, done: int, total: int, message: str = "") -> None:
            if self.test_break():
                raise Cancelled
            self.update_progress(done / total)
            self.update_stats("Feature4X", f"{count:,} Gaussians, row {done} of {total}")

        rows, columns = _region(scene.render, self.resolution_x, self.resolution_y)
        passes = _wanted(layer)
        transparent = scene.render.film_transparent
        background = None if transparent else evaluated.world_color(scene.world)

        def finish(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            """Rename the passes for Blender and convert depth."""
            if "depth" in images:
                there = images["depth"] < stage.NOTHING
                images["depth"] = np.where(there, images["depth"] - seen.back, stage.NOTHING)
            named = {_PASSES[name][0]: images[name] for name in passes}
            return {"Combined": _combined(images, transparent)} | named

        written = stage.draw(
            stage.as_seen(clouds, seen.back),
            surfaces,
            seen.camera,
            stage.DrawSettings(seen.near, seen.far, background),
            passes=passes,
            region=(rows, columns),
            progress=progress,
            finish=finish,
        )
        for name in passes:
            title, channels, _ = _PASSES[name]
            self.add_pass(title, len(channels), channels, layer=layer.name)
        result = self.begin_result(0, 0, columns.stop - columns.start, rows.stop - rows.start, layer=layer.name)
        for render_pass in result.layers[0].passes:
            if render_pass.name in written:
                flat = np.ascontiguousarray(written[render_pass.name][::-1], np.float32).ravel()  # bottom row first
                render_pass.rect.foreach_set(flat)
        self.end_result(result)

    def view_update(self, context, depsgraph):
        """Something changed in the scene: read it again."""
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
        if self._card is None and self._stage is not self._refused:
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
        return True

    def _draw_on_processor(self) -> None:
        if self._step < len(COARSE_TO_FINE):
            self._texture = self._view_texture(COARSE_TO_FINE[self._step])
            self._step += 1
            if self._step < len(COARSE_TO_FINE):
                self.tag_redraw()

    def _view_texture(self, coarse: int) -> gpu.types.GPUTexture:
        """The viewport's picture, `coarse` times smaller."""
        projection, world_to_view, width, height = self._view
        size = (-(-width // coarse), -(-height // coarse))
        seen = eye(projection, world_to_view, *size)
        clouds, surfaces, background = self._stage
        settings = stage.DrawSettings(seen.near, seen.far, background)
        images = stage.draw(stage.as_seen(clouds, seen.back), surfaces, seen.camera, settings)
        flat = np.ascontiguousarray(_combined(images, transparent=False)[::-1], np.float32).ravel()
        return gpu.types.GPUTexture(size, format="RGBA16F", data=gpu.types.Buffer("FLOAT", flat.size, flat))


def _wanted(layer: bpy.types.ViewLayer) -> list[str]:
    """Passes of the stage that a view layer asks for."""
    builtin = {"depth": layer.use_pass_z, "index": layer.use_pass_object_index}
    return [name for name in _PASSES if builtin.get(name, getattr(layer.f4x_passes, name, False))]


def _region(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[slice, slice]:
    """(rows, columns) from the top of the render region, cut to whole pixels as Blender cuts them."""
    if not render.use_border:
        return slice(0, height), slice(0, width)
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    return slice(height - top, height - bottom), slice(left, right)


def _combined(images: dict[str, np.ndarray], transparent: bool) -> np.ndarray:
    """(H,W,4) linear light; with a transparent film the colour under the alpha is what is linearised, then premultiplied."""
    rgb, alpha = images["rgb"], images["alpha"][..., None]
    if not transparent:
        return np.concatenate([linear_from_srgb(rgb), np.ones_like(alpha)], -1)
    straight = rgb / np.where(alpha > 0, alpha, 1)
    return np.concatenate([linear_from_srgb(straight) * alpha, alpha], -1)


def _shared_panels() -> list[type]:
    """Blender's own panels that every simple engine shows."""
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in _OTHERS_PANELS
    ]


def register() -> None:
    """Register the pass settings and show Blender's shared panels for this engine."""
    bpy.types.ViewLayer.f4x_passes = PointerProperty(type=F4X_PG_passes)
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add(Feature4XRenderEngine.bl_idname)


def unregister() -> None:
    """Undo `register`."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard(Feature4XRenderEngine.bl_idname)
    del bpy.types.ViewLayer.f4x_passes
    viewport_gpu.forget()


CLASSES = (F4X_PG_passes, F4X_PT_passes, F4X_PT_film, Feature4XRenderEngine)
